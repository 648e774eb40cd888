"""Read PX4 ULog files as one table on the clock of the slowest required topic, with gaps preserved.

Columns keep PX4's frames (world north-east-down, body forward-right-down, quaternion w first, body to world); the mapping
``px4_ulog`` turns them. Letters: T rows.

Source: PX4 message definitions (github PX4/PX4-Autopilot, msg/): VehicleAttitude, VehicleLocalPosition, SensorCombined,
VehicleAngularVelocity, ActuatorMotors, ActuatorOutputs, EscStatus, BatteryStatus.
"""

from collections.abc import Mapping
from contextlib import redirect_stdout
from dataclasses import dataclass, replace
from io import StringIO
from pathlib import Path

import numpy as np
import pandas as pd

from aerial_gym.errors import DataError, MissingDependencyError
from aerial_gym.sim2real.arrays import Array, Flags
from aerial_gym.sim2real.findings import Finding
from aerial_gym.sim2real.logs.readers.stamps import SHOWN, ClockStep, StampCorrection, correct_stamps, stamp_seconds
from aerial_gym.sim2real.logs.signals import quaternion_signs

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
"""Column names by topic and field."""

GYRO = {f"gyro_rad[{i}]": f"omega_{axis}" for i, axis in enumerate("xyz")}
"""Fields of sensor_combined that replace a missing vehicle_angular_velocity."""

CLOCKS = ("vehicle_attitude", "vehicle_angular_velocity", "sensor_combined", "esc_status", "actuator_motors")
"""Topics that every row needs; the slowest of them is the clock."""

REACH = 2.5  # Largest distance of the two samples around a row, in usual steps of the topic
LONGEST_LATENCY_US = 1_000_000  # Largest delay from sampling to publication [us] on one clock
WRAP_S = 2**32 * 1e-6  # Wrap period of a 32-bit counter of microseconds [s]
MOST_UNCOVERED = 0.01  # A larger share of rows without samples of a topic is reported
SLOWEST_CLOCK_HZ = 20.0  # Lowest rate of a clock topic; slower ones except the attitude are dropped


@dataclass(frozen=True, kw_only=True)
class TopicSamples:
    """Usable samples of a topic."""

    time: Array  # Increasing [s], (T,)
    columns: dict[str, Array]  # Values by column, each (T,)
    steps: tuple[ClockStep, ...]  # Backward clock steps, corrected in ``time``

    @property
    def backward_steps(self) -> tuple[ClockStep, ...]:
        """Return the steps without a wrapped counter, which all topics share."""
        return tuple(step for step in self.steps if not step.counter)

    @property
    def sample_step(self) -> float:
        """Return the median time between samples [s]."""
        return float(np.median(np.diff(self.time)))


def read_ulog_table(path: Path, notes: list[Finding]) -> tuple[pd.DataFrame, tuple[float, ...]]:
    """Return the table of a ULog file and the corrected times of its clock steps [s].

    Raise ``DataError`` if the file is not a ULog or has no attitude. Raise ``MissingDependencyError`` if pyulog is not
    installed.
    """
    try:
        from pyulog import ULog  # pyright: ignore[reportMissingImports]
    except ImportError:
        raise MissingDependencyError("reading .ulg files needs pyulog: pip install 'aerial-gym[sim2real]'") from None
    if not path.is_file():
        raise DataError(f"{path}: no such file")
    try:
        with redirect_stdout(StringIO()):  # pyulog prints what it skips
            log = ULog(str(path), list(TOPICS))
    except Exception as error:  # pyulog raises many types
        raise DataError(f"{path}: cannot be read as a PX4 ULog ({error!r})") from None
    if log.file_corruption:
        notes.append(Finding("file_damaged"))
    return merge_topics({part.name: part.data for part in log.data_list if part.multi_id == 0}, str(path), notes)


