"""What a sensor file holds: for now, cameras of depth, range and segmentation.

Frames: body is x forward, y left, z up. A camera looks along its own x axis, image right is its -y, image down its -z, so
that it looks along body x at zero Euler angles; the optical frame (z forward, x right, y down) is never needed outside.
"""

from dataclasses import dataclass
from math import inf, isfinite, pi

from aerial_gym.config.robot import Vec3, require_finite
from aerial_gym.errors import ConfigError

CAMERA_KINDS = ("depth", "range")


@dataclass(frozen=True, kw_only=True)
class CameraCfg:
    """A pinhole camera. Square pixels, rays through pixel centres, principal point in the middle of the image.

    Order of what becomes of a distance: ray, limits, normalisation. Out of its limits a pixel holds ``far_pixel`` (beyond
    ``max_range``, or nothing there) or ``near_pixel`` (closer than ``min_range``).
    """

    summary: str
    """One line for people who choose a sensor."""

    width: int
    """Pixels in a row, >= 1."""

    height: int
    """Pixels in a column, >= 1."""

    hfov_deg: float
    """Horizontal field of view, from left edge to right edge [deg], 0 < hfov < 180; the vertical one follows."""

    min_range: float
    """Shortest measured distance [m], >= 0."""

    max_range: float
    """Longest measured distance [m], > min_range."""

    kind: str = "depth"
    """``depth``: distance along the optical axis; ``range``: distance along the ray. The limits are of the same kind."""

    normalize: bool = False
    """Whether pixels are divided by ``max_range``, which makes them dimensionless."""

    segmentation: bool = True
    """Whether it also writes the semantic id of what each pixel sees."""

    position: Vec3 = (0.0, 0.0, 0.0)
    """Pinhole from the body origin [m], body axes."""

    euler: Vec3 = (0.0, 0.0, 0.0)
    """ZYX roll, pitch, yaw from body to camera [rad], within +-2 pi."""

    far_out_of_range_value: float | None = None
    """Distance [m] that stands for "too far"; None takes max_range when normalising and -1 otherwise."""

    near_out_of_range_value: float | None = None
    """Distance [m] that stands for "too near"; None takes -max_range when normalising and -1 otherwise."""

    source: str
    """Where the numbers come from."""

    def __post_init__(self) -> None:
        for name in ("width", "height"):
            if getattr(self, name) < 1:
                raise ConfigError(f"CameraCfg.{name} = {getattr(self, name)!r}: must be at least 1 pixel")
        if not 0.0 < self.hfov_deg < 180.0:
            raise ConfigError(f"CameraCfg.hfov_deg = {self.hfov_deg!r}: must lie between 0 and 180 degrees")
        if not 0.0 <= self.min_range < self.max_range < inf:
            raise ConfigError(
                f"CameraCfg: min_range = {self.min_range!r}, max_range = {self.max_range!r}: "
                "needs 0 <= min_range < max_range < inf"
            )
        if self.kind not in CAMERA_KINDS:
            raise ConfigError(f"CameraCfg.kind = {self.kind!r}: must be one of {', '.join(CAMERA_KINDS)}")
        require_finite(self, "position", "euler")
        if any(abs(angle) > 2.0 * pi for angle in self.euler):
            raise ConfigError(f"CameraCfg.euler = {self.euler!r}: must lie within +-2 pi. Angles are in radians")
        for name in ("far_out_of_range_value", "near_out_of_range_value"):
            value = getattr(self, name)
            if value is not None and not isfinite(value):
                raise ConfigError(f"CameraCfg.{name} = {value!r}: must be finite")

    @property
    def far_pixel(self) -> float:
        """What a pixel holds where nothing lies within ``max_range``: 1 when normalised, else -1, unless configured."""
        default = self.max_range if self.normalize else -1.0
        value = default if self.far_out_of_range_value is None else self.far_out_of_range_value
        return value / self.max_range if self.normalize else value

    @property
    def near_pixel(self) -> float:
        """What a pixel holds where something is closer than ``min_range``: -1, unless configured."""
        default = -self.max_range if self.normalize else -1.0
        value = default if self.near_out_of_range_value is None else self.near_out_of_range_value
        return value / self.max_range if self.normalize else value
