"""Bayesian selection of effects: the most probable set, its inclusion probabilities, and rivals."""
