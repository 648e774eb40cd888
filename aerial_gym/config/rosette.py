"""Lidars with beams refracted by rotating prisms, whose rays differ between frames (Livox Mid-40, Mid-70, Avia).

Frame and letters: those of ``range_sensor``; K frames of the scan, P prisms.
"""

from dataclasses import dataclass
from math import inf

from aerial_gym.config.checks import MAX_MADE, require_count, require_finite
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
        if not 0.0 < self.wedge_deg < 45.0:
            raise ConfigError(f"PrismCfg.wedge_deg = {self.wedge_deg!r}: must lie between 0 and 45 degrees")
        if not 1.0 < self.refractive_index < inf:
            raise ConfigError(f"PrismCfg.refractive_index = {self.refractive_index!r}: must be > 1 and finite")
        if self.inclined_face not in ("entry", "exit"):
            raise ConfigError(f"PrismCfg.inclined_face = {self.inclined_face!r}: must be entry or exit")


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
        if self.rate_hz is None:
            raise ConfigError("RosetteCfg.rate_hz is not given: a frame lasts 1 / rate_hz")
        if self.kind != "range":
            raise ConfigError(f"RosetteCfg.kind = {self.kind!r}: must be 'range'")
        if bool(self.prisms) == (self.path is not None):
            raise ConfigError("RosetteCfg: give exactly one of prisms and path")
        if self.path is None and len(self.lasers_deg) != self.height:
            raise ConfigError(
                f"RosetteCfg.lasers_deg has {len(self.lasers_deg)} lasers, expected height = {self.height}"
            )
        if not all(-45.0 <= angle <= 45.0 for laser in self.lasers_deg for angle in laser):
            raise ConfigError(f"RosetteCfg.lasers_deg = {self.lasers_deg!r}: must lie within +-45 degrees")
        if self.scan_columns > self.width:
            raise ConfigError(f"RosetteCfg.scan_columns = {self.scan_columns!r}: must be at most width = {self.width}")

    @property
    def column_s(self) -> float:
        """Time between neighbouring columns [s]."""
        assert self.rate_hz is not None
        return 1.0 / (self.rate_hz * self.width)

    @property
    def scan_clockwise(self) -> bool:
        """Whether the last column is that of the capture: always."""
        return True
