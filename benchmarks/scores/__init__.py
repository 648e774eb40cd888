"""Scores of the closed loop on cases with hidden effects and on real flights."""
