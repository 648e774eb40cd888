"""Trainers by the name that a user gives to ``--trainer``: one module each, and one line in ``catalog``."""
