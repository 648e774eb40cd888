"""Policies: what maps observations to actions, and where they are read from."""
