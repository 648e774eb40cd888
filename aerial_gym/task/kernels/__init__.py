"""Kernels of a task: goals, noise and numbers of an episode that are drawn, and images that are observed."""
