"""Robustness of a policy: its success in named conditions, beside that in clean flight."""
