"""Comparison of a log with the robot file and the training of a policy, before the policy flies the vehicle."""
