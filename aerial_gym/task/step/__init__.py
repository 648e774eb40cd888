"""Computations of a task step, one kernel each: command, rewards and ends, buffers, observation."""
