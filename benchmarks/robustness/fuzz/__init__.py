"""Inputs of every kind, mutated: each must work or be refused with one sentence."""
