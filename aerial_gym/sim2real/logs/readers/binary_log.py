"""Read a flight of a binary log: channels of its reader, on one clock, and resampled to the rows of the gyro.

Letters: T rows, R rotors.
"""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from math import inf
from typing import Any

import numpy as np
import pandas as pd

from aerial_gym.errors import DataError
from aerial_gym.registry.log_formats import LOG_READERS
from aerial_gym.sim2real.arrays import Array
from aerial_gym.sim2real.findings import Finding
from aerial_gym.sim2real.logs.flight_spans import FlightSpan, leave_out_partial_streams
from aerial_gym.sim2real.logs.raw_log import NO_MOTION, QUANTITIES, SETPOINTS, LogChannel, RawLog, Topic
from aerial_gym.sim2real.logs.readers.csv_table import apply_column_conversion
from aerial_gym.sim2real.logs.readers.mapping import UNITS, ColumnsCfg, LogMapping, to_package_frames
from aerial_gym.sim2real.logs.readers.setpoints import setpoint_channels
from aerial_gym.sim2real.logs.readers.stamps import SHOWN
from aerial_gym.sim2real.logs.recording import FlightLog, StreamTiming, absent_pairs
from aerial_gym.sim2real.logs.row_grid import resample_streams, row_times, without_slow_rotor_data
from aerial_gym.sim2real.logs.signals import integrate_rates
from aerial_gym.sim2real.logs.stream_delays import (
    CORRECTED_S,
    DELAY_ROWS_HZ,
    DELAY_SPAN_S,
    StreamDelay,
    stream_delays,
    with_motion_between_samples,
)
from aerial_gym.sim2real.logs.streams import (
    Stream,
    undo_resets,
    usable_streams,
)


def streams_of_log(raw: RawLog, mapping: LogMapping | None = None) -> tuple[dict[str, Stream], list[Finding]]:
    """Return the streams of a decoded log on one clock, and findings; raise ``DataError`` if they show no attitude."""
    notes = list(raw.notes)
    channels = LOG_READERS.get(raw.format).channels(raw)
    mapped = _channels_of_mapping(raw, channels, mapping)
    streams = usable_streams([*(one for one in mapped if one.quantity not in SETPOINTS), *channels], notes)
    streams |= _setpoint_streams([*mapped, *setpoint_channels(raw)], streams)
    streams = leave_out_partial_streams(undo_resets(streams, notes), notes)
    if not {"attitude", "ang_vel"} & streams.keys():
        remedy = f"log one of them.{_sentences_on_topics_left_out(notes)}"
        raise DataError(f"{raw.path}: holds neither attitude nor angular velocity of the whole log; {remedy}")
    return streams, notes


def _sentences_on_topics_left_out(notes: Sequence[Finding]) -> str:
    """Return sentences that name the topics left out; empty without any."""
    left = [f" Topic left out: {note.values['error']}." for note in notes if note.code == "topic_left_out"]
    return "".join(left[:SHOWN]) + (f" And {len(left) - SHOWN} more." if len(left) > SHOWN else "")


def _setpoint_streams(channels: Sequence[LogChannel], streams: Mapping[str, Stream]) -> dict[str, Stream]:
    """Return the setpoints among channels, on the clock of the streams; unusable ones are left out."""
    asked = [channel for channel in channels if channel.quantity in SETPOINTS]
    known = usable_streams([*(one.channel for one in list(streams.values())[:1]), *asked], [])
    return {name: stream for name, stream in known.items() if name in SETPOINTS}


def _channels_of_mapping(raw: RawLog, channels: Sequence[LogChannel], mapping: LogMapping | None) -> list[LogChannel]:
    """Return the channels that a mapping declares.

    Its columns are ``topic.field`` or ``topic[instance].field``. A column with the name of the quantity stands for the
    reader's own channel, so that a gain can convert it.
    """
    if mapping is None:
        return []
    names = {name: name for name in (*QUANTITIES, *SETPOINTS)} | {"rotor_share": "rotor_command"}
    quantities = {names[name]: quantity for name, quantity in mapping.quantities().items() if name in names}
    return [_channel_of_mapping(raw, channels, name, quantity, mapping) for name, quantity in quantities.items()]


def _channel_of_mapping(
    raw: RawLog, channels: Sequence[LogChannel], name: str, quantity: ColumnsCfg, mapping: LogMapping
) -> LogChannel:
    own = next((channel for channel in channels if channel.quantity == name), None)
    if quantity.columns == (name,) and own is not None:
        values = apply_column_conversion(own.values, pd.DataFrame(), quantity, raw.path) * UNITS[quantity.unit]
        return replace(own, values=values)
    places = [_find_column(raw, column) for column in quantity.columns]
    topic = places[0][0]
    if any(other is not topic for other, _ in places):
        raise DataError(f"{raw.path}: the columns of {name} are of several topics; a quantity needs one topic")
    table = pd.DataFrame({key: np.asarray(column, dtype=np.float64) for key, column in topic.columns.items()})
    values = topic.numbers(*(field for _, field in places))
    values = apply_column_conversion(values, table, quantity, raw.path) * UNITS[quantity.unit]
    values = to_package_frames({name: values}, mapping)[name]
    return topic.channel(name, values)


