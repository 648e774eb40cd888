"""Rows of flights that are evaluated at once, each one environment of the simulator."""
