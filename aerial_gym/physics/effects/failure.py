"""What effects share that begin at a moment of an episode: how the moment is given, and when it has come."""

from torch import Tensor

from aerial_gym.physics.effects.base import Moment
from aerial_gym.physics.effects.parameter import Parameter

LATEST = 1e5
"""Bound of a moment [s]."""

NEVER = 1e4
"""A moment that no episode lives to see [s]."""

TIME = Parameter(
    name="time",
    unit="s",
    low=0.0,
    high=LATEST,
    scale=0.1,
    meaning="from the reset to the failure",
    kind="convention",
)


def middle_of(moment: Moment, like: Tensor) -> Tensor:
    """Return the middle of the substep that begins [s], (E,): failures begin at the boundary that is nearest to their time."""
    return (moment.since.to(like.dtype) + 0.5) * moment.dt
