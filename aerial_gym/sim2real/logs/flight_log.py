"""One flight as arrays, and the reader of flight logs in CSV files.

World is ENU (z up), body is x forward, y left, z up, quaternions are xyzw, body to world, SI units.
Letters: T rows, R rotors.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from difflib import get_close_matches
from pathlib import Path

import numpy as np
import pandas as pd
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from aerial_gym.errors import DataError
from aerial_gym.sim2real.logs.mapping import HEIGHTS, UNITS, ColumnsCfg, LogMapping, find_mapping, mapping_names
from aerial_gym.sim2real.logs.ulog import ulog_table

Array = NDArray[np.float64]

HEADER_LINES = 1

FEW_DIGITS = 20
"""If time stands still in more than one row of so many, it was written with too few digits."""

LARGEST = 1e9
"""Size in SI units beyond which no measurement of a flight is one."""

COMPANION_GAP_S = 0.1
"""Longest gap [s] in another vehicle's log across which its position is interpolated."""

EULER = (("roll", "pitch", "yaw"), ("phi", "theta", "psi"))
"""Names of columns that hold angles in place of a quaternion."""

FLIP = np.array([1.0, -1.0, -1.0])
"""From body frd to body flu."""


@dataclass(frozen=True, kw_only=True)
class Recording:
    """What a log and the flight that is made of it have in common; None: it was not measured. World ENU, body FLU, SI."""

    path: str
    """File, as error messages and reports call it."""

    time: Array
    """[s], increasing, (T,)."""

    attitude: Array
    """Body to world, xyzw, (T, 4)."""

    position: Array | None = None
    """Body origin [m], world, (T, 3)."""

    lin_vel: Array | None = None
    """Of the body origin [m/s], world, (T, 3)."""

    specific_force: Array | None = None
    """At the body origin [m/s²], body: +9.81 on z at hover, (T, 3)."""

    rotor_speed: Array | None = None
    """Measured [rad/s], (T, R); rotors in force mode have none."""

    rotor_command: Array | None = None
    """Speeds commanded from each row on [rad/s], in force mode thrusts [N], (T, R)."""

    battery: Array | None = None
    """Voltage [V], (T,)."""

    attitude_integrated: bool = False
    """Whether the attitude is that which the gyro implies, and so no check of the gyro."""

    other_position: Array | None = None
    """Body origin of another vehicle flown at the same time [m], world, (T, 3); NaN where it is not known."""

    ground_height: float = 0.0
    """World z of the ground [m]."""

    ceiling_height: float | None = None
    """World z of the ceiling [m]; None if the log does not say."""

    wind: tuple[float, float, float] | None = None
    """Steady wind that was known to whoever flew [m/s], world; None: still air as far as is known."""

    notes: tuple[str, ...] = ()
    """What was done to the log, for the report."""


@dataclass(frozen=True, kw_only=True)
class FlightLog(Recording):
    """What was measured in one flight, row by row of its file; quaternions are not yet made unit."""

    ang_vel: Array | None = None
    """[rad/s], body, (T, 3)."""

    collective: bool = False
    """Whether all rotors share one command: it says nothing about torques."""

    lift_off: float = 0.0
    """Within this of a height at which it stood the vehicle stands on the ground [m]; 0: heights tell nothing."""

    hover_above: float | None = None
    """Commanded speeds are to be scaled to the thrust measured above this height [m], world; None: they are not."""

    torques: bool = True
    """Whether the log shows what torques do."""

    @property
    def name(self) -> str:
        """File name without folder and ending."""
        return Path(self.path).stem

    @property
    def num_rotors(self) -> int:
        """Number of rotors R in the log."""
        rotors = self.rotor_speed if self.rotor_speed is not None else self.rotor_command
        return 0 if rotors is None else rotors.shape[1]

    def where(self, row: int) -> str:
        """Return how messages name a row: file, line and time."""
        return f"{self.path}, line {row + 1 + HEADER_LINES} (t = {self.time[row]:.6g} s)"


