"""Rotations and random draws as pure functions of tensors."""
