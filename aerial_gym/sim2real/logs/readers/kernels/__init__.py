"""Warp kernels of the log readers, for a CPU."""
