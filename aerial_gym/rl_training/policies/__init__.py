"""Policies: networks from observations to actions, and their loading from checkpoints."""
