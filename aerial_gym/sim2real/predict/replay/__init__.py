"""Replay of states with memory along flights: rotors, loads and effects."""
