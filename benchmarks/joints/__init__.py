"""Vehicles that bend."""
