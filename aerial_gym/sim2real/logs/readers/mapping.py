"""Mappings from the columns of a log to a flight log: names, units and frames, and the conversion of frames.

A mapping is a YAML file; the package's own layout is ``mappings/aerial_gym.yaml``. Letters: T samples.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field, fields
from math import inf, isfinite
from pathlib import Path

import numpy as np

from aerial_gym.config import load
from aerial_gym.errors import ConfigError, UnknownNameError
from aerial_gym.sim2real.arrays import Array

MAPPING_DIR = Path(__file__).parents[1] / "mappings"  # Folder of the built-in mappings
UNIT_G = 9.80665  # Standard gravity as a unit [m/s²], independent of the place: BIPM (2019), The SI, table 8

UNITS: dict[str, float] = {
    "si": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9, "mm": 1e-3, "cm": 1e-2, "ft": 0.3048, "mm/s": 1e-3, "cm/s": 1e-2,
    "ft/s": 0.3048, "km/h": 1.0 / 3.6, "mph": 0.44704, "kn": 1.852 / 3.6, "deg/s": 0.017453292519943295, "g": UNIT_G,
    "rpm": 0.10471975511965977, "rev/s": 6.283185307179586,
}  # fmt: skip
"""Factors to SI units. Foot and mile are international: NIST SP 811 (2008), B.8."""

BODY_FRAMES = ("flu", "frd")
WORLD_FRAMES = ("enu", "ned")
DIRECTIONS = ("body_to_world", "world_to_body")


@dataclass(frozen=True, kw_only=True)
class ColumnsCfg:
    """Columns of one quantity."""

    columns: tuple[str, ...]
    """Names in the order x, y, z (and w); one name with ``{n}`` expands to all numbers 1, 2, 3, ... in the file."""

    unit: str = "si"  # Unit in the file, a key of UNITS

    fill_gap_s: float = 0.0
    """Longest run of empty fields [s] that is interpolated (commands: held); 0 refuses any empty field."""

    times: str | None = None  # Column that multiplies every value, such as the battery voltage of a duty cycle
    over: str | None = None  # Column that divides every value, such as the setpoint at hover
    power: float = 1.0  # Exponent of the product: 0.5 converts a thrust to a speed
    gain: float = 1.0  # Factor of the result
    offset: float = 0.0  # Added to the result; a raw value of 0 stays 0, because a motor that is off does not turn

    repeat: int = 1
    """Copies of a single column: 4 for a collective command of four rotors. Torques are then not compared."""

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


@dataclass(frozen=True, kw_only=True)
class LogMapping:
    """Layout of a log; unmapped quantities count as not measured."""

    summary: str  # One-line description
    time: ColumnsCfg  # Time [s]

    attitude: ColumnsCfg | None = None
    """Unit quaternion; name its columns in the order x, y, z, w, whatever their order in the file. Without attitude,
    position and velocity it is integrated from the angular velocity, which suffices for body-axis channels."""

    position: ColumnsCfg | None = None  # Body origin [m], world
    lin_vel: ColumnsCfg | None = None  # Velocity of the body origin [m/s], world
    ang_vel: ColumnsCfg | None = None  # Angular velocity [rad/s], body

    specific_force: ColumnsCfg | None = None
    """Specific force at the body origin [m/s²], body: +9.81 on z (flu) at hover."""

    rotor_speed: ColumnsCfg | None = None  # Measured rotor speeds [rad/s]
    rotor_command: ColumnsCfg | None = None  # Commanded rotor speeds [rad/s], in force mode thrusts [N]

    rotor_share: ColumnsCfg | None = None
    """Commands as shares of the largest rotor speed, 0 to 1, as firmwares log them; ``rotor_command`` comes first."""

    battery: ColumnsCfg | None = None  # Battery voltage [V]
    armed: ColumnsCfg | None = None  # 1 while the vehicle is armed, else 0: the file is split there
    landed: ColumnsCfg | None = None  # 1 while the vehicle stands on the ground, else 0: the file is split there
    ground_height: ColumnsCfg | None = None  # Height of the ground [m], world, constant; 0 if unmapped or missing
    ceiling_height: ColumnsCfg | None = None  # Height of the ceiling [m], world, constant
    other_position: ColumnsCfg | None = None  # Position of another vehicle nearby [m], world

    position_setpoint: ColumnsCfg | None = None
    """Setpoint of the position [m], world; empty fields are allowed in all setpoints."""

    velocity_setpoint: ColumnsCfg | None = None  # Velocity of the position setpoint [m/s], world
    yaw_setpoint: ColumnsCfg | None = None  # Setpoint of the heading [rad], world
    attitude_setpoint: ColumnsCfg | None = None  # Setpoint of the attitude, named as those of ``attitude``
    rate_setpoint: ColumnsCfg | None = None  # Setpoint of the angular velocity [rad/s], body

    thrust_setpoint: ColumnsCfg | None = None
    """Collective thrust command as a share of the largest, 0 to 1, before the firmware's thrust curve."""

    specific_thrust_setpoint: ColumnsCfg | None = None  # Collective thrust command per mass [m/s²], upwards positive

    companion: Mapping[str, str] = field(default_factory=dict)
    """Replacements in the file name that give the log of another vehicle, flown together on the same clock. Its position
    becomes ``other_position``."""

    wind: Mapping[str, tuple[float, float, float]] = field(default_factory=dict)
    """Known steady wind [m/s], world, such as that of a wind tunnel, by a text in the file name."""

    lift_off_m: float = 0.0
    """Largest distance [m] from a height at which the vehicle stood (at rest, less than half its weight as thrust). Rows
    within it count as on the ground and are not compared. 0: heights are ignored."""

    hover_above_m: float | None = None
    """Height [m], world, above which commanded speeds are scaled so that declared and measured mean thrust agree. For
    commands whose thrust varies with vehicle and battery."""

    torques: bool = True
    """Whether the logs resolve torques; false if gyro or commands were logged too slowly, so only forces count."""

    lacks: str = ""  # One sentence on missing quantities and the consequence, shown in findings and refusals
    body_frame: str = "flu"  # Axes of body quantities in the file: flu (x forward, y left, z up) or frd

    attitude_body_frame: str | None = None
    """Body axes to which the attitude refers, flu or frd, if others than ``body_frame``, those of the inertial sensors."""

    world_frame: str = "enu"  # Axes of world quantities in the file: enu (z up) or ned (z down)

    attitude_direction: str = "body_to_world"
    """Direction of the rotation by the quaternion: body_to_world or world_to_body."""

    source: str  # Reference that describes the layout

    def __post_init__(self) -> None:
        for name, known in (
            ("body_frame", BODY_FRAMES),
            ("attitude_body_frame", (*BODY_FRAMES, None)),
            ("world_frame", WORLD_FRAMES),
            ("attitude_direction", DIRECTIONS),
        ):
            if getattr(self, name) not in known:
                raise ConfigError(
                    f"LogMapping.{name} = {getattr(self, name)!r}: must be one of {', '.join(map(str, known))}"
                )
        counts = dict.fromkeys(SCALARS, 1) | dict.fromkeys(VECTORS, 3) | dict.fromkeys(QUATERNIONS, 4)
        for name, count in counts.items():
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


