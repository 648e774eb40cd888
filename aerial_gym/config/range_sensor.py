"""Common settings of all range sensors: image, limits, noise, outputs, mount and timing.

Frames: body is x forward, y left, z up. A sensor looks along its own x axis, image right is its -y, image down its -z, so
that it looks along body x at zero Euler angles; the optical frame (z forward, x right, y down) is never needed outside.
Letters: E environments, S sensors of one kind, H x W pixels (row 0 on top, column 0 at the left, which is +y).
"""

from dataclasses import dataclass
from math import inf
from typing import TYPE_CHECKING

from aerial_gym.config import checks
from aerial_gym.config.checks import MAX_MADE, NO_SOURCE
from aerial_gym.config.images import FRAMES, ImagesCfg, LightCfg
from aerial_gym.config.sensor_mount import PlacementCfg

if TYPE_CHECKING:
    from torch import Tensor

__all__ = ["FRAMES", "KINDS", "LightCfg", "NoiseCfg", "RangeSensorCfg"]

KINDS = ("depth", "range")


@dataclass(frozen=True, kw_only=True)
class NoiseCfg:
    """Noise of one measured distance r: it becomes N(r - mean_offset, (a r² + b r + c)²), or is dropped.

    Noise acts on the ideal distance, of the sensor's ``kind``, before limits and normalisation; points follow the noisy
    distance. Segmentation, normals and face ids stay those of the true hit. A ray that hits nothing has no noise.
    """

    std_a: float = 0.0  # Standard deviation per squared distance [1/m]
    std_b: float = 0.0  # Standard deviation per distance [-]
    std_c: float = 0.0  # Standard deviation at distance 0 [m]; the polynomial is >= 0 between the sensor's limits
    mean_offset: float = 0.0  # Mean amount by which distances are too short [m]; negative for too long
    dropout: float = 0.0  # Probability that a pixel is dropped and holds `near_pixel`; 0 <= dropout < 1

    def __post_init__(self) -> None:
        checks.require_finite(self, "std_a", "std_b", "std_c", "mean_offset")
        checks.require(self, "dropout", 0.0 <= self.dropout < 1.0, "must be a probability, 0 <= dropout < 1")

    def std(self, distance: float) -> float:
        """Return the standard deviation [m] at a distance [m]."""
        return (self.std_a * distance + self.std_b) * distance + self.std_c

    def least_std_distance(self, low: float, high: float) -> float:
        """Return the distance within an interval [m] with the smallest standard deviation."""
        vertex = -0.5 * self.std_b / self.std_a if self.std_a > 0.0 else low
        return min((low, high, min(max(vertex, low), high)), key=self.std)


@dataclass(frozen=True, kw_only=True)
class RangeSensorCfg(PlacementCfg, ImagesCfg):
    """Common part of all cameras, lidars and ray tables; the classes built on it say where the rays point.

    Order of operations on a distance: ray, noise and dropout, limits, normalisation. Out of its limits a pixel holds
    ``far_pixel`` (beyond ``max_range``, or nothing there) or ``near_pixel`` (closer than ``min_range``, or dropped).
    """

    model: str  # Ray model; its name in a file selects the class
    summary: str  # One line for people who choose a sensor
    width: int  # Pixels in a row, >= 1
    height: int  # Pixels in a column, >= 1
    min_range: float  # Shortest measured distance [m], >= 0
    max_range: float  # Longest measured distance [m], > min_range

    kind: str = "range"
    """``depth``: distance along the sensor's x axis, for rays that all look ahead; ``range``: distance along the ray. The
    limits are of the same kind."""

    normalize: bool = False  # Whether pixels are shares of `max_range`; points stay in metres
    noise: NoiseCfg | None = None  # Noise of the distances, from the same source as the other numbers; None has none
    noise_enabled: bool = True  # False keeps the numbers of `noise` without applying them
    count: int = 1  # Sensors S of this kind on the robot, >= 1; they share the mount unless the placement is drawn
    rate_hz: float | None = None  # Images per second of simulated time [Hz], > 0, held in between; None: at every step
    latency_s: float = 0.0  # Age of an image when it appears [s], >= 0
    far_out_of_range_value: float | None = None  # Pixel of "too far" [m]; None: max_range when normalising, else -1
    near_out_of_range_value: float | None = None  # Pixel of "too near" [m]; None: -max_range when normalising, else -1
    source: str = NO_SOURCE  # Source of the numbers

    def __post_init__(self) -> None:
        own = getattr(type(self), "model", None)
        checks.require(self, "model", self.model == own, f"must be {own!r}; another model is another class")
        for name in ("width", "height", "count"):
            checks.require(self, name, isinstance(getattr(self, name), int), "must be whole")
        checks.require_count(self, "width", "height", "count", most=MAX_MADE)
        holds = 0.0 <= self.min_range < self.max_range < inf
        checks.require(self, "min_range", holds, f"must be >= 0 and below max_range = {self.max_range!r}, finite")
        checks.require_finite(self, "far_out_of_range_value", "near_out_of_range_value")
        checks.require_choice(self, "kind", KINDS)
        for name in ("points", "normals"):
            holds = getattr(self, name) in (None, *FRAMES)
            checks.require(self, name, holds, f"must be one of {', '.join(FRAMES)}, or None for no such image")
        rule = f"a {self.model} has no image plane; a pinhole, stereo or fisheye camera has one"
        checks.require(self, "optical_flow", self.has_image_plane or not self.optical_flow, rule)
        if self.noise is not None:
            worst = self.noise.least_std_distance(self.min_range, self.max_range)
            rule = (
                f"the standard deviation is {self.noise.std(worst):g} m at {worst:g} m: must be >= 0 within the limits"
            )
            checks.require(self, "noise", self.noise.std(worst) >= 0.0, rule)
        self.check_placement()
        checks.require_positive(self, "rate_hz")
        checks.require_not_negative(self, "latency_s")

    def rays(self) -> "Tensor | None":
        """Return the directions of the rays, sensor frame, (H, W, 3), of a class of another package; None of all others."""
        return None

    @property
    def active_noise(self) -> NoiseCfg | None:
        """The active noise; None without noise or with noise off."""
        return self.noise if self.noise_enabled else None

    @property
    def far_pixel(self) -> float:
        """Pixel value without a hit within ``max_range``: 1 when normalised, else -1, unless configured."""
        default = self.max_range if self.normalize else -1.0
        value = default if self.far_out_of_range_value is None else self.far_out_of_range_value
        return value / self.max_range if self.normalize else value

    @property
    def largest_and_empty_share(self) -> tuple[float, float]:
        """Largest distance in the image's unit, and the share that represents a pixel without a distance.

        Where a sensor marks "too far" by a distance of its own, a pixel without a distance is near (0); where it marks far
        and near alike, nothing is known, and far (1) is by much the more frequent.
        """
        return (1.0 if self.normalize else self.max_range), (0.0 if self.far_pixel >= 0.0 else 1.0)

    @property
    def near_pixel(self) -> float:
        """Pixel value for a hit closer than ``min_range``: -1, unless configured."""
        default = -self.max_range if self.normalize else -1.0
        value = default if self.near_out_of_range_value is None else self.near_out_of_range_value
        return value / self.max_range if self.normalize else value
