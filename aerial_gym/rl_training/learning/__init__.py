"""Learners of this package: proximal policy optimisation and others, their optimiser, and the CUDA graph of an iteration."""
