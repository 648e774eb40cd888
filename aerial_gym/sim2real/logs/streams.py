"""Streams: log channels with valid samples on one clock, without estimator resets. Letters: T samples."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy.spatial.transform import Rotation

from aerial_gym.errors import DataError
from aerial_gym.sim2real.arrays import Array
from aerial_gym.sim2real.findings import Finding
from aerial_gym.sim2real.logs.raw_log import STATES, LogChannel
from aerial_gym.sim2real.logs.readers.csv_table import LARGEST
from aerial_gym.sim2real.logs.readers.stamps import SHOWN, ClockStep, StampCorrection, correct_stamps
from aerial_gym.sim2real.logs.recording import GAP_STEPS, NORM_OFF
from aerial_gym.sim2real.logs.signals import quaternion_signs

WRAP_S = 2**32 * 1e-6  # Wrap period of a 32-bit counter of microseconds [s]
CLOCKS = (
    "attitude",
    "ang_vel",
    "specific_force",
)  # The first of these that is usable is the reference clock, else any other


@dataclass(frozen=True, kw_only=True)
class Stream:
    """Usable samples of a log channel."""

    channel: LogChannel
    time: Array  # Increasing [s], (T,)
    values: Array  # (T, components)
    steps: tuple[ClockStep, ...] = ()  # Backward clock steps, corrected in ``time``

    @property
    def quantity(self) -> str:
        """Name of the quantity."""
        return self.channel.quantity

    @property
    def backward_steps(self) -> tuple[ClockStep, ...]:
        """Return the steps without a wrapped counter, which all topics share."""
        return tuple(step for step in self.steps if not step.counter)

    @cached_property
    def sample_step(self) -> float:
        """Return the median time between samples [s]."""
        return float(np.median(np.diff(self.time)))

    @cached_property
    def rate(self) -> float:
        """Return the usual number of samples per second [Hz]."""
        steps = np.diff(self.time)
        return 1.0 / float(steps[steps <= GAP_STEPS * self.sample_step].mean())


def usable_streams(channels: Sequence[LogChannel], notes: list[Finding]) -> dict[str, Stream]:
    """Return the first usable channel of each quantity as a stream, all on one clock; a finding names each unusable one."""
    streams: dict[str, Stream] = {}
    stamps: dict[int, StampCorrection] = {}  # by the place in memory of the times that channels of one topic share
    for channel in sorted(channels, key=lambda one: (*CLOCKS, one.quantity).index(one.quantity)):
        if channel.quantity in streams or not np.isfinite(channel.values).any():
            continue
        if channel.quantity in STATES and channel.time.size == 1:  # the only event of a log
            streams[channel.quantity] = Stream(channel=channel, time=channel.time, values=channel.values)
            continue
        try:
            key = id(channel.time)
            stamps[key] = stamps.get(key) or correct_stamps(channel.time, f"topic {channel.source}")
            stream = _stream(channel, stamps[key], notes)
            streams[channel.quantity] = _align_clock(next(iter(streams.values()), stream), stream)
        except DataError as error:
            notes.append(Finding("topic_left_out", "", {"topic": channel.source, "error": str(error)}))
    if streams:
        notes.extend(dict.fromkeys(note for stream in streams.values() for note in stream.channel.notes))
        reference = next(iter(streams.values()))
        notes.extend(s.finding("sample", s.row, topic=reference.channel.source) for s in reference.steps)
    return _with_increasing_time(_equalise_clock_steps(streams), notes)


def without_incomplete_rotor_data(streams: dict[str, Stream], notes: list[Finding]) -> dict[str, Stream]:
    """Return the streams without the speeds or commands of fewer rotors, as if an ESC sends no telemetry."""
    rotors = [streams[name] for name in ("rotor_speed", "rotor_command") if name in streams]
    few, many = (choose(rotors, key=lambda one: one.values.shape[1], default=None) for choose in (min, max))
    if few is None or many is None or few.values.shape[1] == many.values.shape[1]:
        return streams
    counts = f"{few.values.shape[1]} rotors, but {many.quantity} of {many.values.shape[1]}"
    error = f"topic {few.channel.source} has {few.quantity} of {counts}"
    notes.append(Finding("topic_left_out", "", {"topic": few.channel.source, "error": error}))
    return {name: stream for name, stream in streams.items() if stream is not few}


def _with_increasing_time(streams: dict[str, Stream], notes: list[Finding]) -> dict[str, Stream]:
    """Return the streams whose time still increases after common corrections of the clock; others become findings."""
    wrong = [name for name, stream in streams.items() if np.any(np.diff(stream.time) <= 0.0)]
    for name in wrong:
        source = streams[name].channel.source
        error = f"topic {source} steps back by other amounts than the other topics"
        notes.append(Finding("topic_left_out", "", {"topic": source, "error": error}))
    return {name: stream for name, stream in streams.items() if name not in wrong}


def _stream(channel: LogChannel, checked: StampCorrection, notes: list[Finding]) -> Stream:
    """Return the usable samples of a channel; raise ``DataError`` if there are fewer than 2."""
    notes.extend(checked.late_block_findings(checked.late.tolist(), topic=channel.source))
    values = channel.values[checked.order] if checked.late.size else channel.values
    good = (np.abs(values) <= LARGEST).all(axis=1)  # which refuses NaN as well
    if channel.quantity.startswith("attitude"):
        good &= np.abs(np.linalg.norm(np.nan_to_num(values), axis=1) - 1.0) <= NORM_OFF
    good = good[checked.kept]
    if good.sum() < 2:
        raise DataError(f"topic {channel.source} has {good.sum()} usable rows, needs 2")
    if bad := np.flatnonzero(~checked.kept).tolist():
        left_out = {"topic": channel.source, "samples": len(bad), "total": len(values), "places": bad[:SHOWN]}
        notes.append(Finding("samples_with_bad_stamps", "", left_out))
    if not good.all() or good.size < len(values):
        values = values[checked.kept][good]
    if channel.quantity.startswith("attitude"):
        values = values * quaternion_signs(values)[:, None]
    steps = tuple(replace(step, row=int(good[: step.row].sum())) for step in checked.steps)
    return Stream(channel=channel, time=checked.time[good], values=values, steps=steps)


def _align_clock(reference: Stream, one: Stream) -> Stream:
    """Return a stream moved by multiples of ``WRAP_S`` onto the reference clock; raise ``DataError`` if the clocks differ."""
    name, clock = one.channel.source, reference.channel.source
    turns = round(float(np.median(reference.time) - np.median(one.time)) / WRAP_S)
    shifted = replace(one, time=one.time + turns * WRAP_S)
    if not (shifted.time[0] < reference.time[-1] and reference.time[0] < shifted.time[-1]):
        raise DataError(
            f"topic {name} runs from {one.time[0]:.6g} to {one.time[-1]:.6g} s, {clock} from "
            f"{reference.time[0]:.6g} to {reference.time[-1]:.6g} s"
        )
    if len(one.backward_steps) != len(reference.backward_steps):
        raise DataError(
            f"topic {name} shows {len(one.backward_steps)} steps back of the clock, {clock} {len(reference.backward_steps)}"
        )
    return shifted


def _equalise_clock_steps(streams: dict[str, Stream]) -> dict[str, Stream]:
    """Return the streams with equal clock corrections: the least of each step, which the fastest topic resolves best."""
    if not any(stream.backward_steps for stream in streams.values()):
        return streams
    shifts = np.array([[step.shift for step in one.backward_steps] for one in streams.values()])
    least = shifts.min(axis=0)
    results = dict[str, Stream]()
    for (name, one), own in zip(streams.items(), shifts, strict=True):
        time = one.time.copy()
        for step, excess in zip(one.backward_steps, own - least, strict=True):
            time[step.row :] -= excess
        results[name] = replace(one, time=time)
    return results


def undo_resets(streams: Mapping[str, Stream], notes: list[Finding]) -> dict[str, Stream]:
    """Return the streams without resets of attitude and position, by the motion across each reset; setpoints move alike.

    A reset of the attitude turns all earlier samples, so that they agree with the corrected estimate; one of the position
    moves all later samples. Velocities keep theirs, as flights end there.
    """
    results = dict(streams)
    for name in ("attitude", "position"):
        stream = streams.get(name)
        if stream is None or stream.channel.resets is None:
            continue
        asked = streams.get(f"{name}_setpoint")
        wanted = None if asked is None else asked.values.copy()
        values, rate = stream.values.copy(), streams.get({"attitude": "ang_vel", "position": "lin_vel"}[name])
        for place in np.unique(np.searchsorted(stream.time, stream.channel.resets - 0.5 * stream.sample_step)).tolist():
            if not 0 < place < stream.time.size:
                continue
            way = _integral_of_rate(rate, float(stream.time[place - 1]), float(stream.time[place]))
            if name == "attitude":
                expected = Rotation.from_quat(values[place - 1]) * Rotation.from_rotvec(way)
                turn = Rotation.from_quat(values[place]) * expected.inv()
                values[:place] = (turn * Rotation.from_quat(values[:place])).as_quat()
                if asked is not None and wanted is not None and (before := asked.time < stream.time[place]).any():
                    wanted[before] = (turn * Rotation.from_quat(wanted[before])).as_quat()
                size = {"angle_deg": float(np.degrees(turn.magnitude()))}
            else:
                jump = values[place] - values[place - 1] - way
                values[place:] -= jump
                if asked is not None and wanted is not None:
                    wanted[asked.time >= stream.time[place]] -= jump
                size = {"distance_m": float(np.linalg.norm(jump))}
            notes.append(Finding("reset_undone", "", {"quantity": name, "time_s": float(stream.time[place]), **size}))
        for one, new in ((stream, values), (asked, wanted)):
            if one is not None and new is not None:
                signs = quaternion_signs(new)[:, None] if name == "attitude" else 1.0
                results[one.quantity] = replace(one, values=new * signs)
    return results


def _integral_of_rate(rate: Stream | None, start: float, end: float) -> Array:
    """Return the integral of a rate from start to end [s], (3,); 0 if it is not logged."""
    if rate is None:
        return np.zeros(3)
    inner = rate.time[(rate.time > start) & (rate.time < end)]
    time = np.concatenate(([start], inner, [end]))
    values = np.stack([np.interp(time, rate.time, column) for column in rate.values.T], axis=1)
    return np.sum(0.5 * (values[1:] + values[:-1]) * np.diff(time)[:, None], axis=0)
