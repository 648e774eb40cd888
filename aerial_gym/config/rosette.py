"""Lidars with beams refracted by rotating prisms, whose rays differ between frames (Livox Mid-40, Mid-70, Avia).

Frame and letters: those of ``range_sensor``; K frames of the scan, P prisms.
"""

from dataclasses import dataclass
from math import inf

from aerial_gym.config.checks import MAX_MADE, require, require_choice, require_count, require_finite
from aerial_gym.config.range_sensor import RangeSensorCfg
from aerial_gym.errors import ConfigError

Angles = tuple[float, float]


@dataclass(frozen=True, kw_only=True)
class PrismCfg:
    """A wedge of glass that turns about the sensor's x axis, seen by the beam as air, glass, air."""

    wedge_deg: float
    """Angle between its faces [deg], 0 < wedge < 45."""

    turns_hz: float
    """Turns per second about +x [Hz], negative for the other sense."""

    refractive_index: float
    """Of the glass at the wavelength of the laser, > 1."""

    inclined_face: str = "entry"
    """Face that is inclined, ``entry`` or ``exit``; the other is normal to the x axis."""

    def __post_init__(self) -> None:
        require_finite(self, "turns_hz")
        require(self, "wedge_deg", 0.0 < self.wedge_deg < 45.0, "must lie between 0 and 45 degrees")
        require(self, "refractive_index", 1.0 < self.refractive_index < inf, "must be > 1 and finite")
        require_choice(self, "inclined_face", ("entry", "exit"))


@dataclass(frozen=True, kw_only=True)
class RosetteCfg(RangeSensorCfg):
    """A scan that does not repeat from frame to frame: H lasers, each with W pulses in a frame, columns in order of time.

    A frame lasts ``1 / rate_hz`` and ends with its capture: column i of frame k is measured at ``(k W + i + 1) / (W rate_hz)``,
    k counted from the reset of the environment. Each column sees robot and obstacles where they were then, as a turning lidar
    does (``LidarCfg.scan_s``). After ``frames`` frames the scan repeats.
    """

    model: str = "rosette"
    """Name of this model in a file."""

    prisms: tuple[PrismCfg, ...] = ()
    """Prisms in the order of the beam. Exactly one of this and ``path`` is given."""

    lasers_deg: tuple[Angles, ...] = ((0.0, 0.0),)
    """Azimuth and elevation of each laser before the prisms [deg], H of them, within +-45."""

    path: str | None = None
    """CSV file with the rays in order of time, one a line, under the header ``azimuth_deg,elevation_deg`` or ``x,y,z``; of H
    lasers the rays of one pulse follow each other. In a YAML file relative to that file. Scans that makers publish
    (for example of the Livox Mid-360 and Horizon) can be given so. Needs ``frames`` W H lines."""

    frames: int = 100
    """Frames K in the table, >= 1: 12 bytes a ray."""

    scan_columns: int = 128
    """Neighbouring columns that share one pose, that of the middle of their time, from 1 (exact) to W. Multiples of 128 are
    traced fastest; each group of columns holds 52 bytes for every part of the scene in every environment."""

    def __post_init__(self) -> None:
        super().__post_init__()
        require_count(self, "frames", "scan_columns", most=MAX_MADE)
        require(self, "rate_hz", self.rate_hz is not None, "must be given, as a frame lasts 1 / rate_hz")
        require_choice(self, "kind", ("range",))
        if bool(self.prisms) == (self.path is not None):
            raise ConfigError("RosetteCfg: give exactly one of prisms and path")
        holds = self.path is not None or len(self.lasers_deg) == self.height
        require(self, "lasers_deg", holds, f"needs height = {self.height} lasers")
        holds = all(-45.0 <= angle <= 45.0 for laser in self.lasers_deg for angle in laser)
        require(self, "lasers_deg", holds, "must lie within +-45 degrees")
        require(self, "scan_columns", self.scan_columns <= self.width, f"must be at most width = {self.width}")

    @property
    def column_s(self) -> float:
        """Time between neighbouring columns [s]."""
        assert self.rate_hz is not None
        return 1.0 / (self.rate_hz * self.width)

    @property
    def scan_clockwise(self) -> bool:
        """Whether the last column is that of the capture: always."""
        return True