COLUMNS: dict[str, tuple[str, ...]] = {
    "position": ("p_x", "p_y", "p_z"),
    "attitude": ("q_x", "q_y", "q_z", "q_w"),
    "lin_vel": ("v_x", "v_y", "v_z"),
    "ang_vel": ("omega_x", "omega_y", "omega_z"),
    "specific_force": ("acc_x", "acc_y", "acc_z"),
    "rotor_speed": ("rotor_{n}",),
    "rotor_command": ("cmd_{n}",),
    "battery": ("vbat",),
}
"""Columns of each measured quantity in the layout of this package, beside the time ``t``."""

HEIGHTS = ("ground_height", "ceiling_height")
QUATERNIONS = ("attitude", "attitude_setpoint")
SCALARS = (
    "time",
    "battery",
    "armed",
    "landed",
    *HEIGHTS,
    "yaw_setpoint",
    "thrust_setpoint",
    "specific_thrust_setpoint",
)
VECTORS = (
    *("position", "lin_vel", "ang_vel", "specific_force", "other_position"),
    *("position_setpoint", "velocity_setpoint", "rate_setpoint"),
)


def mapping_names() -> tuple[str, ...]:
    """Return the names of the built-in mappings."""
    return tuple(sorted(path.stem for path in MAPPING_DIR.glob("*.yaml")))


