"""Batched evaluation of flight rows, each as one environment of the simulator."""