def read_flight_log(path: str | Path, *, mapping: LogMapping | None = None, hover: bool = False) -> FlightLog:
    """Return the flight in a CSV file with one header line, or in a PX4 ULog (.ulg).

    Args:
        path: The file.
        mapping: Layout; None takes that of this package, or ``px4_ulog`` for a .ulg file.
        hover: Whether only the rotors at hover are wanted: a log without attitude is taken as level, and needs neither gyro
            nor accelerometer.

    Raises:
        DataError: If file, columns or fields cannot be used; the message names file, row or column and the way out.
    """
    ulog = Path(path).suffix.lower() == ".ulg"
    layout = mapping or find_mapping("px4_ulog" if ulog else "aerial_gym")
    table = ulog_table(Path(path)) if ulog else _read_table(Path(path), layout)
    notes: list[str] = []
    table = _without_copies(table, notes)
    time = _time(table, layout, str(path))
    values: dict[str, Array] = {}
    for name, quantity in layout.quantities().items():
        if name == "time":
            continue
        columns = _columns(table, quantity, name, str(path))
        if columns:
            gaps, held = name == "other_position", name == "rotor_command"
            raw = _fields(table, columns, quantity, time, str(path), notes, gaps=gaps, held=held)
            values[name] = _converted(raw, table, quantity, time, str(path)) * UNITS[quantity.unit]
            if np.nanmax(np.abs(values[name]), initial=0.0) > LARGEST:
                raise DataError(
                    f"{path}: {columns[0]} to {columns[-1]} reach {np.nanmax(np.abs(values[name])):.3g} in SI units, at most "
                    f"{LARGEST:.0g} is of this world; check the unit"
                )
    if layout.lacks:
        notes.append(layout.lacks)
    integrated = "attitude" not in values and layout.attitude is None and not hover
    if "attitude" not in values and hover:
        values["attitude"] = np.tile((0.0, 0.0, 0.0, 1.0), (time.size, 1))
        notes.append("attitude not logged: taken as level")
    if integrated:
        _integrate_attitude(values, time, layout, str(path), notes)
    _require(values, layout, list(table.columns), str(path), hover=hover)
    battery = values.pop("battery", None)
    heights = {name: _height(values.pop(name), layout, name, str(path)) for name in HEIGHTS if name in values}
    wind = _known_wind(Path(path), layout, notes)
    command, companion = layout.rotor_command, _companion(Path(path), layout, time, notes)
    return FlightLog(
        path=str(path),
        time=time,
        battery=None if battery is None else battery[:, 0],
        collective=command is not None and command.repeat > 1,
        lift_off=layout.lift_off_m,
        hover_above=layout.hover_above_m,
        torques=layout.torques,
        attitude_integrated=integrated,
        wind=wind,
        notes=tuple(notes),
        **{"other_position": companion, **heights, **_to_package_frames(values, layout)},
    )


def _height(values: Array, layout: LogMapping, name: str, path: str) -> float:
    """Return the height of a level surface [m], z up; refuse one that changes in the flight."""
    if np.ptp(values) > 0.0:
        raise DataError(
            f"{path}: {name} runs from {values.min():g} to {values.max():g} m; a flight has one number for it: cut the log "
            "where it changes"
        )
    return float(values[0, 0]) * (-1.0 if layout.world_frame == "ned" else 1.0)


def _converted(raw: Array, table: pd.DataFrame, quantity: ColumnsCfg, time: Array, path: str) -> Array:
    """Return ``offset + gain (raw times / over)^power``, 0 where raw is 0, once per rotor, (T, columns)."""
    if quantity.plain:
        return raw
    values = raw
    for column, power in ((quantity.times, 1.0), (quantity.over, -1.0)):
        if column is None:
            continue
        if column not in table.columns:
            raise DataError(_missing(column, list(table.columns), path))
        other = _fields(table, [column], ColumnsCfg(columns=(column,)), time, path, [])
        if np.any(other <= 0.0):
            row = int(np.argmax(other[:, 0] <= 0.0))
            raise DataError(f"{path}, line {row + 1 + HEADER_LINES}: {column} = {other[row, 0]:g}, must be > 0")
        values = values * other**power
    if quantity.power != 1.0 and np.any(values < 0.0):
        raise DataError(f"{path}: {quantity.columns[0]} is negative and cannot be raised to {quantity.power:g}")
    values = np.where(raw == 0.0, 0.0, quantity.offset + quantity.gain * values**quantity.power)
    return np.repeat(values, quantity.repeat, axis=1)


