"""Tasks of several vehicles: what a vehicle's row reads of its environment, and the ends and rewards that vehicles share.

A task has one row for each vehicle: row b is vehicle ``b % V`` of environment ``b // V``.
"""
