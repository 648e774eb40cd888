"""Test stand measurements: rotor maps, step responses, hover and compliant joints, with intervals and held-out errors."""