def merge_topics(topics: Topics, path: str, notes: list[Finding]) -> tuple[pd.DataFrame, tuple[float, ...]]:
    """Return topics (arrays by field) as one table on one clock, and the corrected times of clock steps [s].

    Faster topics are averaged, slower ones interpolated, commands held; rows without nearby samples are dropped. A topic
    without usable stamps becomes a finding; without an attitude a ``DataError`` is raised.
    """
    if "vehicle_attitude" not in topics:
        raise DataError(f"{path}: has no topic vehicle_attitude; log it (SDLOG_PROFILE) and fly again")
    try:
        reference = _topic_samples(topics, "vehicle_attitude", notes)
    except DataError as error:
        raise DataError(f"{path}: {error}") from None
    tables = {"vehicle_attitude": reference}
    for name in TOPICS.keys() & topics.keys() - {"vehicle_attitude"}:
        try:
            tables[name] = _align_clock(reference, _topic_samples(topics, name, notes), name)
        except DataError as error:
            notes.append(Finding("topic_left_out", "", {"topic": name, "error": str(error)}))
    series = _equalise_clock_steps({name: tables[name] for name in TOPICS if name in tables and tables[name].columns})
    clocks = [
        n for n in CLOCKS if n in series and (series[n].sample_step < 1.0 / SLOWEST_CLOCK_HZ or n == "vehicle_attitude")
    ]
    clock = max(clocks, key=lambda name: series[name].sample_step)
    rows, columns = series[clock].time, {}
    near = np.ones(rows.size, dtype=bool)
    for name, one in series.items():
        if name in CLOCKS and name not in clocks:
            continue  # too slow for a comparison
        held = name.startswith("actuator")
        for label, column in one.columns.items():
            if name != clock:
                column = _resample_to_clock(rows, one.time, column, series[clock].sample_step, held=held)
            columns[label] = column
        if name != "battery_status":
            covered = _is_covered(rows, one.time, one.sample_step)
            if np.mean(~covered) > MOST_UNCOVERED:
                left_out = {"rows": int(np.sum(~covered)), "total": rows.size, "topic": name}
                notes.append(Finding("rows_without_topic", "", left_out))
            near &= covered
    attitude = series["vehicle_attitude"]
    table = pd.DataFrame({name: column[near] for name, column in {"t": rows, **columns}.items()})
    return table, tuple(float(attitude.time[step.row]) for step in attitude.steps)


def _topic_samples(topics: Topics, name: str, notes: list[Finding]) -> TopicSamples:
    """Return the usable samples of a topic, no columns if it holds none; raise ``DataError`` for unusable stamps."""
    topic, wanted = topics[name], dict(TOPICS[name])
    if name == "sensor_combined" and "vehicle_angular_velocity" not in topics:
        wanted |= GYRO
    values = {label: np.asarray(topic[key], dtype=np.float64) for key, label in wanted.items() if key in topic}
    values = {label: column for label, column in values.items() if np.isfinite(column).any()}
    if name in ("esc_status", "actuator_outputs"):  # unused entries are 0 in every row
        values = {label: column for label, column in values.items() if np.any(column != 0.0)}
    if not values:
        return TopicSamples(time=np.zeros(0), columns={}, steps=())
    whole = np.all([np.isfinite(column) for column in values.values()], axis=0)
    checked = _topic_stamps(topic, f"topic {name}")
    notes.extend(checked.late_block_findings(checked.late.tolist(), topic=name))
    whole, values = whole[checked.order], {label: column[checked.order] for label, column in values.items()}
    good = whole[checked.kept]
    if good.sum() < 2:
        raise DataError(f"topic {name} has {good.sum()} usable rows, needs 2")
    if bad := np.flatnonzero(~checked.kept).tolist():
        left_out = {"topic": name, "samples": len(bad), "total": whole.size, "places": bad[:SHOWN]}
        notes.append(Finding("samples_with_bad_stamps", "", left_out))
    if name == "vehicle_attitude":
        notes.extend(step.finding("sample", step.row, topic=name) for step in checked.steps)
        signs = quaternion_signs(np.stack([values[f"q_{axis}"] for axis in "wxyz"], axis=1))
        values = {label: column * signs for label, column in values.items()}
    steps = tuple(replace(step, row=int(good[: step.row].sum())) for step in checked.steps)
    columns = {label: column[checked.kept][good] for label, column in values.items()}
    return TopicSamples(time=checked.time[good], columns=columns, steps=steps)


