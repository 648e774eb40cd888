"""A policy, the vehicle it was not trained on, and what ``close-loop`` makes of the difference: ``python -m benchmarks.story``.

The vehicle that is flown is the plant of ``benchmarks.undeclared``, which shares no code with the simulator that the policies
are trained in.
"""
