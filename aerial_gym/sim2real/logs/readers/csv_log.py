"""Read a CSV file in the layout of a mapping, and write facts on its flight that no column holds.

World is ENU (z up), body is x forward, y left, z up, quaternions are xyzw, body to world, SI units.
Letters: T rows, R rotors.
"""

import json
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from math import inf
from pathlib import Path

import numpy as np
import pandas as pd

from aerial_gym.config import build
from aerial_gym.errors import ConfigError, DataError
from aerial_gym.sim2real.arrays import Array
from aerial_gym.sim2real.findings import Finding
from aerial_gym.sim2real.logs.checks.time_courses import check_motion_at_clock_steps
from aerial_gym.sim2real.logs.raw_log import SETPOINTS, STATES
from aerial_gym.sim2real.logs.readers.csv_table import (
    LARGEST,
    apply_column_conversion,
    mapping_hint,
    message_on_missing_column,
    quantity_columns,
    read_csv_rows,
    read_numbers,
)
from aerial_gym.sim2real.logs.readers.log_readers import read_csv_export
from aerial_gym.sim2real.logs.readers.mapping import HEIGHTS, UNITS, LogMapping, to_package_frames
from aerial_gym.sim2real.logs.readers.setpoints import setpoints_in_package_axes
from aerial_gym.sim2real.logs.recording import FlightLog, LogIdentity, StreamTiming, absent_pairs, position_at_times
from aerial_gym.sim2real.logs.signals import integrate_rates, without_bad_quaternions

LONGEST_FACTS = 1_000_000  # Largest length of the line with facts [B]; the parameters of a firmware have 50,000
HELD = ("rotor_command", "rotor_share", *STATES)  # Quantities whose empty fields keep the value before
EULER = (("roll", "pitch", "yaw"), ("phi", "theta", "psi"))  # Column names of Euler angles, for a missing quaternion


FACTS = "# flight: "  # Start of the line with the facts in JSON


@dataclass(frozen=True, kw_only=True)
class FlightFacts:
    """Facts on a converted flight that no column holds."""

    attitude_integrated: bool = False
    torques: bool = True
    streams: Mapping[str, StreamTiming] = field(default_factory=dict)
    log_format: str = "csv"
    identity: LogIdentity = field(default_factory=LogIdentity)
    parameters: Mapping[str, object] = field(default_factory=dict)
    command_curve: tuple[float, float, float] | None = None

    def line(self) -> str:
        """Return the facts as a comment before the header line."""
        streams = {name: vars(timing) for name, timing in self.streams.items()}
        return FACTS + json.dumps({**vars(self), "streams": streams, "identity": vars(self.identity)}) + "\n"


@dataclass(frozen=True, kw_only=True)
class CsvLog:
    """Content of a CSV file."""

    rows: FlightLog  # All rows
    states: dict[str, Array]  # Columns ``armed`` and ``landed``, (T, 1), if the file has them
    is_converted: bool  # Whether the file holds facts, and so one whole flight of another log


def read_facts(path: Path) -> FlightFacts | None:
    """Return the facts in the first line of a file, or of the CSV file that it was; None if it holds none."""
    export = read_csv_export(path)
    if export is not None:
        line = export.metadata.get(FACTS, "")
    else:
        with path.open("rb") as stream:
            line = stream.readline(LONGEST_FACTS).decode("utf-8", errors="replace")
    if not line.startswith(FACTS):
        return None
    try:
        facts = build(FlightFacts, json.loads(line.removeprefix(FACTS)), where=str(path))
        if not all(0.0 < timing.rate < inf for timing in facts.streams.values()):
            raise ConfigError("a rate is not > 0")
    except (ValueError, RecursionError, ConfigError) as error:
        raise DataError(f"{path}, line 1: states no facts on a flight ({error}); convert the log again") from None
    return facts


def read_csv_log(path: Path, layout: LogMapping, *, hover: bool = False, partial: bool = False) -> CsvLog:
    """Return the content of a CSV file; raise ``DataError`` if columns or fields are unusable."""
    notes = list[Finding]()
    table, time, clock_steps = read_csv_rows(path, layout, notes)
    values, known_facts = _quantities_of_table(table, time, layout, str(path), notes), read_facts(path)
    facts = known_facts or FlightFacts()
    states = {name: values.pop(name) for name in STATES if name in values}
    asked = {name: values.pop(name) for name in SETPOINTS if name in values}
    integrated = "attitude" not in values and (layout.attitude is None or facts.attitude_integrated) and not hover
    if "attitude" not in values and hover:
        values["attitude"] = np.tile((0.0, 0.0, 0.0, 1.0), (time.size, 1))
        notes.append(Finding("attitude_level"))
    if integrated:
        _integrate_attitude(values, time, layout, str(path), notes)
    share, relative = values.pop("rotor_share", None), "rotor_command" not in values
    if share is not None and relative:
        values["rotor_command"] = share
    _require_quantities(values, layout, list(table.columns), str(path), hover=hover, partial=partial)
    battery = _battery_voltage(values.pop("battery", None), time, notes)
    heights = {name: _surface_height(values.pop(name), layout, name, str(path)) for name in HEIGHTS if name in values}
    command, companion = layout.rotor_command, _companion_position(path, layout, time, notes)
    log = FlightLog(
        path=str(path),
        time=time,
        lines=table.index.to_numpy(),
        battery=battery,
        collective=command is not None and command.repeat > 1,
        relative_commands=share is not None and relative,
        **{**vars(facts), "attitude_integrated": integrated},
        setpoints={
            name: (time[np.isfinite(one).all(axis=1)], one[np.isfinite(one).all(axis=1)])
            for name, one in setpoints_in_package_axes(asked, layout).items()
        },
        notes=tuple(notes),
        **{"other_position": companion, **heights, **to_package_frames(values, layout)},
    )
    if clock_steps:
        check_motion_at_clock_steps(without_bad_quaternions(log), clock_steps)
    return CsvLog(rows=log, states=states, is_converted=known_facts is not None)


