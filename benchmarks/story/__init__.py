"""A policy on an unknown vehicle, before and after correction by ``close-loop``: ``python -m benchmarks.story``.

The vehicle that is flown is the plant of ``benchmarks.undeclared``, which shares no code with the simulator that the policies
are trained in.
"""
