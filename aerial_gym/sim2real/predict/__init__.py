"""Predictions of a model for measured flights: one-step residuals and open-loop rollouts."""
