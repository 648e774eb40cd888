"""Flights of two vehicles: whether their clocks agree, and whether one set of parameters serves both."""
