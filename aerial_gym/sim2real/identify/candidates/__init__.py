"""Candidate effects, linearised about a fitted model, and residual structure without a known effect."""
