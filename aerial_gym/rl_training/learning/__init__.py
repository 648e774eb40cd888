"""Learners of our own: proximal policy optimisation, its optimiser, and the graph that holds both with the simulation."""
