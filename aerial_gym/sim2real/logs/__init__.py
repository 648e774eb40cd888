"""Read flight logs, check and repair them, and convert them to complete flights."""
