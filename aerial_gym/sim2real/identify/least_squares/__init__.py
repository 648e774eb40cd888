"""Normal equations over time blocks, Gauss-Newton fits, and their uncertainty."""
