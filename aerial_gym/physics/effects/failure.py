"""Start time of failures: its parameter, and its substep."""

from torch import Tensor

from aerial_gym.physics.effects.base import SubstepStart
from aerial_gym.physics.effects.parameter import Parameter

LATEST = 1e5
"""Largest start time [s]."""

NEVER = 1e4
"""Start time beyond every episode [s]."""

TIME = Parameter("time", "s", 0.0, LATEST, 0.1, "from the reset to the failure", kind="convention")


def substep_middle(moment: SubstepStart, like: Tensor) -> Tensor:
    """Return the middle of the coming substep [s], (E,), because failures begin at the boundary nearest to their time."""
    return (moment.since.to(like.dtype) + 0.5) * moment.dt
