"""Firmware of real autopilots, which flies the simulated vehicles in lockstep."""
