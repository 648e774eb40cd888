"""Betaflight's rate loop: rates, gains, filters and mixer."""
