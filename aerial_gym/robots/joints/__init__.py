"""Robots with joints: joint states, link poses and their contact."""
