"""Attacks on the package: trainings that are killed, inputs that are mutated."""
