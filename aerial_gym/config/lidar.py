"""Sensors that sample angles: lidars, time-of-flight matrices, radar-like sensors, rosettes, and arbitrary lists of rays.

A rosette is a lidar with beams refracted by turning prisms, whose rays differ between frames (Livox Mid-40, Mid-70, Avia).
Frame and letters: those of ``range_sensor``; K frames of the scan, P prisms.
Azimuth turns from x towards y (left), elevation from the x-y plane towards z.
"""

from dataclasses import dataclass
from itertools import pairwise
from math import inf

from aerial_gym.config import checks
from aerial_gym.config.checks import MAX_MADE, Vec3
from aerial_gym.config.range_sensor import RangeSensorCfg
from aerial_gym.errors import ConfigError


@dataclass(frozen=True, kw_only=True)
class LidarCfg(RangeSensorCfg):
    """A grid of azimuths (columns, falling from left to right) and elevations (rows, falling from top to bottom).

    An interval holds both of its ends and equal steps between them, with three exceptions. One row or column looks at the
    middle. A full turn, whose ends are the same direction, keeps half a step from both. An elevation interval that ends at
    +-90 degrees, where all columns look the same way, keeps half a step from that end.
    """

    model: str = "lidar"  # Name of this model in a file
    azimuth_low_deg: float = -180.0  # Azimuth at the right [deg], within +-360
    azimuth_high_deg: float = 180.0  # Azimuth at the left [deg], > azimuth_low_deg, by at most 360
    elevation_low_deg: float | None = None  # Elevation of the lowest row [deg], within +-90; or `beam_elevations_deg`
    elevation_high_deg: float | None = None  # Elevation of the highest row [deg], > elevation_low_deg, within +-90

    beam_elevations_deg: tuple[float, ...] | None = None
    """Elevation of every row [deg], H of them, within +-90, each smaller than the one before: row 0 is on top."""

    beam_azimuths_deg: tuple[float, ...] | None = None
    """Azimuth offset of every row from its column [deg], H of them, within +-90; None: 0. A column is still
    measured at one time."""

    cells: bool = False
    """True: the intervals are divided into W x H equal cells, and a ray looks at the middle of each, as zones of a
    time-of-flight matrix do. False: the intervals hold their ends."""

    scan_s: float | None = None
    """Time of one revolution [s], > 0, at a constant rate: a column b away from the last one was measured
    ``scan_s b / 360 deg`` before the capture, from where the sensor was then. None: all at once.

    Robot and obstacles came to where they are at the capture with the velocities that they have then. Distances, and points
    and normals in the frame ``sensor``, belong to the sensor as it was at the column's own time, as drivers give them;
    those in the frame ``world`` are where they really were, which is what perfect deskewing gives."""

    scan_clockwise: bool = True
    """Sense of turning, seen from the sensor's +z. True: azimuth falls, columns come from left to right, and the right one at
    the capture. False: they come from right to left, and the left one at the capture."""

    scan_columns: int = 1
    """Neighbouring columns that share one pose, that of the middle of their time, >= 1. With 1 the motion is exact; more need
    less memory and time (``docs/results/rendering.md``): each group of columns holds 52 bytes for every part of the scene in
    every environment."""

    def __post_init__(self) -> None:
        super().__post_init__()
        low, high = self.azimuth_low_deg, self.azimuth_high_deg
        rule = f"with azimuth_high_deg = {high!r} needs -360 <= low < high <= 360 and at most one turn between them"
        checks.require(self, "azimuth_low_deg", -360.0 <= low < high <= 360.0 and high - low <= 360.0, rule)
        if self.beam_elevations_deg is None:
            self._check_elevation_interval()
        else:
            self._check_beams(self.beam_elevations_deg)
        self._check_beam_azimuths()
        checks.require_positive(self, "scan_s")
        holds = isinstance(self.scan_columns, int) and 1 <= self.scan_columns <= self.width
        checks.require(self, "scan_columns", holds, f"must be a whole number from 1 to width = {self.width}")

    @property
    def full_turn(self) -> bool:
        """Whether the azimuths close a circle."""
        return self.azimuth_high_deg - self.azimuth_low_deg >= 360.0

    @property
    def column_duration_s(self) -> float | None:
        """Time between neighbouring columns [s]; None: all are measured at once."""
        if self.scan_s is None:
            return None
        steps = self.width if self.full_turn else max(self.width - 1, 1)
        return self.scan_s * (self.azimuth_high_deg - self.azimuth_low_deg) / 360.0 / steps

    def _check_beam_azimuths(self) -> None:
        given = self.beam_azimuths_deg
        holds = given is None or (len(given) == self.height and all(-90.0 <= angle <= 90.0 for angle in given))
        checks.require(self, "beam_azimuths_deg", holds, f"needs height = {self.height} angles within +-90 degrees")
        if self.cells and self.beam_elevations_deg is not None:
            raise ConfigError("LidarCfg: give cells or beam_elevations_deg, not both")

    def _check_elevation_interval(self) -> None:
        low, high = self.elevation_low_deg, self.elevation_high_deg
        if low is None or high is None:
            raise ConfigError("LidarCfg: give elevation_low_deg and elevation_high_deg, or beam_elevations_deg")
        rule = f"with elevation_high_deg = {high!r} needs -90 <= low < high <= 90"
        checks.require(self, "elevation_low_deg", -90.0 <= low < high <= 90.0, rule)

    def _check_beams(self, beams: tuple[float, ...]) -> None:
        if self.elevation_low_deg is not None or self.elevation_high_deg is not None:
            raise ConfigError("LidarCfg: give elevation limits or beam_elevations_deg, not both")
        name, ordered = "beam_elevations_deg", all(above > below for above, below in pairwise(beams))
        checks.require(self, name, len(beams) == self.height, f"needs height = {self.height} entries")
        checks.require(self, name, all(-90.0 <= beam <= 90.0 for beam in beams), "must lie within +-90 degrees")
        checks.require(self, name, ordered, "must fall from entry to entry, row 0 is on top")