def find_mapping(name: str | Path) -> LogMapping:
    """Return a built-in mapping by name, or the one in a file that ends in ``.yaml``.

    Raise ``UnknownNameError`` if the name is unknown. Raise ``ConfigError`` if the file is unreadable or invalid.
    """
    if str(name).endswith((".yaml", ".yml")):
        return load(LogMapping, name)
    if str(name) not in mapping_names():
        known = ", ".join(mapping_names())
        raise UnknownNameError(f"no log mapping {str(name)!r}. Known: {known}; or give a file that ends in .yaml")
    return load(LogMapping, MAPPING_DIR / f"{name}.yaml")


def enu_from_ned(vectors: Array) -> Array:
    """Return vectors (T, 3) in world axes east, north, up."""
    return vectors[:, [1, 0, 2]] * (1.0, 1.0, -1.0)


def flu_from_frd(vectors: Array) -> Array:
    """Return vectors (T, 3) in body axes forward, left, up."""
    return vectors * (1.0, -1.0, -1.0)


def attitude_with_world_enu(attitude: Array) -> Array:
    """Return quaternions (T, 4), xyzw, of body to ENU from those of body to NED: ``q_ned_to_enu q``."""
    x, y, z, w = attitude.T  # q_ned_to_enu = (1, 1, 0, 0) / sqrt(2), xyzw
    return np.stack((w + z, w - z, y - x, -x - y), axis=1) / np.sqrt(2.0)


def attitude_with_body_flu(attitude: Array) -> Array:
    """Return quaternions (T, 4), xyzw, of body FLU to world from those of body FRD: ``q q_flu_to_frd``."""
    x, y, z, w = attitude.T  # q_flu_to_frd = (1, 0, 0, 0), xyzw
    return np.stack((w, z, -y, -x), axis=1)


def attitude_from_ned_frd(wxyz: Array) -> Array:
    """Return quaternions (T, 4), xyzw, of FLU to ENU from those of FRD to NED, w first, as PX4 and ArduPilot log them."""
    return attitude_with_body_flu(attitude_with_world_enu(wxyz[:, [1, 2, 3, 0]]))


def quantity_from_ned_frd(quantity: str, values: Array) -> Array:
    """Return a quantity of a log channel in this package's axes, from NED and FRD, attitudes with w first."""
    convert = {"attitude": attitude_from_ned_frd, "position": enu_from_ned, "lin_vel": enu_from_ned}
    return convert.get(quantity, flu_from_frd)(values)


def to_package_frames(values: dict[str, Array], layout: LogMapping) -> dict[str, Array]:
    """Return the quantities in world ENU and body FLU, with quaternions from body to world."""
    result = dict(values)
    if layout.attitude_direction == "world_to_body" and "attitude" in result:
        result["attitude"] = result["attitude"] * (-1.0, -1.0, -1.0, 1.0)
    if layout.world_frame == "ned":
        result |= {n: enu_from_ned(result[n]) for n in ("position", "lin_vel", "other_position") if n in result}
        result |= {n: attitude_with_world_enu(q) for n, q in result.items() if n == "attitude"}
    if layout.body_frame == "frd":
        result |= {name: flu_from_frd(result[name]) for name in ("ang_vel", "specific_force") if name in result}
    if (layout.attitude_body_frame or layout.body_frame) == "frd":
        result |= {n: attitude_with_body_flu(q) for n, q in result.items() if n == "attitude"}
    return result
