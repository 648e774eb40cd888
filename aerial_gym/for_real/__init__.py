"""Training of a policy for one real vehicle: what a preflight log measured, and the uncertainty that it leaves."""
