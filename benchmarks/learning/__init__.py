"""How trainings go, and what policies do."""