def _topic_stamps(topic: Mapping[str, Array], name: str) -> StampCorrection:
    """Return the sampling time of a topic, or its publication time if the former is on another clock or unusable."""
    published, sampled = (topic.get(name) for name in ("timestamp", "timestamp_sample"))
    stamps = [stamp for stamp in (sampled, published) if stamp is not None]
    if sampled is not None and published is not None:
        latency = np.asarray(published).astype(np.int64) - np.asarray(sampled).astype(np.int64)
        if np.median((latency >= 0) & (latency < LONGEST_LATENCY_US)) == 0.0:
            stamps.reverse()
    try:
        return correct_stamps(stamp_seconds(stamps[0], 1e-6), name)
    except DataError:
        if len(stamps) == 1:
            raise
        return correct_stamps(stamp_seconds(stamps[1], 1e-6), name)


def _align_clock(reference: TopicSamples, one: TopicSamples, name: str) -> TopicSamples:
    """Return a topic moved by multiples of ``WRAP_S`` onto the reference clock; raise ``DataError`` if the clocks differ."""
    if not one.columns:
        return one
    turns = round(float(np.median(reference.time) - np.median(one.time)) / WRAP_S)
    shifted = replace(one, time=one.time + turns * WRAP_S)
    if not (shifted.time[0] < reference.time[-1] and reference.time[0] < shifted.time[-1]):
        raise DataError(
            f"topic {name} runs from {one.time[0]:.6g} to {one.time[-1]:.6g} s, vehicle_attitude from "
            f"{reference.time[0]:.6g} to {reference.time[-1]:.6g} s"
        )
    if len(one.backward_steps) != len(reference.backward_steps):
        raise DataError(
            f"topic {name} shows {len(one.backward_steps)} steps back of the clock, vehicle_attitude "
            f"{len(reference.backward_steps)}"
        )
    return shifted


def _equalise_clock_steps(series: dict[str, TopicSamples]) -> dict[str, TopicSamples]:
    """Return the topics with equal clock corrections: the least of each step, which the fastest topic resolves best."""
    shifts = np.array([[step.shift for step in one.backward_steps] for one in series.values()])
    least = shifts.min(axis=0)
    tables = dict[str, TopicSamples]()
    for (name, one), own in zip(series.items(), shifts, strict=True):
        time = one.time.copy()
        for step, excess in zip(one.backward_steps, own - least, strict=True):
            time[step.row :] -= excess
        tables[name] = replace(one, time=time)
    return tables


def _resample_to_clock(rows: Array, time: Array, values: Array, step: float, *, held: bool) -> Array:
    """Return values (T,) at the rows: held, averaged over a step with several samples, else interpolated."""
    if held:
        return values[np.clip(np.searchsorted(time, rows, side="right") - 1, 0, None)]
    first, last = (np.searchsorted(time, rows + side * 0.5 * step) for side in (-1.0, 1.0))
    total = np.concatenate(([0.0], np.cumsum(values)))
    centre = np.concatenate(([0.0], np.cumsum(time)))
    count = np.maximum(last - first, 1)
    line = np.interp(rows, time, values)
    mean = (total[last] - total[first]) / count
    # The mean belongs to the mean time of its samples; the local slope moves it to the row.
    shift = rows - (centre[last] - centre[first]) / count
    slope = (np.interp(rows + 0.5 * step, time, values) - np.interp(rows - 0.5 * step, time, values)) / step
    return np.where(last - first >= 2, mean + shift * slope, line)


def _is_covered(rows: Array, time: Array, step: float) -> Flags:
    """Return the rows between two samples at most ``REACH`` usual steps apart, (T,)."""
    after = np.searchsorted(time, rows, side="left")
    inside = (after < time.size) & ((after > 0) | (time[0] == rows))
    high, low = np.clip(after, 0, time.size - 1), np.clip(after - 1, 0, None)
    hit = time[high] == rows
    return inside & (hit | (time[high] - time[low] <= REACH * step))