def _integrate_attitude(values: dict[str, Array], time: Array, layout: LogMapping, path: str, notes: list[str]) -> None:
    """Write an attitude that starts level and turns with the gyro; refuse logs in which it would be compared with the world."""
    if "ang_vel" not in values or "position" in values or "lin_vel" in values:
        raise DataError(f"{path}: has no attitude. {layout.lacks or 'Log it, or map it.'}")
    turns = Rotation.from_rotvec(0.5 * (values["ang_vel"][1:] + values["ang_vel"][:-1]) * np.diff(time)[:, None])
    attitude = [Rotation.identity()]
    for turn in turns:
        attitude.append(attitude[-1] * turn)
    values["attitude"] = np.array([turn.as_quat() for turn in attitude])
    notes.append("attitude not logged: integrated from the gyro, level at the start; only body axes are compared")


def _companion(path: Path, layout: LogMapping, time: Array, notes: list[str]) -> Array | None:
    """Return the position of the vehicle whose file has a name that the layout derives from this one, (T, 3)."""
    for text, other in layout.companion.items():
        partner = path.parent / path.name.replace(text, other)
        if text not in path.name or partner == path or not partner.exists() or layout.position is None:
            continue
        log = read_flight_log(partner, mapping=replace(layout, companion={}))
        assert log.position is not None
        place = np.stack([np.interp(time, log.time, p, left=np.nan, right=np.nan) for p in log.position.T], axis=1)
        after = np.clip(np.searchsorted(log.time, time), 1, log.time.size - 1)
        place[log.time[after] - log.time[after - 1] > COMPANION_GAP_S] = np.nan
        notes.append(f"position of the other vehicle from {partner.name}")
        return place
    return None


def _known_wind(path: Path, layout: LogMapping, notes: list[str]) -> tuple[float, float, float] | None:
    """Return the wind that the layout declares for a file of this name [m/s], world ENU; None if it declares none."""
    found = [text for text in layout.wind if text in path.stem]
    if len(found) > 1:
        raise DataError(f"{path}: the mapping declares the wind of {' and of '.join(found)}; make the texts differ")
    if not found:
        if layout.wind:
            notes.append("the mapping declares no wind for a file of this name: taken as still air")
        return None
    x, y, z = layout.wind[found[0]]
    wind = (y, x, -z) if layout.world_frame == "ned" else (x, y, z)
    notes.append(f"declared wind ({', '.join(f'{speed:g}' for speed in wind)}) m/s, world")
    return wind


def _read_table(path: Path, layout: LogMapping) -> pd.DataFrame:
    """Return the file as text and numbers: empty fields are NaN, and only they."""
    try:
        text = path.read_text(encoding="utf-8-sig")
    except FileNotFoundError:
        raise DataError(f"{path}: no such file") from None
    except (OSError, UnicodeDecodeError) as error:
        raise DataError(f"{path}: cannot be read as text ({error}); give a CSV file with one header line") from None
    lines = text.rstrip().splitlines()
    if len(lines) < 2:
        raise DataError(f"{path}: holds no rows; a flight log has one header line and one line per sample")
    width = lines[0].count(",")
    for mark, name in ((";", "';'"), ("\t", "tabs"), (" ", "spaces")):
        if width == 0 and lines[0].strip().count(mark) > 1:
            raise DataError(f"{path}: fields are separated by {name}; separate them by ','")
    for number, line in enumerate(lines, start=1):
        if line.count(",") != width:
            fields = line.count(",") + 1
            raise DataError(
                f"{path}, line {number}: has {fields} fields, the header has {width + 1}; "
                "remove the line if the log was cut off there"
            )
    names = [name.strip() for name in lines[0].split(",")]
    wanted = {name for q in layout.quantities().values() for name in _names(q, names)}
    twice = sorted(name for name in wanted if names.count(name) > 1)
    if twice:
        raise DataError(f"{path}: column {twice[0]!r} appears twice in the header; rename or remove one of them")
    try:
        table = pd.read_csv(
            path,
            encoding="utf-8-sig",
            keep_default_na=False,
            na_values=[""],
            skipinitialspace=True,
            float_precision="round_trip",
        )
    except (ValueError, OverflowError) as error:  # an unbalanced quote, a field that is no text
        raise DataError(f"{path}: cannot be read as CSV ({' '.join(str(error).split())})") from None
    if len(table.columns) != len(names):
        raise DataError(f"{path}: the header has {len(names)} fields, pandas finds {len(table.columns)}; remove quotes")
    table.columns = names
    return table