def _quantities_of_table(
    table: pd.DataFrame, time: Array, layout: LogMapping, path: str, notes: list[Finding]
) -> dict[str, Array]:
    """Return the values of each mapped quantity in the file, in SI units and the frames of the file."""
    values: dict[str, Array] = {}
    for name, quantity in layout.quantities().items():
        columns = [] if name == "time" else quantity_columns(table, quantity, name, path)
        if not columns:
            continue
        gaps, held = name == "other_position" or name in SETPOINTS, name in HELD
        try:
            raw = read_numbers(table, columns, quantity, time, path, notes, gaps=gaps, held=held)
        except DataError as error:
            if name != "battery":
                raise
            notes.append(Finding("battery_left_out", "", {"error": str(error)}))
            continue
        values[name] = apply_column_conversion(raw, table, quantity, path) * UNITS[quantity.unit]
        if np.nanmax(np.abs(values[name]), initial=0.0) > LARGEST:
            raise DataError(
                f"{path}: {columns[0]} to {columns[-1]} reach {np.nanmax(np.abs(values[name])):.3g} in SI units, at most "
                f"{LARGEST:.0g} is plausible; check the unit"
            )
    return values


def _battery_voltage(values: Array | None, time: Array, notes: list[Finding]) -> Array | None:
    """Return the battery voltage [V], (T,), with values of 0 or less interpolated; None without any valid value."""
    if values is None or not (bad := values[:, 0] <= 0.0).any():
        return None if values is None else values[:, 0]
    if bad.all():
        notes.append(Finding("battery_without_voltage"))
        return None
    notes.append(Finding("battery_filled", "", {"rows": int(bad.sum()), "total": bad.size}))
    return np.interp(time, time[~bad], values[~bad, 0])


def _surface_height(values: Array, layout: LogMapping, name: str, path: str) -> float:
    """Return the height of a level surface [m], z up; refuse one that varies."""
    if np.ptp(values) > 0.0:
        raise DataError(
            f"{path}: {name} varies from {values.min():g} to {values.max():g} m, must be constant in a flight; cut the log "
            "where it changes"
        )
    return float(values[0, 0]) * (-1.0 if layout.world_frame == "ned" else 1.0)


def _integrate_attitude(
    values: dict[str, Array], time: Array, layout: LogMapping, path: str, notes: list[Finding]
) -> None:
    """Integrate the gyro from a level attitude; refuse logs with position or velocity, which need a true attitude."""
    if "ang_vel" not in values or "position" in values or "lin_vel" in values:
        raise DataError(f"{path}: has no attitude. {layout.lacks or 'Log it, or map it.'}")
    values["attitude"] = integrate_rates(time, values["ang_vel"])
    notes.append(Finding("attitude_integrated"))


def _companion_position(path: Path, layout: LogMapping, time: Array, notes: list[Finding]) -> Array | None:
    """Return the position of the other vehicle, (T, 3), from the log whose name the mapping derives; else None."""
    for text, other in layout.companion.items():
        partner = path.parent / path.name.replace(text, other)
        if text not in path.name or partner == path or not partner.exists() or layout.position is None:
            continue
        place = position_at_times(read_csv_log(partner, replace(layout, companion={})).rows, time)
        notes.append(Finding("other_vehicle", "", {"file": partner.name}))
        return place
    return None


def _require_quantities(
    values: dict[str, Array], layout: LogMapping, known: list[str], path: str, *, hover: bool, partial: bool
) -> None:
    """Raise ``DataError`` if the log lacks a required quantity."""
    if "attitude" not in values and layout.attitude is not None:
        column = next((name for name in layout.attitude.columns if name not in known), layout.attitude.columns[0])
        if any(set(angles) <= {name.lower() for name in known} for angles in EULER):
            raise DataError(
                f"{path}: column {column!r} is missing or empty. Euler angles are no quaternion: write "
                "q = qz(yaw) qy(pitch) qx(roll), body to world, into q_x, q_y, q_z, q_w"
            )
        raise DataError(message_on_missing_column(column, known, path))
    for one, other in absent_pairs(values, hover=hover, partial=partial):
        options = [q.columns for key, q in layout.quantities().items() if key in (one, other)]
        wanted = " or ".join(", ".join(columns) for columns in options) or f"{one} or {other} in the mapping"
        raise DataError(f"{path}: needs the columns {wanted}; they are missing or empty.{mapping_hint(known)}")
    if "rotor_speed" in values and "rotor_command" in values:
        speeds, commands = values["rotor_speed"].shape[1], values["rotor_command"].shape[1]
        if speeds != commands:
            raise DataError(
                f"{path}: has {speeds} rotor speeds and {commands} commands; both need one column per rotor"
            )
