"""``aerial-gym bench``: figures of speed, each from a workload that is checked before and after it is timed."""
