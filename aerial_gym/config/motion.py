"""Motion of obstacles between resets.

Frames: the environment's own world frame, z up; velocities in m/s, angular velocities in rad/s.
"""

from dataclasses import dataclass
from math import inf

from aerial_gym.config.checks import Vec3, require, require_choice, require_ranges

MOTIONS = ("none", "twist", "waypoints")
"""Kinds of obstacle motion between resets."""

AT_BOUNDS = ("pass", "bounce", "wrap")
"""Behaviours at the bounds of an asset that moves by its twist."""


@dataclass(frozen=True, kw_only=True)
class MotionCfg:
    """Motion of an asset's instances between resets. Every number is drawn uniformly at reset."""

    kind: str = "none"
    """``none``; ``twist``: straight on and turning, with a twist that the user may overwrite at any time;
    ``waypoints``: back and forth between the place of the reset and a second one, drawn like it."""

    lin_vel_low: Vec3 = (0.0, 0.0, 0.0)
    """Lowest velocity of ``twist`` [m/s], world."""

    lin_vel_high: Vec3 = (0.0, 0.0, 0.0)
    """Highest velocity [m/s], world."""

    speed: tuple[float, float] = (0.0, 0.0)
    """Lowest and highest speed along ``waypoints`` [m/s], >= 0."""

    ang_vel_low: Vec3 = (0.0, 0.0, 0.0)
    """Lowest angular velocity [rad/s], world; for both."""

    ang_vel_high: Vec3 = (0.0, 0.0, 0.0)
    """Highest angular velocity [rad/s], world."""

    at_bounds: str = "pass"
    """Behaviour of ``twist`` when the origin reaches the bounds: ``pass`` on, ``bounce`` off, ``wrap`` to the other side."""

    def __post_init__(self) -> None:
        require_choice(self, "kind", MOTIONS)
        require_choice(self, "at_bounds", AT_BOUNDS)
        require_ranges(self, "lin_vel", "ang_vel")
        require(self, "speed", 0.0 <= self.speed[0] <= self.speed[1] < inf, "needs 0 <= low <= high < inf")
        still = MotionCfg.__dataclass_fields__
        unused = {
            "none": ("lin_vel_low", "lin_vel_high", "ang_vel_low", "ang_vel_high", "speed", "at_bounds"),
            "twist": ("speed",),
            "waypoints": ("lin_vel_low", "lin_vel_high", "at_bounds"),
        }
        for name in unused[self.kind]:
            require(self, name, getattr(self, name) == still[name].default, f"motion {self.kind!r} does not use it")
