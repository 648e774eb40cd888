"""PX4 ULog files as one table: every topic on the clock of the slowest one that is needed, gaps left as gaps.

Columns keep PX4's frames (world north-east-down, body forward-right-down, quaternion w first, body to world); the mapping
``px4_ulog`` turns them. Letters: T rows.

Source: PX4 message definitions (github PX4/PX4-Autopilot, msg/): VehicleAttitude, VehicleLocalPosition, SensorCombined,
VehicleAngularVelocity, ActuatorMotors, ActuatorOutputs, EscStatus, BatteryStatus.
"""

from collections.abc import Mapping
from pathlib import Path

import numpy as np
import pandas as pd

from aerial_gym.errors import DataError, MissingDependencyError
from aerial_gym.sim2real.arrays import Array, Flags
from aerial_gym.sim2real.logs.signals import signs_of

Topics = Mapping[str, Mapping[str, Array]]

TOPICS: dict[str, dict[str, str]] = {
    "vehicle_attitude": {f"q[{i}]": f"q_{axis}" for i, axis in enumerate("wxyz")},
    "vehicle_local_position": {"x": "p_x", "y": "p_y", "z": "p_z", "vx": "v_x", "vy": "v_y", "vz": "v_z"},
    "vehicle_angular_velocity": {f"xyz[{i}]": f"omega_{axis}" for i, axis in enumerate("xyz")},
    "sensor_combined": {f"accelerometer_m_s2[{i}]": f"acc_{axis}" for i, axis in enumerate("xyz")},
    "esc_status": {f"esc[{i}].esc_rpm": f"rpm_{i + 1}" for i in range(8)},
    "actuator_motors": {f"control[{i}]": f"control_{i + 1}" for i in range(12)},
    "actuator_outputs": {f"output[{i}]": f"output_{i + 1}" for i in range(16)},
    "battery_status": {"voltage_v": "voltage"},
}
"""Columns of the table by field, by topic."""

GYRO = {f"gyro_rad[{i}]": f"omega_{axis}" for i, axis in enumerate("xyz")}
"""Fields of sensor_combined that stand in where there is no vehicle_angular_velocity."""

CLOCKS = ("vehicle_attitude", "vehicle_angular_velocity", "sensor_combined", "esc_status", "actuator_motors")
"""Topics whose samples must lie near a row; the slowest of them is the clock."""

REACH = 2.5
"""A row needs samples of a topic on both sides, not further apart than this many of the topic's usual steps."""

SLOWEST_CLOCK_HZ = 20.0
"""A topic slower than this is no clock; it is left out, and the note says so, unless it is the attitude."""


def ulog_table(path: Path) -> pd.DataFrame:
    """Return the table of a ULog file, read by pyulog.

    Raises:
        DataError: If the file is no ULog, or has no attitude.
        MissingDependencyError: If pyulog is not installed.
    """
    try:
        from pyulog import ULog  # pyright: ignore[reportMissingImports]
    except ImportError:
        raise MissingDependencyError("reading .ulg files needs pyulog: pip install 'aerial-gym[sim2real]'") from None
    if not path.is_file():
        raise DataError(f"{path}: no such file")
    try:
        log = ULog(str(path), list(TOPICS))
    except Exception as error:  # pyulog raises whatever its parser meets
        raise DataError(f"{path}: cannot be read as a PX4 ULog ({error!r})") from None
    return topics_table({part.name: part.data for part in log.data_list if part.multi_id == 0}, str(path))


