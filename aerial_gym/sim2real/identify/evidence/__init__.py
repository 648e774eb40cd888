"""Bayesian selection of effects: sets of effects compete by their evidence."""
