"""Betaflight's simulator target: build, settings, processes, flights and comparison with ``betaflight_rate_control``."""