def _find_column(raw: RawLog, column: str) -> tuple[Topic, str]:
    """Return topic and field of ``topic.field`` or ``topic[instance].field``; raise ``DataError`` if there is none."""
    for topic in raw.topics:
        for start in (f"{topic.source}.", f"{topic.name}."):
            if column.startswith(start) and column.removeprefix(start) in topic.columns:
                return topic, column.removeprefix(start)
    raise DataError(
        f"{raw.path}: has no column {column!r}; give topic.field or topic[instance].field (aerial-gym log inspect lists "
        "the topics), or the name of the quantity for the channel of the format itself"
    )


def flight_of_streams(
    all_streams: Mapping[str, Stream], span: FlightSpan, path: str, notes: list[Finding], *, relative: bool = True,
    hover: bool = False, partial: bool = False, fastest: float = inf,
) -> FlightLog:  # fmt: skip
    """Return a flight, with delays of its streams corrected where its motion shows them.

    ``relative``: whether commands are shares of the largest speed. ``fastest``: largest rate of the rows [Hz].

    Raise ``DataError`` if a needed quantity is missing.
    """
    streams = {name: stream for name, stream in all_streams.items() if name not in NO_MOTION}
    timings = {
        name: StreamTiming(source=stream.channel.source, rate=stream.rate, latency=stream.channel.latency)
        for name, stream in streams.items()
    }
    middle = 0.5 * (span.start + span.end)
    part = replace(
        span, start=max(span.start, middle - 0.5 * DELAY_SPAN_S), end=min(span.end, middle + 0.5 * DELAY_SPAN_S)
    )
    slow = _assemble_flight(streams, row_times(streams, part, DELAY_ROWS_HZ), path, notes, hover=hover, partial=partial)
    delays = stream_delays(replace(slow, streams=timings))
    moved = _without_delays(streams, delays, path, notes)
    timings = {name: replace(timings[name], **_delay_fields(delays.get(name))) for name in moved}
    rows = row_times(moved, span, fastest)
    is_same = all(moved.get(name) is one for name, one in streams.items()) and np.array_equal(rows, slow.time)
    log = slow if is_same else _assemble_flight(moved, rows, path, notes, hover=hover, partial=partial)
    log = without_slow_rotor_data(replace(log, notes=tuple(notes)), {name: one.rate for name, one in timings.items()})
    log = with_motion_between_samples(replace(log, sample_times=_times_of_slow_motion(moved, log.time)))
    return replace(
        log,
        relative_commands=relative and log.rotor_command is not None,
        streams=timings,
        notes=tuple(dict.fromkeys(log.notes)),
    )


def _times_of_slow_motion(streams: Mapping[str, Stream], rows: Array) -> dict[str, Array]:
    """Return the sample times of position and velocity within the rows [s], if these are more than twice as many."""
    motion = {name: streams[name].time for name in ("position", "lin_vel") if name in streams}
    inside = {name: time[(time >= rows[0]) & (time <= rows[-1])] for name, time in motion.items()}
    return {name: time for name, time in inside.items() if 2 <= time.size < 0.5 * rows.size}


def _delay_fields(delay: StreamDelay | None) -> dict[str, float | bool]:
    return {} if delay is None else {name: value for name, value in vars(delay).items() if name != "quantity"}


def _without_delays(
    streams: dict[str, Stream], delays: Mapping[str, StreamDelay], path: str, notes: list[Finding]
) -> dict[str, Stream]:
    """Return the streams without their material delays; those beyond ``CORRECTED_S`` are left out, or refuse the flight."""
    results = dict(streams)
    for name, one in delays.items():
        if not one.is_material:
            continue
        stream = results.pop(name)
        if abs(one.delay) > CORRECTED_S and name == "attitude":
            raise DataError(
                f"{path}: the attitude is {one.delay:.2f} ± {one.half_width:.2f} s late against the gyro, more than is "
                f"corrected ({CORRECTED_S:g} s); correct its clock"
            )
        values = {"topic": stream.channel.source, "late_ms": 1e3 * one.delay, "half_width_ms": 1e3 * one.half_width}
        if abs(one.delay) > CORRECTED_S:
            notes.append(Finding("stream_too_late", "", values))
        else:
            results[name] = replace(stream, time=stream.time - one.delay)
            notes.append(Finding("stream_moved", "", values))
    return results


def _assemble_flight(
    streams: dict[str, Stream], rows: Array, path: str, notes: list[Finding], *, hover: bool, partial: bool
) -> FlightLog:
    """Return the flight with all streams at the rows [s]; a missing attitude is integrated from the gyro."""
    if rows.size < 2:
        raise DataError(f"{path}: the flight has {rows.size} samples of its fastest sensor, needs 2")
    values: dict[str, Any] = dict(resample_streams(streams, rows))
    for one, other in absent_pairs(values, hover=hover, partial=partial):
        remedy = f"log one of them, or map its columns (--mapping).{_sentences_on_topics_left_out(notes)}"
        raise DataError(f"{path}: holds neither {one} nor {other}; {remedy}")
    integrated = "attitude" not in values
    if integrated:
        values = {name: column for name, column in values.items() if name not in ("position", "lin_vel")}
        values["attitude"] = integrate_rates(rows, values["ang_vel"])
    if integrated and not any(note.code == "attitude_integrated" for note in notes):
        notes.append(Finding("attitude_integrated"))
    battery = values.pop("battery", None)
    return FlightLog(
        path=path,
        time=rows,
        battery=None if battery is None else battery[:, 0],
        attitude_integrated=integrated,
        origin=streams["position"].channel.origin if "position" in streams else None,
        **values,
    )
