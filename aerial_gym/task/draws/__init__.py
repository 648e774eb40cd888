"""What a task draws, in kernels: goals and the noise of observations."""
