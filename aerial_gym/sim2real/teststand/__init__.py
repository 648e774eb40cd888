"""Bench measurements: rotor maps, step responses, hover and compliant joints, each with intervals and held-out errors."""
