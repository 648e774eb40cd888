"""Several vehicles in an environment: speed of their physics, and wakes against measured flights."""
