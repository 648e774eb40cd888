"""Preflight checks of vehicles of the undeclared plant, each with one known fault or none."""
