"""Robots that bend: the states of their joints, and families of them."""
