"""Identification from flights: effects, tolerances, battery and learned residual."""
