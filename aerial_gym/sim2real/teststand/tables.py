"""CSV tables of a test stand: identification of columns and units, and plausibility checks.

Letters: T rows.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pandas as pd

from aerial_gym.errors import DataError
from aerial_gym.sim2real.arrays import Array
from aerial_gym.sim2real.logs.readers.mapping import UNIT_G

UNITS: dict[str, dict[str, float]] = {
    "speed": {"rad/s": 1.0, "rpm": np.pi / 30.0, "rev/s": 2.0 * np.pi},
    "thrust": {"N": 1.0, "mN": 1e-3, "gf": 1e-3 * UNIT_G, "kgf": UNIT_G},
    "torque": {"N m": 1.0, "mN m": 1e-3, "gf cm": 1e-5 * UNIT_G},
    "time": {"s": 1.0, "ms": 1e-3, "us": 1e-6},
    "angle": {"rad": 1.0, "deg": np.pi / 180.0},
}
"""Factors to SI units by kind of quantity."""

_SPEED = {
    "rad/s": ("omega", "speed", "rotor_speed", "{}_rad_s"),
    "rpm": ("rpm", "{}_rpm"),
    "rev/s": ("rps", "{}_rev_s"),
}
_THRUST = {"N": ("thrust", "force", "{}_n"), "mN": ("{}_mn",), "gf": ("{}_gf", "{}_g"), "kgf": ("{}_kgf", "{}_kg")}
_TORQUE = {"N m": ("torque", "moment", "{}_nm"), "mN m": ("{}_mnm", "{}_nmm"), "gf cm": ("{}_gcm",)}


def _units_by_column_name(patterns: Mapping[str, Sequence[str]], stems: Sequence[str]) -> dict[str, str]:
    """Return the unit by lower-case column name; ``{}`` in a pattern stands for each stem."""
    return {p.format(stem): unit for unit, texts in patterns.items() for p in texts for stem in stems}


KNOWN: dict[str, tuple[str, dict[str, str]]] = {
    "speed": ("speed", _units_by_column_name(_SPEED, ("omega", "speed", "rotor_speed")) | {"omega_mean": "rad/s"}),
    "thrust": ("thrust", _units_by_column_name(_THRUST, ("thrust", "force", "thrust_total"))),
    "torque": ("torque", _units_by_column_name(_TORQUE, ("torque", "moment"))),
    "time": ("time", {"t": "s", "time": "s", "t_s": "s", "time_s": "s", "t_ms": "ms", "time_ms": "ms", "t_us": "us"}),
    "command": (
        "speed",
        {"speed_cmd": "rad/s", "omega_cmd": "rad/s", "setpoint": "rad/s", "command": "rad/s", "cmd": "rad/s"}
        | {"rpm_cmd": "rpm", "cmd_rpm": "rpm", "setpoint_rpm": "rpm", "cmd_rad_s": "rad/s"},
    ),
    "measured": (
        "speed",
        {"speed_meas": "rad/s", "omega_meas": "rad/s", "measured": "rad/s", "omega": "rad/s", "speed": "rad/s"}
        | {"rpm_meas": "rpm", "measured_rpm": "rpm", "rpm": "rpm"},
    ),
    "angle": ("angle", {"elevation_rad": "rad", "angle_rad": "rad", "angle": "rad"} | {"angle_deg": "deg"}),
}
"""Kind of unit, and unit by lower-case column name, of every supported quantity."""


def read_columns(path: str | Path, *, given: Mapping[str, str], units: Mapping[str, str]) -> "Bench":
    """Return the table of a test stand file.

    Args:
        given: Column by quantity, as named by the user; other columns are found by their usual names.
        units: Unit by quantity, as named by the user.

    Raises:
        DataError: If the file, a column or a unit is missing or unknown.
    """
    try:
        table = pd.read_csv(path, encoding="utf-8-sig", skipinitialspace=True)
    except FileNotFoundError:
        raise DataError(f"{path}: no such file") from None
    except (OSError, UnicodeDecodeError, pd.errors.ParserError, pd.errors.EmptyDataError) as error:
        raise DataError(f"{path}: cannot be read as a CSV table with one header line ({error})") from None
    table.columns = [str(name).strip() for name in table.columns]
    for quantity, column in given.items():
        if column not in table.columns:
            raise DataError(f"{path}: has no column {column!r} for the {quantity}; it has {', '.join(table.columns)}")
    for quantity, unit in units.items():
        known = UNITS[KNOWN[quantity][0]]
        if unit not in known:
            raise DataError(f"unit {unit!r} of the {quantity}: must be one of {', '.join(known)}")
    return Bench(str(path), table, dict(given), dict(units))


@dataclass(frozen=True, eq=False)
class Bench:
    """A test stand file with access to quantities by meaning, in SI units."""

    path: str
    table: pd.DataFrame
    given: dict[str, str]  # Column by quantity, as named by the user
    units: dict[str, str]  # Unit by quantity, as named by the user

    def column_of_quantity(self, quantity: str) -> str | None:
        """Return the column of a quantity; None without one."""
        if quantity in self.given:
            return self.given[quantity]
        known = KNOWN[quantity][1]
        return next((name for name in self.table.columns if name.lower() in known), None)

    def values_of_quantity(self, quantity: str) -> Array:
        """Return a quantity in SI units, (T,)."""
        column = self.column_of_quantity(quantity)
        kind, known = KNOWN[quantity]
        if column is None:
            raise DataError(
                f"{self.path}: has no column for the {quantity}, such as {', '.join(list(known)[:4])}; it has "
                f"{', '.join(self.table.columns)}. Name the column and its unit with --columns and --units"
            )
        numbers = np.asarray(pd.to_numeric(self.table[column], errors="coerce"), dtype=np.float64)
        bad = np.flatnonzero(~np.isfinite(numbers))
        if bad.size:
            raise DataError(
                f"{self.path}, line {bad[0] + 2}: {column} = {self.table[column].iloc[bad[0]]!s} is no number; "
                "remove the row, or measure it again"
            )
        unit = self.units.get(quantity) or known.get(column.lower())
        if unit is None:
            raise DataError(
                f"{self.path}: the unit of column {column!r} is not known; give it: --units {quantity} UNIT"
            )
        return numbers * UNITS[kind][unit]


FASTEST = 12_000.0  # Largest plausible rotor speed [rad/s]: 115,000 rpm, above every hobby motor

POWER_PER_THRUST = (0.5, 120.0)
"""Plausible range of torque times speed over thrust at the highest speed [m/s]: induced velocity, 2 to 40 m/s for all sizes,
over the figure of merit, 0.3 to 0.8 (Leishman 2006, Principles of Helicopter Aerodynamics, section 2.8)."""


def check_plausibility_of_rotor_data(path: str, speed: Array, thrust: Array, torque: Array | None) -> None:
    """Raise ``DataError`` for implausible speeds, thrusts or torques; the message names the likely unit."""
    if np.any(speed < 0.0) or np.any(speed > FASTEST):
        raise DataError(
            f"{path}: speeds from {speed.min():.4g} to {speed.max():.4g} rad/s; must lie in [0, {FASTEST:g}]. "
            "If they are revolutions per minute, say so: --units speed rpm"
        )
    top = int(np.argmax(speed))
    if thrust[top] <= 0.0:
        raise DataError(f"{path}: thrust at the highest speed is {thrust[top]:.4g} N, must be > 0; invert its sign")
    if torque is None:
        return
    if torque[top] <= 0.0:
        raise DataError(f"{path}: torque at the highest speed is {torque[top]:.4g} N m, must be > 0; invert its sign")
    ratio, low, high = float(torque[top] * speed[top] / thrust[top]), *POWER_PER_THRUST
    if low <= ratio <= high:
        return
    guesses = [
        f"{quantity} in {unit}"
        for quantity, power in (("speed", 1), ("thrust", -1), ("torque", 1))
        for unit, factor in UNITS[quantity].items()
        if factor != 1.0 and low <= ratio * factor**power <= high
    ]
    raise DataError(
        f"{path}: power over thrust is {ratio:.3g} m/s at the highest speed; rotors have {low:g} to {high:g}, so a unit is "
        f"wrong. It would fit with {' or '.join(guesses) or 'none of the known units'} (--units QUANTITY UNIT)"
    )
