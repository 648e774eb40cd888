"""``aerial-gym bench``: speed figures of workloads that are checked before and after timing."""
