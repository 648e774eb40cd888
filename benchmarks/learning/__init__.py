"""Learning curves of trainings, and flights of policies."""