def _names(quantity: ColumnsCfg, known: Sequence[str]) -> list[str]:
    """Return the column names of a quantity, with ``{n}`` counted up as far as the file goes."""
    pattern, found = "".join(quantity.columns[:1]), []
    if len(quantity.columns) > 1 or "{n}" not in pattern:
        return list(quantity.columns)
    while (name := pattern.replace("{n}", str(len(found) + 1))) in known:
        found.append(name)
    return found


def _columns(table: pd.DataFrame, quantity: ColumnsCfg, name: str, path: str) -> list[str]:
    """Return the columns of a quantity; none if the file has none of them, or only empty ones."""
    names = _names(quantity, list(table.columns))
    present = [column for column in names if column in table.columns and not bool(table[column].isna().all())]
    missing = [column for column in names if column not in present]
    if present and missing:
        raise DataError(
            f"{path}: column {missing[0]!r} is missing or empty while {present[0]!r} is there; "
            f"add it, or remove every column of {name}"
        )
    return present


def _without_copies(table: pd.DataFrame, notes: list[str]) -> pd.DataFrame:
    """Return the table without rows that are the same as the one before in every column, time included."""
    same = (table == table.shift()) | (table.isna() & table.shift().isna())
    copies = np.asarray(same.all(axis=1)) & (np.arange(len(table)) > 0)
    if copies.any():
        notes.append(f"{int(copies.sum())} rows that are copies of the one before, time included, were left out")
    return table.drop(index=table.index[copies])


def _time(table: pd.DataFrame, layout: LogMapping, path: str) -> Array:
    """Return the time [s]; refuse a missing column and time that stands still or runs back."""
    column = layout.time.columns[0]
    if column not in table.columns:
        raise DataError(_missing(column, list(table.columns), path))
    strict = ColumnsCfg(columns=(column,))
    time = _fields(table, [column], strict, np.zeros(len(table)), path, [])[:, 0] * UNITS[layout.time.unit]
    back = np.flatnonzero(np.diff(time) <= 0.0)
    if back.size * FEW_DIGITS > time.size and np.all(np.diff(time) >= 0.0):
        raise DataError(
            f"{path}: {column} is the same in {back.size} rows as in the row before; it has too few digits to tell rows apart: "
            "write it with more, counted from the start of the flight"
        )
    if back.size:
        row = int(back[0]) + 1
        raise DataError(
            f"{path}, line {row + 1 + HEADER_LINES}: {column} = {time[row]:.6g} s does not increase "
            f"(row before: {time[row - 1]:.6g} s); sort the rows and remove repeated ones"
        )
    return time


def _fields(
    table: pd.DataFrame,
    columns: list[str],
    quantity: ColumnsCfg,
    time: Array,
    path: str,
    notes: list[str],
    *,
    gaps: bool = False,
    held: bool = False,
) -> Array:
    """Return numbers (T, columns) with short gaps filled where the mapping allows it.

    ``gaps``: they may stay NaN; ``held``: a number holds until the next one.
    """
    found, filled = np.empty((len(table), len(columns))), 0
    for index, column in enumerate(columns):
        numbers = np.asarray(pd.to_numeric(table[column], errors="coerce"), dtype=np.float64)
        bad = np.flatnonzero(np.asarray(table[column].notna()) & ~np.isfinite(numbers))
        if bad.size:
            raise DataError(
                f"{path}, line {bad[0] + 1 + HEADER_LINES}: {column} = {table[column].iloc[bad[0]]!s} is no finite "
                "number; cut the flight there, or leave the whole column empty if it was not measured"
            )
        if gaps:
            found[:, index] = numbers
            continue
        found[:, index] = _fill(numbers, quantity, time, f"{path}, line {{line}}: {column}", held=held)
        filled += int(np.isnan(numbers).sum())
    if filled:
        how = "by the value before" if held else "by straight lines"
        notes.append(f"{filled} empty fields of {columns[0]} to {columns[-1]} filled {how}")
    return found


