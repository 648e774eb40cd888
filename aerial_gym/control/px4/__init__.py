"""PX4's control cascade: rate, attitude and position control with its parameters."""
