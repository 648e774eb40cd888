"""How the columns of a foreign log become a flight log: names, units, frames and the order of the quaternion.

A mapping is a YAML file. The layout of this package is one itself, ``mappings/aerial_gym.yaml``.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field, fields
from math import inf, isfinite
from pathlib import Path

from aerial_gym.config import load
from aerial_gym.errors import ConfigError, UnknownNameError

MAPPING_DIR = Path(__file__).parents[1] / "mappings"
"""Folder of the mappings that come with the package."""

UNIT_G = 9.80665
"""The unit g [m/s²], exact whatever gravity a place has: BIPM (2019), The SI, table 8."""

UNITS: dict[str, float] = {
    "si": 1.0,
    "ms": 1e-3,
    "us": 1e-6,
    "ns": 1e-9,
    "mm": 1e-3,
    "cm": 1e-2,
    "ft": 0.3048,
    "mm/s": 1e-3,
    "cm/s": 1e-2,
    "ft/s": 0.3048,
    "km/h": 1.0 / 3.6,
    "mph": 0.44704,
    "kn": 1.852 / 3.6,
    "deg/s": 0.017453292519943295,
    "g": UNIT_G,
    "rpm": 0.10471975511965977,
    "rev/s": 6.283185307179586,
}
"""What a value in that unit is multiplied by to be SI. Foot and mile are international: NIST SP 811 (2008), B.8."""

BODY_FRAMES = ("flu", "frd")
WORLD_FRAMES = ("enu", "ned")
DIRECTIONS = ("body_to_world", "world_to_body")


@dataclass(frozen=True, kw_only=True)
class ColumnsCfg:
    """Columns of one quantity."""

    columns: tuple[str, ...]
    """Names in the order x, y, z (and w); one name with ``{n}`` stands for 1, 2, 3, ... as far as the file has them."""

    unit: str = "si"
    """Unit in the file, one of UNITS."""

    fill_gap_s: float = 0.0
    """Longest run of empty fields [s] that is filled by straight lines (commands: held); 0 refuses the first empty field."""

    times: str | None = None
    """Column that every value is multiplied by, such as the battery voltage of a duty cycle."""

    over: str | None = None
    """Column that every value is divided by, such as the setpoint at hover."""

    power: float = 1.0
    """Power that the product is raised to: 0.5 makes a speed of a thrust."""

    gain: float = 1.0
    """Factor on the result."""

    offset: float = 0.0
    """Added to the result, but a raw value of 0 stays 0: a motor that is off does not turn."""

    repeat: int = 1
    """Times that a single column stands for: 4 for a collective command of four rotors. Torques are then not compared."""

    def __post_init__(self) -> None:
        if not self.columns:
            raise ConfigError("ColumnsCfg.columns: must name at least one column")
        if self.unit not in UNITS:
            raise ConfigError(f"ColumnsCfg.unit = {self.unit!r}: must be one of {', '.join(UNITS)}")
        if not 0.0 <= self.fill_gap_s <= 1.0:
            raise ConfigError(f"ColumnsCfg.fill_gap_s = {self.fill_gap_s!r}: must lie in [0, 1] s")
        for name in ("power", "gain", "offset"):
            if not isfinite(getattr(self, name)):
                raise ConfigError(f"ColumnsCfg.{name} = {getattr(self, name)!r}: must be finite")
        if self.gain == 0.0 or self.power == 0.0:
            raise ConfigError(f"ColumnsCfg: gain = {self.gain!r} and power = {self.power!r} must not be 0")
        if self.repeat < 1 or (self.repeat > 1 and len(self.columns) > 1):
            raise ConfigError(f"ColumnsCfg.repeat = {self.repeat!r}: must be >= 1, and 1 for more than one column")

    @property
    def plain(self) -> bool:
        """Whether values are in the file as they are, up to their unit."""
        untouched = self.times is None and self.over is None
        return untouched and (self.power, self.gain, self.offset, self.repeat) == (1.0, 1.0, 0.0, 1)


@dataclass(frozen=True, kw_only=True)
class LogMapping:
    """Layout of a log. A quantity that is not mapped is one that the log does not have."""

    summary: str
    """One line for people."""

    time: ColumnsCfg
    """Time [s]."""

    attitude: ColumnsCfg | None = None
    """Unit quaternion; name its columns in the order x, y, z, w, however the file orders them. Without it, and without
    position and velocity, it is integrated from the angular velocity: enough for what is compared in body axes."""

    position: ColumnsCfg | None = None
    """Body origin [m], world."""

    lin_vel: ColumnsCfg | None = None
    """Velocity of the body origin [m/s], world."""

    ang_vel: ColumnsCfg | None = None
    """Angular velocity [rad/s], body."""

    specific_force: ColumnsCfg | None = None
    """Specific force at the body origin [m/s²], body: +9.81 on z (flu) at hover."""

    rotor_speed: ColumnsCfg | None = None
    """Measured rotor speeds [rad/s]."""

    rotor_command: ColumnsCfg | None = None
    """Commanded rotor speeds [rad/s], in force mode thrusts [N]."""

    battery: ColumnsCfg | None = None
    """Battery voltage [V]."""

    ground_height: ColumnsCfg | None = None
    """Level of the ground [m], world, the same in every row; 0 if it is not mapped or not in the file."""

    ceiling_height: ColumnsCfg | None = None
    """Level of the ceiling [m], world, the same in every row."""

    other_position: ColumnsCfg | None = None
    """Position of another vehicle that flies near [m], world."""

    companion: Mapping[str, str] = field(default_factory=dict)
    """Text in the name of a file, and what stands in its place in that of another vehicle flown at the same time on the same
    clock: its position becomes ``other_position``."""

    wind: Mapping[str, tuple[float, float, float]] = field(default_factory=dict)
    """Text in the name of a file, and the steady wind [m/s], world, that was known in that flight, as in a wind tunnel."""

    lift_off_m: float = 0.0
    """Where the log shows that the vehicle stood (at rest, its rotors giving less than half its weight), it also stands in all
    rows within this of that height [m]: they are not compared, for the ground pushes as well. 0: heights tell nothing."""

    hover_above_m: float | None = None
    """Where given, the commanded speeds of each flight are scaled so that the declared thrust is the measured one on average in
    rows higher than this [m], world: for commands whose thrust differs from vehicle to vehicle and with the battery."""

    torques: bool = True
    """Whether these logs show what torques do; false where gyro or commands were logged too slowly: forces alone count."""

    lacks: str = ""
    """What these logs do not have and what follows, one sentence: it stands in the notes and in the message of a refusal."""

    body_frame: str = "flu"
    """Axes of body quantities in the file: flu (x forward, y left, z up) or frd."""

    world_frame: str = "enu"
    """Axes of world quantities in the file: enu (z up) or ned (z down)."""

    attitude_direction: str = "body_to_world"
    """What the quaternion turns into what."""

    source: str
    """Where this layout is described."""

    def __post_init__(self) -> None:
        for name, known in (
            ("body_frame", BODY_FRAMES),
            ("world_frame", WORLD_FRAMES),
            ("attitude_direction", DIRECTIONS),
        ):
            if getattr(self, name) not in known:
                raise ConfigError(f"LogMapping.{name} = {getattr(self, name)!r}: must be one of {', '.join(known)}")
        for name, count in (*((key, 1) for key in SCALARS), ("attitude", 4), *((key, 3) for key in VECTORS)):
            quantity = getattr(self, name)
            if quantity is not None and len(quantity.columns) != count:
                raise ConfigError(f"LogMapping.{name}.columns = {quantity.columns!r}: must name {count} columns")

        for text, other in self.companion.items():
            if not text or not set(other).isdisjoint("/\\\0"):
                raise ConfigError(
                    f"LogMapping.companion = {{{text!r}: {other!r}}}: needs text of the file's name, and what "
                    "stands in its place, without folders"
                )
        if self.hover_above_m is not None and not isfinite(self.hover_above_m):
            raise ConfigError(f"LogMapping.hover_above_m = {self.hover_above_m!r}: must be finite")
        if not 0.0 <= self.lift_off_m < inf:
            raise ConfigError(f"LogMapping.lift_off_m = {self.lift_off_m!r}: must be >= 0 and finite")
        for text, wind in self.wind.items():
            if not all(isfinite(speed) for speed in wind):
                raise ConfigError(f"LogMapping.wind.{text} = {wind!r}: must be finite")

    def quantities(self) -> dict[str, ColumnsCfg]:
        """Return the mapped quantities by field name, time first."""
        values = {entry.name: getattr(self, entry.name) for entry in fields(self)}
        return {name: value for name, value in values.items() if isinstance(value, ColumnsCfg)}


HEIGHTS = ("ground_height", "ceiling_height")
SCALARS = ("time", "battery", *HEIGHTS)
VECTORS = ("position", "lin_vel", "ang_vel", "specific_force", "other_position")


def mapping_names() -> tuple[str, ...]:
    """Return the names of the mappings that come with the package."""
    return tuple(sorted(path.stem for path in MAPPING_DIR.glob("*.yaml")))


def find_mapping(name: str | Path) -> LogMapping:
    """Return the mapping of that name, or the one in a file if ``name`` ends in ``.yaml``.

    Raises:
        UnknownNameError: If there is no such name.
        ConfigError: If the file cannot be read or says something impossible.
    """
    if str(name).endswith((".yaml", ".yml")):
        return load(LogMapping, name)
    if str(name) not in mapping_names():
        known = ", ".join(mapping_names())
        raise UnknownNameError(f"no log mapping {str(name)!r}. Known: {known}; or give a file that ends in .yaml")
    return load(LogMapping, MAPPING_DIR / f"{name}.yaml")
