"""Read a flight log, a CSV file or a PX4 ULog, in the layout of a mapping.

World is ENU (z up), body is x forward, y left, z up, quaternions are xyzw, body to world, SI units.
Letters: T rows, R rotors.
"""

from dataclasses import replace
from pathlib import Path

import numpy as np

from aerial_gym.errors import DataError
from aerial_gym.sim2real.arrays import Array
from aerial_gym.sim2real.findings import Finding
from aerial_gym.sim2real.logs.checks.conventions import without_bad_quaternions
from aerial_gym.sim2real.logs.checks.time_courses import check_motion_at_clock_steps
from aerial_gym.sim2real.logs.readers.binary_log import read_binary_flight
from aerial_gym.sim2real.logs.readers.csv_table import (
    LARGEST,
    apply_column_conversion,
    mapping_hint,
    message_on_missing_column,
    quantity_columns,
    read_csv_rows,
    read_numbers,
)
from aerial_gym.sim2real.logs.readers.frames import to_package_frames
from aerial_gym.sim2real.logs.readers.mapping import HEIGHTS, UNITS, LogMapping, find_mapping
from aerial_gym.sim2real.logs.recording import FlightLog
from aerial_gym.sim2real.logs.signals import integrate_rates

COMPANION_GAP_S = 0.1  # Longest gap [s] in the other vehicle's log across which its position is interpolated
EULER = (("roll", "pitch", "yaw"), ("phi", "theta", "psi"))  # Column names of Euler angles, for a missing quaternion


def read_flight_log(path: str | Path, *, mapping: LogMapping | None = None, hover: bool = False) -> FlightLog:
    """Return the flight in a log of any format: a CSV file with one header line, or a binary log, known by its content.

    Args:
        path: The file; ``FILE#2`` selects the second flight of a binary log with several.
        mapping: Layout; None takes that of this package for CSV, and of the format itself for binary logs.
        hover: Whether only hover rotor states are needed: a missing attitude counts as level, and neither gyro nor
            accelerometer is required.

    Raise ``DataError`` if file, columns or fields are unusable, or if the file holds several flights.
    """
    binary = read_binary_flight(path, mapping, hover=hover)
    if binary is not None:
        return binary if mapping is None else _with_mapping(binary, mapping)
    layout, notes = mapping or find_mapping("aerial_gym"), list[Finding]()
    table, time, clock_steps = read_csv_rows(Path(path), layout, notes)
    values: dict[str, Array] = {}
    for name, quantity in layout.quantities().items():
        if name == "time":
            continue
        columns = quantity_columns(table, quantity, name, str(path))
        if columns:
            gaps, held = name == "other_position", name == "rotor_command"
            try:
                raw = read_numbers(table, columns, quantity, time, str(path), notes, gaps=gaps, held=held)
            except DataError as error:
                if name != "battery":
                    raise
                notes.append(Finding("battery_left_out", "", {"error": str(error)}))
                continue
            values[name] = apply_column_conversion(raw, table, quantity, str(path)) * UNITS[quantity.unit]
            if np.nanmax(np.abs(values[name]), initial=0.0) > LARGEST:
                raise DataError(
                    f"{path}: {columns[0]} to {columns[-1]} reach {np.nanmax(np.abs(values[name])):.3g} in SI units, at most "
                    f"{LARGEST:.0g} is plausible; check the unit"
                )
    if layout.lacks:
        notes.append(Finding("mapping_note", "", {"text": layout.lacks}))
    integrated = "attitude" not in values and layout.attitude is None and not hover
    if "attitude" not in values and hover:
        values["attitude"] = np.tile((0.0, 0.0, 0.0, 1.0), (time.size, 1))
        notes.append(Finding("attitude_level"))
    if integrated:
        _integrate_attitude(values, time, layout, str(path), notes)
    _require_quantities(values, layout, list(table.columns), str(path), hover=hover)
    battery = _battery_voltage(values.pop("battery", None), time, notes)
    heights = {name: _surface_height(values.pop(name), layout, name, str(path)) for name in HEIGHTS if name in values}
    wind = _wind_of_mapping(Path(path), layout, notes)
    command, companion = layout.rotor_command, _companion_position(Path(path), layout, time, notes)
    log = FlightLog(
        path=str(path),
        time=time,
        lines=table.index.to_numpy(),
        battery=battery,
        collective=command is not None and command.repeat > 1,
        lift_off=layout.lift_off_m,
        hover_above=layout.hover_above_m,
        torques=layout.torques,
        attitude_integrated=integrated,
        wind=wind,
        notes=tuple(notes),
        **{"other_position": companion, **heights, **to_package_frames(values, layout)},
    )
    if clock_steps:
        check_motion_at_clock_steps(without_bad_quaternions(log), clock_steps)
    return log


def _with_mapping(log: FlightLog, layout: LogMapping) -> FlightLog:
    """Return a binary log with the facts on its flight that a mapping declares."""
    notes = list(log.notes)
    if layout.lacks:
        notes.append(Finding("mapping_note", "", {"text": layout.lacks}))
    return replace(
        log,
        lift_off=layout.lift_off_m,
        hover_above=layout.hover_above_m,
        torques=log.torques and layout.torques,
        wind=_wind_of_mapping(Path(log.path), layout, notes),
        notes=tuple(notes),
    )


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
        log = read_flight_log(partner, mapping=replace(layout, companion={}))
        assert log.position is not None
        place = np.stack([np.interp(time, log.time, p, left=np.nan, right=np.nan) for p in log.position.T], axis=1)
        after = np.clip(np.searchsorted(log.time, time), 1, log.time.size - 1)
        place[log.time[after] - log.time[after - 1] > COMPANION_GAP_S] = np.nan
        notes.append(Finding("other_vehicle", "", {"file": partner.name}))
        return place
    return None


def _wind_of_mapping(path: Path, layout: LogMapping, notes: list[Finding]) -> tuple[float, float, float] | None:
    """Return the wind [m/s], world ENU, that the mapping declares for this file name; None without one."""
    matches = [text for text in layout.wind if text in path.stem]
    if len(matches) > 1:
        raise DataError(f"{path}: the mapping declares the wind of {' and of '.join(matches)}; make the texts differ")
    if not matches:
        if layout.wind:
            notes.append(Finding("wind_not_declared"))
        return None
    x, y, z = layout.wind[matches[0]]
    wind = (y, x, -z) if layout.world_frame == "ned" else (x, y, z)
    notes.append(Finding("wind_declared", "", {"wind_m_s": list(wind)}))
    return wind


def _require_quantities(
    values: dict[str, Array], layout: LogMapping, known: list[str], path: str, *, hover: bool
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
    for one, other in (("ang_vel", "specific_force"), ("rotor_speed", "rotor_command")):
        if one in values or other in values or (hover and one == "ang_vel"):
            continue
        options = [q.columns for key, q in layout.quantities().items() if key in (one, other)]
        wanted = " or ".join(", ".join(columns) for columns in options) or f"{one} or {other} in the mapping"
        raise DataError(f"{path}: needs the columns {wanted}; they are missing or empty.{mapping_hint(known)}")
    if "rotor_speed" in values and "rotor_command" in values:
        speeds, commands = values["rotor_speed"].shape[1], values["rotor_command"].shape[1]
        if speeds != commands:
            raise DataError(
                f"{path}: has {speeds} rotor speeds and {commands} commands; both need one column per rotor"
            )