@dataclass(frozen=True, kw_only=True)
class RayTableCfg(RangeSensorCfg):
    """Any H x W rays, in the order of the image: row 0 from left to right, then row 1.

    Rays are traced in small groups of neighbouring pixels: a list in which neighbours look the same way is faster.
    """

    model: str = "ray_table"  # Name of this model in a file

    path: str | None = None
    """CSV file with one ray a line under the header ``x,y,z`` or ``azimuth_deg,elevation_deg``; in a YAML file relative to
    that file. Exactly one of this and ``rays`` is given."""

    rays: tuple[Vec3, ...] | None = None  # Directions, sensor frame, H * W of them, of any length but 0

    def __post_init__(self) -> None:
        super().__post_init__()
        if (self.path is None) == (self.rays is None):
            raise ConfigError("RayTableCfg: give exactly one of path and rays")
        if self.rays is None:
            return
        checks.require_finite(self, "rays")
        count = self.height * self.width
        if len(self.rays) != count:
            raise ConfigError(f"RayTableCfg.rays has {len(self.rays)} rays, expected height * width = {count}")
        for i, ray in enumerate(self.rays):
            if not any(ray):
                raise ConfigError(f"RayTableCfg.rays[{i}] = {ray!r}: must not be zero")


Angles = tuple[float, float]


@dataclass(frozen=True, kw_only=True)
class PrismCfg:
    """A wedge of glass that turns about the sensor's x axis, seen by the beam as air, glass, air."""

    wedge_deg: float  # Angle between its faces [deg], 0 < wedge < 45
    turns_hz: float  # Turns per second about +x [Hz], negative for the other sense
    refractive_index: float  # Of the glass at the wavelength of the laser, > 1
    inclined_face: str = "entry"  # Face that is inclined, `entry` or `exit`; the other is normal to the x axis

    def __post_init__(self) -> None:
        checks.require_finite(self, "turns_hz")
        checks.require(self, "wedge_deg", 0.0 < self.wedge_deg < 45.0, "must lie between 0 and 45 degrees")
        checks.require(self, "refractive_index", 1.0 < self.refractive_index < inf, "must be > 1 and finite")
        checks.require_choice(self, "inclined_face", ("entry", "exit"))


@dataclass(frozen=True, kw_only=True)
class RosetteCfg(RangeSensorCfg):
    """A scan that does not repeat from frame to frame: H lasers, each with W pulses in a frame, columns in order of time.

    A frame lasts ``1 / rate_hz`` and ends with its capture: column i of frame k is measured at ``(k W + i + 1) / (W rate_hz)``,
    k counted from the reset of the environment. Each column sees robot and obstacles where they were then, as a turning lidar
    does (``LidarCfg.scan_s``). After ``frames`` frames the scan repeats.
    """

    model: str = "rosette"  # Name of this model in a file
    prisms: tuple[PrismCfg, ...] = ()  # Prisms in the order of the beam. Exactly one of this and `path` is given
    lasers_deg: tuple[Angles, ...] = ((0.0, 0.0),)  # Azimuth, elevation of H lasers before the prisms [deg], +-45

    path: str | None = None
    """CSV file with the rays in order of time, one a line, under the header ``azimuth_deg,elevation_deg`` or ``x,y,z``; of H
    lasers the rays of one pulse follow each other. In a YAML file relative to that file. Scans that makers publish
    (for example of the Livox Mid-360 and Horizon) can be given so. Needs ``frames`` W H lines."""

    frames: int = 100  # Frames K in the table, >= 1: 12 bytes a ray

    scan_columns: int = 128
    """Neighbouring columns that share one pose, that of the middle of their time, from 1 (exact) to W. Multiples of 128 are
    traced fastest; each group of columns holds 52 bytes for every part of the scene in every environment."""

    def __post_init__(self) -> None:
        super().__post_init__()
        checks.require_count(self, "frames", "scan_columns", most=MAX_MADE)
        checks.require(self, "rate_hz", self.rate_hz is not None, "must be given, as a frame lasts 1 / rate_hz")
        checks.require_choice(self, "kind", ("range",))
        if bool(self.prisms) == (self.path is not None):
            raise ConfigError("RosetteCfg: give exactly one of prisms and path")
        holds = self.path is not None or len(self.lasers_deg) == self.height
        checks.require(self, "lasers_deg", holds, f"needs height = {self.height} lasers")
        holds = all(-45.0 <= angle <= 45.0 for laser in self.lasers_deg for angle in laser)
        checks.require(self, "lasers_deg", holds, "must lie within +-45 degrees")
        checks.require(self, "scan_columns", self.scan_columns <= self.width, f"must be at most width = {self.width}")

    @property
    def column_duration_s(self) -> float:
        """Time between neighbouring columns [s]."""
        assert self.rate_hz is not None
        return 1.0 / (self.rate_hz * self.width)

    @property
    def scan_clockwise(self) -> bool:
        """Whether the last column is that of the capture: always."""
        return True
