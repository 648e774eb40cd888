"""Lamps of an environment: lights at a point.

Frame: the environment's own world frame, z up; lengths in metres.
"""

from dataclasses import dataclass

from aerial_gym.config.checks import Vec3, require_finite, require_positive
from aerial_gym.config.shape import require_color


@dataclass(frozen=True, kw_only=True)
class LampCfg:
    """A lamp that shines to all sides alike. At the distance r a white surface that faces it has the brightness I c / r²."""

    position: Vec3
    """Position [m], world. The lamp itself is not seen and throws no shadow; a shape around it would."""

    intensity: float
    """I: brightness of a white surface that faces it, times the squared distance [m²], > 0; brightness 1 is that of full
    sun and sky, and the brightest that a pixel can show."""

    color: Vec3 = (1.0, 1.0, 1.0)
    """c: red, green, blue of the light, each 0 to 1."""

    def __post_init__(self) -> None:
        require_finite(self, "position")
        require_positive(self, "intensity")
        require_color(self, "color")
