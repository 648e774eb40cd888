"""Random wind: the test whether gusts cause the remaining residual, and the fit of their process."""