def _fill(numbers: Array, quantity: ColumnsCfg, time: Array, where: str, *, held: bool) -> Array:
    """Return ``numbers`` without NaN: short runs become straight lines, or the value before; long ones are refused."""
    empty = np.isnan(numbers)
    if not empty.any():
        return numbers
    edges = np.flatnonzero(np.diff(np.concatenate(([0], empty.astype(int), [0]))))
    full_time = np.concatenate(([time[0]], time, [time[-1]]))
    for start, stop in zip(edges[::2], edges[1::2], strict=True):
        gap = float(full_time[stop + 1] - full_time[start])
        if gap > quantity.fill_gap_s or quantity.fill_gap_s == 0.0:
            raise DataError(
                where.format(line=start + 1 + HEADER_LINES)
                + f" is empty (NaN) for {stop - start} rows while other rows have it; cut the flight there, fill the gap, "
                "or let a mapping file allow it (fill_gap_s)"
            )
    known = np.flatnonzero(~empty)
    if held:
        return numbers[known[np.maximum(np.searchsorted(known, np.arange(time.size), side="right") - 1, 0)]]
    return np.interp(time, time[known], numbers[known])


def _require(values: dict[str, Array], layout: LogMapping, known: list[str], path: str, *, hover: bool) -> None:
    """Raise ``DataError`` unless the log has what every use of it needs."""
    if "attitude" not in values and layout.attitude is not None:
        column = next((name for name in layout.attitude.columns if name not in known), layout.attitude.columns[0])
        if any(set(angles) <= {name.lower() for name in known} for angles in EULER):
            raise DataError(
                f"{path}: column {column!r} is missing or empty. Euler angles are no quaternion: write "
                "q = qz(yaw) qy(pitch) qx(roll), body to world, into q_x, q_y, q_z, q_w"
            )
        raise DataError(_missing(column, known, path))
    for one, other in (("ang_vel", "specific_force"), ("rotor_speed", "rotor_command")):
        if one in values or other in values or (hover and one == "ang_vel"):
            continue
        options = [q.columns for key, q in layout.quantities().items() if key in (one, other)]
        wanted = " or ".join(", ".join(columns) for columns in options) or f"{one} or {other} in the mapping"
        raise DataError(f"{path}: needs the columns {wanted}; they are missing or empty.{_mapping_hint(known)}")
    if "rotor_speed" in values and "rotor_command" in values:
        speeds, commands = values["rotor_speed"].shape[1], values["rotor_command"].shape[1]
        if speeds != commands:
            raise DataError(
                f"{path}: has {speeds} rotor speeds and {commands} commands; both need one column per rotor"
            )


def _missing(column: str, known: list[str], path: str) -> str:
    near = get_close_matches(column, known, n=1)
    hint = f" Did you mean {near[0]!r}?" if near else ""
    return f"{path}: column {column!r} is missing or empty.{hint}{_mapping_hint(known)}"


def _mapping_hint(known: list[str]) -> str:
    """Return the advice to use a mapping, naming the one that uses most of the columns if there is one."""
    fits: dict[str, int] = {}
    own = {column for quantity in find_mapping("aerial_gym").quantities().values() for column in quantity.columns}
    for name in mapping_names():
        layout = find_mapping(name)
        wanted = {
            column
            for key, quantity in layout.quantities().items()
            for column in quantity.columns
            if "{n}" not in column and key not in ("battery", *HEIGHTS)
        }
        if not wanted <= own and wanted <= set(known):
            fits[name] = len(wanted)
    if fits:
        best = max(fits, key=lambda name: fits[name])
        return f" The columns look like the mapping {best!r}: give --mapping {best}."
    return " Rename the columns, or describe them in a mapping file (--mapping FILE.yaml)."


def _to_package_frames(values: dict[str, Array], layout: LogMapping) -> dict[str, Array]:
    """Return the quantities in world ENU and body FLU, with the quaternion from body to world."""
    result = dict(values)
    if layout.attitude_direction == "world_to_body":
        result["attitude"] = result["attitude"] * (-1.0, -1.0, -1.0, 1.0)
    if layout.world_frame == "ned":
        for name in ("position", "lin_vel", "other_position"):
            if name in result:
                result[name] = result[name][:, [1, 0, 2]] * (1.0, 1.0, -1.0)
        x, y, z, w = result["attitude"].T  # q_ned_to_enu q with q_ned_to_enu = (1, 1, 0, 0) / sqrt(2), xyzw
        result["attitude"] = np.stack((w + z, w - z, y - x, -x - y), axis=1) / np.sqrt(2.0)
    if layout.body_frame == "frd":
        for name in ("ang_vel", "specific_force"):
            if name in result:
                result[name] = result[name] * FLIP
        x, y, z, w = result["attitude"].T  # q q_flu_to_frd with q_flu_to_frd = (1, 0, 0, 0), xyzw
        result["attitude"] = np.stack((w, z, -y, -x), axis=1)
    return result
