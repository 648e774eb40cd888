"""CSV tables of a test stand: identification of columns and units, and plausibility checks.

Letters: T rows.
"""

import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pandas as pd

from aerial_gym.errors import DataError
from aerial_gym.sim2real.arrays import Array
from aerial_gym.sim2real.logs.readers.mapping import UNIT_G

OUNCE_FORCE, INCH = 0.45359237 / 16.0 * UNIT_G, 0.0254  # [N], [m]

UNITS: dict[str, dict[str, float]] = {
    "speed": {"rad/s": 1.0, "rpm": np.pi / 30.0, "krpm": 1e3 * np.pi / 30.0, "rev/s": 2.0 * np.pi},
    "thrust": {"N": 1.0, "mN": 1e-3, "gf": 1e-3 * UNIT_G, "kgf": UNIT_G, "ozf": OUNCE_FORCE, "lbf": 16.0 * OUNCE_FORCE},
    "torque": {
        **{"N m": 1.0, "mN m": 1e-3, "N cm": 1e-2, "gf cm": 1e-5 * UNIT_G, "kgf cm": 1e-2 * UNIT_G},
        **{"ozf in": INCH * OUNCE_FORCE, "lbf in": INCH * 16.0 * OUNCE_FORCE},
    },
    "time": {"s": 1.0, "ms": 1e-3, "us": 1e-6},
    "power": {"W": 1.0, "kW": 1e3},
    "current": {"A": 1.0, "mA": 1e-3},
    "voltage": {"V": 1.0, "mV": 1e-3},
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


STAND_COLUMNS: dict[str, tuple[str, ...]] = {
    "speed": (
        "rpm", "speed", "rotor speed", "motor optical speed", "motor electrical speed", "motor speed",
        "rotation speed", "rotational speed", "rotating speed", "n",
    ),
    "thrust": ("thrust", "pull", "lift", "force", "thrust force", "thr", "f"),
    "torque": ("torque", "moment", "t"),
    "time": ("time", "t"),
    "power": ("electrical power", "electric power", "input power", "system input power", "power", "pow", "p"),
    "current": ("current", "load current", "motor current", "amps", "cur", "i"),
    "voltage": ("voltage", "volts", "vol", "u"),
}  # fmt: skip
"""Names in the tables of motor makers and test stands, each before a unit in brackets, by quantity; the first ones first.

Sources: tables of T-Motor, EMAX, iFlight and BrotherHobby (``Thrust (g)``, ``Pull(g)``, ``RPM``, ``Torque(N*m)``), of MRS at
CTU Prague (``Thr (g)``), and the files of the stands RCbenchmark 1520 and 1580 of Tyto Robotics and of DET (``N(RPM)``).
"""

UNIT_NAMES = {
    "speed": {"r/min": "rpm", "rev/min": "rpm", "1/min": "rpm", "rpmx1000": "krpm", "rps": "rev/s", "hz": "rev/s"},
    "thrust": {"g": "gf", "gram": "gf", "grams": "gf", "kg": "kgf", "oz": "ozf", "lb": "lbf", "lbs": "lbf"},
    "torque": {"nmm": "mN m", "gcm": "gf cm", "kgcm": "kgf cm", "ozin": "ozf in", "inlb": "lbf in", "lbin": "lbf in"},
    "power": {"watt": "W", "watts": "W"},
    "current": {"amps": "A"},
}
"""Other names of units in such tables."""

TESTS = (
    "test",
    "prop",
    "propeller",
)  # Columns that separate several tests, in lower case; an empty cell repeats the one above


def _plain_unit(text: str) -> str:
    """Return a unit in lower case without signs of multiplication."""
    return re.sub(r"[\s.·⋅•*-]", "", text.lower()).replace("µ", "u").replace("μ", "u")


def _unit_of_stand_column(column: str, kind: str, names: Sequence[str]) -> tuple[int, str] | None:
    """Return the place of a column's name among ``names``, and its unit; None if name or unit do not fit."""
    name, _, unit = column.lower().replace("[", "(").rstrip(" )]").partition("(")
    name, unit = " ".join(name.replace("_", " ").split()), unit or ("rpm" if name.strip() == "rpm" else "")
    known = {_plain_unit(each): each for each in UNITS[kind]} | UNIT_NAMES.get(kind, {})
    if name not in names or _plain_unit(unit) not in known:
        return None
    return names.index(name), known[_plain_unit(unit)]


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
    table = _without_unit_row(table)
    for quantity, column in given.items():
        if column not in table.columns:
            raise DataError(f"{path}: has no column {column!r} for the {quantity}; it has {', '.join(table.columns)}")
    for quantity, unit in units.items():
        known = UNITS[KNOWN[quantity][0]]
        if unit not in known:
            raise DataError(f"unit {unit!r} of the {quantity}: must be one of {', '.join(known)}")
    return Bench(str(path), table, dict(given), dict(units))


def _without_unit_row(table: pd.DataFrame) -> pd.DataFrame:
    """Return a table whose first row of units, if it has one, is part of the column names."""
    units = [] if len(table) < 2 else list(table.iloc[0])
    if not units or not all(isinstance(unit, str) and not any(map(str.isdigit, unit)) for unit in units):
        return table
    names = [f"{name} ({unit})" for name, unit in zip(table.columns, units, strict=True)]
    return table.iloc[1:].set_axis(names, axis="columns")


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
        known = KNOWN.get(quantity, (quantity, {}))[1]
        usual = next((name for name in self.table.columns if name.lower() in known), None)
        return usual or next((name for _, _, name in self._stand_columns(quantity)), None)

    def _stand_columns(self, quantity: str) -> Iterator[tuple[int, str, str]]:
        """Yield the place, unit and name of the columns of a quantity by ``STAND_COLUMNS``, the first one first."""
        kind, names = KNOWN.get(quantity, (quantity,))[0], STAND_COLUMNS.get(quantity, ())
        matches = [(seen, name) for name in self.table.columns if (seen := _unit_of_stand_column(name, kind, names))]
        filled = [entry for entry in matches if np.nan_to_num(self._numbers(entry[1])).any()]
        yield from sorted((*seen, name) for seen, name in filled or matches)

    def _numbers(self, column: str) -> Array:
        """Return a column as numbers, NaN for other text; a comma may stand before the thousands."""
        plain = self.table[column].replace(r"^(\d{1,3}),(\d{3})$", r"\1\2", regex=True)
        return np.asarray(pd.to_numeric(plain, errors="coerce"), dtype=np.float64)

    def electric_power(self) -> Array | None:
        """Return the electric power [W], (T,), or voltage times current; None without them or with empty cells."""
        try:
            if self.column_of_quantity("power") is not None:
                return self.values_of_quantity("power")
            return self.values_of_quantity("voltage") * self.values_of_quantity("current")
        except DataError:
            return None

    def tests(self) -> "list[str] | None":
        """Return the name of the test of each row, (T,); None where the table has one test."""
        column = next((name for name in self.table.columns if name.lower().partition("(")[0].strip() in TESTS), None)
        return None if column is None else [str(name) for name in self.table[column].ffill()]

    def values_of_quantity(self, quantity: str) -> Array:
        """Return a quantity in SI units, (T,)."""
        column = self.column_of_quantity(quantity)
        kind, known = KNOWN.get(quantity, (quantity, {}))
        if column is None:
            raise DataError(
                f"{self.path}: has no column for the {quantity}, such as {', '.join(list(known)[:4])}; it has "
                f"{', '.join(self.table.columns)}. Name the column and its unit with --columns and --units"
            )
        numbers = self._numbers(column)
        bad = np.flatnonzero(~np.isfinite(numbers))
        if bad.size:
            line, text = self.table.index[bad[0]] + 2, self.table[column].iloc[bad[0]]
            raise DataError(
                f"{self.path}, line {line}: {column} = {text!s} is no number; remove the row, or measure it again"
            )
        stand = {name: unit for _, unit, name in self._stand_columns(quantity)}
        unit = self.units.get(quantity) or known.get(column.lower()) or stand.get(column)
        if unit is None:
            raise DataError(
                f"{self.path}: the unit of column {column!r} is not known; give it: --units {quantity} UNIT"
            )
        return numbers * UNITS[kind][unit]


FASTEST = 12_000.0  # Largest plausible rotor speed [rad/s]: 115,000 rpm, above every hobby motor

POWER_PER_THRUST = (0.5, 120.0)
"""Plausible range of torque times speed over thrust at the highest speed [m/s]: induced velocity, 2 to 40 m/s for all sizes,
over the figure of merit, 0.3 to 0.8 (Leishman 2006, Principles of Helicopter Aerodynamics, section 2.8)."""


LEAST_MOTOR_EFFICIENCY = 0.5  # Of motor and speed controller at the highest speed; small ones have 0.6 to 0.8


def check_plausibility_of_rotor_data(
    path: str, speed: Array, thrust: Array, torque: Array | None, power: Array | None = None
) -> None:
    """Raise ``DataError`` for implausible speeds, thrusts or torques; the message names the likely unit.

    Without torque, the electric power [W] stands for torque times speed.
    """
    if np.any(speed < 0.0) or np.any(speed > FASTEST):
        raise DataError(
            f"{path}: speeds from {speed.min():.4g} to {speed.max():.4g} rad/s; must lie in [0, {FASTEST:g}]. "
            "If they are revolutions per minute, say so: --units speed rpm"
        )
    top = int(np.argmax(speed))
    if thrust[top] <= 0.0:
        raise DataError(f"{path}: thrust at the highest speed is {thrust[top]:.4g} N, must be > 0; invert its sign")
    low, high = POWER_PER_THRUST
    if torque is not None:
        if torque[top] <= 0.0:
            raise DataError(
                f"{path}: torque at the highest speed is {torque[top]:.4g} N m, must be > 0; invert its sign"
            )
        ratio = float(torque[top] * speed[top] / thrust[top])
    elif power is not None:
        ratio, high = float(abs(power[top]) / thrust[top]), high / LEAST_MOTOR_EFFICIENCY
    else:
        return
    if low <= ratio <= high:
        return
    guesses = [
        f"{quantity} in {unit}"
        for quantity, exponent in (("thrust", -1), *((("speed", 1), ("torque", 1)) if torque is not None else ()))
        for unit, factor in UNITS[quantity].items()
        if factor != 1.0 and low <= ratio * factor**exponent <= high
    ]
    raise DataError(
        f"{path}: power over thrust is {ratio:.3g} m/s at the highest speed; rotors have {low:g} to {high:g}, so a unit is "
        f"wrong. It would fit with {' or '.join(guesses) or 'none of the known units'} (--units QUANTITY UNIT)"
    )
