"""How the columns of a foreign log become a flight log: names, units, frames and the order of the quaternion.

A mapping is a YAML file. The layout of this package is one itself, ``mappings/aerial_gym.yaml``.
"""

from dataclasses import dataclass, fields
from pathlib import Path

from aerial_gym.config import load
from aerial_gym.errors import ConfigError, UnknownNameError

MAPPING_DIR = Path(__file__).parent / "mappings"
"""Folder of the mappings that come with the package."""

UNITS: dict[str, float] = {
    "si": 1.0,
    "ms": 1e-3,
    "us": 1e-6,
    "ns": 1e-9,
    "mm": 1e-3,
    "cm": 1e-2,
    "deg/s": 0.017453292519943295,
    "g": 9.80665,
    "rpm": 0.10471975511965977,
    "rev/s": 6.283185307179586,
}
"""What a value in that unit is multiplied by to be SI. ``g``: standard gravity, BIPM (2019), The SI, table 8."""

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
    """Longest run of empty fields [s] that is filled by straight lines; 0 refuses the first empty field."""

    def __post_init__(self) -> None:
        if not self.columns:
            raise ConfigError("ColumnsCfg.columns: must name at least one column")
        if self.unit not in UNITS:
            raise ConfigError(f"ColumnsCfg.unit = {self.unit!r}: must be one of {', '.join(UNITS)}")
        if not 0.0 <= self.fill_gap_s <= 1.0:
            raise ConfigError(f"ColumnsCfg.fill_gap_s = {self.fill_gap_s!r}: must lie in [0, 1] s")


@dataclass(frozen=True, kw_only=True)
class LogMapping:
    """Layout of a log. A quantity that is not mapped is one that the log does not have."""

    summary: str
    """One line for people."""

    time: ColumnsCfg
    """Time [s]."""

    attitude: ColumnsCfg
    """Unit quaternion; name its columns in the order x, y, z, w, however the file orders them."""

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
    """Commanded rotor speeds [rad/s]."""

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
        for name, count in (("time", 1), ("attitude", 4), *((key, 3) for key in VECTORS)):
            quantity = getattr(self, name)
            if quantity is not None and len(quantity.columns) != count:
                raise ConfigError(f"LogMapping.{name}.columns = {quantity.columns!r}: must name {count} columns")

    def quantities(self) -> dict[str, ColumnsCfg]:
        """Return the mapped quantities by field name, time first."""
        values = {field.name: getattr(self, field.name) for field in fields(self)}
        return {name: value for name, value in values.items() if isinstance(value, ColumnsCfg)}


VECTORS = ("position", "lin_vel", "ang_vel", "specific_force")


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
