"""Placement of a sensor on the body, constant or drawn at every reset.

Frames: body is x forward, y left, z up.
"""

from dataclasses import dataclass

from aerial_gym.config.checks import Vec3, require_angles, require_finite, require_ordered
from aerial_gym.errors import ConfigError


@dataclass(frozen=True, kw_only=True)
class PlacementCfg:
    """Nominal placement of a sensor, and the range of its draws at reset."""

    position: Vec3 = (0.0, 0.0, 0.0)
    """Nominal place from the body origin [m], body axes: where rays begin, where accelerometers are."""

    euler: Vec3 = (0.0, 0.0, 0.0)
    """Nominal ZYX roll, pitch, yaw from body to sensor [rad], within +-2 pi."""

    position_low: Vec3 | None = None
    """Lowest position [m], body axes, of the uniform draw per environment and sensor at reset; None keeps ``position``."""

    position_high: Vec3 | None = None
    """Highest one; given with ``position_low``, and ``position`` lies between them."""

    euler_low: Vec3 | None = None
    """Lowest Euler angles [rad] of the uniform draw per environment and sensor at reset; None keeps ``euler``."""

    euler_high: Vec3 | None = None
    """Highest ones; given with ``euler_low``, and ``euler`` lies between them."""

    def check_placement(self) -> None:
        """Raise ``ConfigError`` unless the numbers are finite and each nominal one lies between its ends."""
        require_finite(self, "position", "position_low", "position_high")
        require_angles(self, "euler", "euler_low", "euler_high")
        for name in ("position", "euler"):
            low, high = f"{name}_low", f"{name}_high"
            given = [each for each in (low, high) if getattr(self, each) is not None]
            if len(given) == 1:
                raise ConfigError(f"{type(self).__name__}: give both {low} and {high}, or neither")
            if given:
                require_ordered(self, low, name)
                require_ordered(self, name, high)
