"""Sensors with a lens: pinhole, stereo and fisheye cameras. Square pixels, principal point in the middle of the image.

Frame and letters: those of ``range_sensor``.
"""

from dataclasses import dataclass
from math import hypot, inf

from aerial_gym.config.checks import require
from aerial_gym.config.range_sensor import RangeSensorCfg


@dataclass(frozen=True, kw_only=True)
class CameraCfg(RangeSensorCfg):
    """A pinhole camera, with rays through pixel centres."""

    model: str = "pinhole"  # Name of this model in a file
    hfov_deg: float  # Horizontal field of view, left edge to right edge [deg], 0 < hfov < 180; the vertical one follows
    kind: str = "depth"  # `depth`: distance along the optical axis; `range`: along the ray. Limits are of the same kind

    def __post_init__(self) -> None:
        super().__post_init__()
        holds = 0.0 < self.hfov_deg < 180.0
        require(self, "hfov_deg", holds, "must lie between 0 and 180 degrees. A fisheye camera sees more")

    @property
    def has_image_plane(self) -> bool:
        """A lens projects points onto an image."""
        return True


@dataclass(frozen=True, kw_only=True)
class StereoCfg(CameraCfg):
    """Two pinhole cameras side by side with equal attitude; images are those of the first.

    A pixel is valid only if the second camera sees the same point, unobstructed; otherwise it holds ``near_pixel``.
    """

    model: str = "stereo"  # Name of this model in a file
    baseline: float  # Second camera from the first, which is mounted, along y [m], left positive; not 0

    def __post_init__(self) -> None:
        super().__post_init__()
        require(self, "baseline", 0.0 < abs(self.baseline) < inf, "must be finite and not 0. Left is positive")

    @property
    def has_second_camera(self) -> bool:
        """The second image is shifted by the disparity."""
        return True


@dataclass(frozen=True, kw_only=True)
class FisheyeCfg(RangeSensorCfg):
    """An equidistant fisheye camera: a ray at the angle theta from the axis is seen ``r = f theta`` from the middle.

    Every pixel of the rectangle has a ray; corners lie further off the axis than the edges do.
    """

    model: str = "fisheye"  # Name of this model in a file

    hfov_deg: float
    """Horizontal field of view, from left edge to right edge [deg], 0 < hfov <= 360. The vertical and the diagonal one
    follow in proportion to the pixels; the corner pixels must look less than 180 degrees off the axis."""

    def __post_init__(self) -> None:
        super().__post_init__()
        require(self, "hfov_deg", 0.0 < self.hfov_deg <= 360.0, "must be > 0 and at most 360 degrees")
        corner = 0.5 * hypot(self.width - 1, self.height - 1) / self.width * self.hfov_deg
        rule = f"a corner pixel looks {corner:.1f} degrees off the axis: must be less than 180. Give a smaller field of view"
        require(self, "hfov_deg", corner < 180.0, rule)

    @property
    def has_image_plane(self) -> bool:
        """A lens projects points onto an image."""
        return True