def topics_table(topics: Topics, path: str) -> pd.DataFrame:
    """Return the table of topics, each a mapping of its fields to arrays, timestamps in microseconds.

    Faster topics are averaged over a step of the clock, slower ones joined by straight lines, commands held. Rows without
    samples nearby are left out, so that a gap stays a gap.

    Raises:
        DataError: If there is no attitude.
    """
    series = {name: found for name in TOPICS if name in topics and (found := _series(topics, name, path))}
    if "vehicle_attitude" not in series:
        raise DataError(f"{path}: has no topic vehicle_attitude; log it (SDLOG_PROFILE) and fly again")
    steps = {name: float(np.median(np.diff(time))) for name, (time, _) in series.items()}
    clocks = [n for n in CLOCKS if n in series and (steps[n] < 1.0 / SLOWEST_CLOCK_HZ or n == "vehicle_attitude")]
    clock = max(clocks, key=lambda name: steps[name])
    rows, columns = series[clock][0], {}
    near = np.ones(rows.size, dtype=bool)
    for name, (time, values) in series.items():
        if name in CLOCKS and name not in clocks:
            continue  # too slow to say anything about the rotors
        held = name.startswith("actuator")
        for label, column in values.items():
            columns[label] = column if name == clock else _on_clock(rows, time, column, steps[clock], held=held)
        if name != "battery_status":
            near &= _covered(rows, time, steps[name])
    return pd.DataFrame({name: column[near] for name, column in {"t": rows, **columns}.items()})


def _series(topics: Topics, name: str, path: str) -> tuple[Array, dict[str, Array]] | None:
    """Return times [s], increasing, and the columns of a topic; None if it has no usable rows."""
    topic = topics[name]
    wanted = dict(TOPICS[name])
    if name == "sensor_combined" and "vehicle_angular_velocity" not in topics:
        wanted |= GYRO
    clock = "timestamp_sample" if "timestamp_sample" in topic else "timestamp"
    stamp = np.asarray(topic[clock], dtype=np.float64) * 1e-6
    values = {label: np.asarray(topic[key], dtype=np.float64) for key, label in wanted.items() if key in topic}
    values = {label: column for label, column in values.items() if np.isfinite(column).any()}
    if name in ("esc_status", "actuator_outputs"):  # unused entries are 0 in every row
        values = {label: column for label, column in values.items() if np.any(column != 0.0)}
    if not values:
        return None
    good = np.all([np.isfinite(column) for column in values.values()], axis=0)
    good &= np.concatenate(([True], np.diff(np.maximum.accumulate(stamp)) > 0.0))
    if good.sum() < 2:
        raise DataError(f"{path}: topic {name} has {good.sum()} usable rows, needs 2")
    if name == "vehicle_attitude":
        signs = signs_of(np.stack([values[f"q_{axis}"] for axis in "wxyz"], axis=1))
        values = {label: column * signs for label, column in values.items()}
    return stamp[good], {label: column[good] for label, column in values.items()}


def _on_clock(rows: Array, time: Array, values: Array, step: float, *, held: bool) -> Array:
    """Return values (T,) at the rows: the last one where held, the mean over a step where there are several, else a line."""
    if held:
        return values[np.clip(np.searchsorted(time, rows, side="right") - 1, 0, None)]
    first, last = (np.searchsorted(time, rows + side * 0.5 * step) for side in (-1.0, 1.0))
    total = np.concatenate(([0.0], np.cumsum(values)))
    centre = np.concatenate(([0.0], np.cumsum(time)))
    count = np.maximum(last - first, 1)
    line = np.interp(rows, time, values)
    mean = (total[last] - total[first]) / count
    # The mean belongs to the mean time of its samples; a line through them takes it to the row.
    shift = rows - (centre[last] - centre[first]) / count
    slope = (np.interp(rows + 0.5 * step, time, values) - np.interp(rows - 0.5 * step, time, values)) / step
    return np.where(last - first >= 2, mean + shift * slope, line)


def _covered(rows: Array, time: Array, step: float) -> Flags:
    """Return which rows lie between two samples that are not further apart than usual, (T,)."""
    after = np.searchsorted(time, rows, side="left")
    inside = (after < time.size) & ((after > 0) | (time[0] == rows))
    high, low = np.clip(after, 0, time.size - 1), np.clip(after - 1, 0, None)
    hit = time[high] == rows
    return inside & (hit | (time[high] - time[low] <= REACH * step))
