"""Content of a log file: topics with their rates, flights with their streams, messages, and defects. Letters: T samples."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.integrate import trapezoid
from scipy.spatial.transform import Rotation

from aerial_gym.config.sim import STANDARD_GRAVITY
from aerial_gym.errors import DataError
from aerial_gym.registry.log_formats import LOG_READERS
from aerial_gym.sim2real.arrays import true_spans
from aerial_gym.sim2real.findings import Finding
from aerial_gym.sim2real.json_values import plain, select_fields
from aerial_gym.sim2real.logs.checks.duration import check_duration_and_rate
from aerial_gym.sim2real.logs.checks.kinematics import findings_on_sensors_at_rest
from aerial_gym.sim2real.logs.raw_log import LogChannel, LogMessage, RawLog, Topic
from aerial_gym.sim2real.logs.readers.csv_lines import find_header, read_lines
from aerial_gym.sim2real.logs.readers.csv_log import FACTS, read_facts
from aerial_gym.sim2real.logs.readers.csv_table import read_table, read_time_stamps
from aerial_gym.sim2real.logs.readers.flight_log import LogFlights, open_log
from aerial_gym.sim2real.logs.readers.log_readers import CSV, read_raw_log
from aerial_gym.sim2real.logs.readers.mapping import UNIT_G, LogMapping, find_mapping
from aerial_gym.sim2real.logs.recording import (
    FlightLog,
    StreamTiming,
    row_arrays,
    split_flight_number,
)
from aerial_gym.sim2real.logs.row_grid import row_times
from aerial_gym.sim2real.logs.signals import log_at_equal_steps, without_bad_quaternions
from aerial_gym.sim2real.logs.stream_delays import DELAY_ROWS_HZ
from aerial_gym.sim2real.logs.streams import Stream

ZERO_G_OFFSET = 0.080 * UNIT_G
"""Largest offset of a sound accelerometer [m/s²]. Source: InvenSense (2013), MPU-6000 specification 3.4, section 6.2."""

LONGEST_VALUE = 500  # Longest metadata that are shown [characters]
FASTEST_HZ = 2e4  # No sensor of a vehicle is logged faster [Hz]; samples that come closer are written in bursts

SHOWN_LEVELS = ("warning", "error")  # Levels of messages that every reader should see


NAMES_WITH_UNITS = {
    **{name: f"{name}_s" for name in ("start", "end", "longest_gap", "latency", "delay", "half_width")},
    **{"rate": "rate_hz", "battery": "battery_v", "vertical_force": "vertical_force_m_s2"},
}
"""Names in JSON of the fields with a unit."""


def fields_with_units(record: object) -> dict[str, object]:
    """Return the fields of a record for JSON, by names with their units."""
    return {NAMES_WITH_UNITS.get(name, name): value for name, value in vars(record).items()}


@dataclass(frozen=True, kw_only=True)
class TopicSummary:
    """Size and times of one topic."""

    name: str
    instance: int
    samples: int
    rate: float | None  # Usual number of samples per second [Hz]; None for bursts and single samples
    start: float | None  # First stamp [s]
    end: float | None  # Last stamp [s]
    longest_gap: float | None  # Longest time between samples [s]

    def as_mapping(self) -> dict[str, object]:
        """Return the values for JSON."""
        return fields_with_units(self)


@dataclass(frozen=True, kw_only=True)
class FlightSummary:
    """Time, streams and findings of one flight."""

    path: str  # Path that selects this flight
    start: float  # [s]
    end: float  # [s]
    ended_by: str  # landing, gap, velocity_reset, clock_set_back, impact or log_end
    rate: float  # Rows per second [Hz]
    streams: Mapping[str, StreamTiming]  # By quantity
    battery: tuple[float, float] | None  # Lowest and highest voltage [V]
    vertical_force: float | None  # Mean vertical specific force less dv/dt [m/s²]: g for a sound accelerometer
    notes: tuple[Finding, ...]
    refusal: str | None  # Reason why no comparison takes this flight

    def as_mapping(self) -> dict[str, object]:
        """Return the values for JSON."""
        streams = {quantity: fields_with_units(timing) for quantity, timing in self.streams.items()}
        return fields_with_units(self) | {"streams": streams, "battery_v": plain(self.battery)}


@dataclass(frozen=True, kw_only=True)
class LogInspection:
    """Content of one file."""

    raw: RawLog  # Its format is a name in ``LOG_READERS``, or csv
    armed: tuple[tuple[float, float], ...] = ()  # Spans in which the vehicle is armed [s]
    flights: tuple[FlightSummary, ...]
    refusals: tuple[str, ...]  # Reasons why the file, or a flight in it, cannot be used
    notes: tuple[Finding, ...]  # Findings on the file as a whole

    @property
    def topics(self) -> list[TopicSummary]:
        """Return size and times of all topics."""
        return [topic_summary(topic) for topic in self.raw.topics]

    @property
    def short_metadata(self) -> dict[str, str]:
        """Return the metadata without long texts, such as the output of a boot."""
        return {name: value for name, value in self.raw.metadata.items() if len(value) <= LONGEST_VALUE}

    @property
    def warnings(self) -> tuple[LogMessage, ...]:
        """Return the warnings and errors of the firmware."""
        return tuple(message for message in self.raw.messages if message.level in SHOWN_LEVELS)

    def as_mapping(self) -> dict[str, object]:
        """Return the values for JSON, with findings as objects."""
        head = select_fields(self.raw, "path", "format", "parameter_changes") | {"metadata": self.short_metadata}
        content = head | select_fields(self, "topics", "armed", "flights", "refusals")
        return content | {"notes": self.notes, "messages": plain(self.raw.messages)}


def inspect_log(path: str | Path, mapping: LogMapping | None = None) -> LogInspection:
    """Return the content of a log file, of ``FILE#2`` only that flight; raise ``DataError`` if nothing can be decoded."""
    file, number = split_flight_number(path)
    try:
        opened = open_log(file, mapping)
    except DataError as error:
        raw = _raw_log(Path(file), mapping, error)
        return LogInspection(
            raw=raw,
            flights=(),
            refusals=(str(error),),
            notes=raw.notes,
            armed=_spans_of_arming(_channel_of_arming(raw)),
        )
    opened, flights, refusals = opened.select(number), list[FlightSummary](), list[str]()
    for number in opened.numbers:
        try:
            flights.append(_flight_summary(opened, number))
        except DataError as error:
            refusals.append(str(error))
    return LogInspection(
        raw=opened.raw,
        flights=tuple(flights),
        refusals=tuple(refusals),
        notes=tuple(opened.notes),
        armed=_spans_of_arming(opened.streams.get("armed")),
    )


def _flight_summary(opened: LogFlights, number: int) -> FlightSummary:
    span, log = opened.spans[number - 1], opened.flight(number, fastest=DELAY_ROWS_HZ)
    time = log.time if opened.rows is not None else row_times(opened.streams, span)
    rate = 1.0 / float(np.median(np.diff(time)))
    vertical_force = _mean_vertical_force(log)
    quantities = [name for name in row_arrays(log) if name not in ("time", "lines")]
    return FlightSummary(
        path=log.path,
        start=float(log.time[0]),
        end=float(log.time[-1]),
        ended_by=span.ended_by,
        rate=rate,
        streams=log.streams or {name: StreamTiming(source="table[0]", rate=rate) for name in quantities},
        battery=None if log.battery is None else (float(log.battery.min()), float(log.battery.max())),
        vertical_force=vertical_force,
        notes=(*(note for note in log.notes if note not in opened.notes), *_findings_on_sensors(log, vertical_force)),
        refusal=_refusal_of_comparisons(log),
    )


def _refusal_of_comparisons(log: FlightLog) -> str | None:
    """Return the reason why ``replay`` and ``close-loop`` refuse a flight by its length or rate; None without one."""
    try:
        check_duration_and_rate(log)
    except DataError as error:
        return str(error)
    return None


def _mean_vertical_force(log: FlightLog) -> float | None:
    """Return the mean vertical specific force less that of the change of velocity [m/s²]; None if either is not logged."""
    if log.specific_force is None or log.lin_vel is None:
        return None
    force = Rotation.from_quat(log.attitude).apply(log.specific_force)[:, 2]
    gained = log.lin_vel[-1, 2] - log.lin_vel[0, 2]
    return float((trapezoid(force, log.time) - gained) / np.ptp(log.time))


def _findings_on_sensors(log: FlightLog, vertical_force: float | None) -> list[Finding]:
    notes = list[Finding]()
    if vertical_force is not None and abs(vertical_force - STANDARD_GRAVITY) > ZERO_G_OFFSET:
        notes.append(Finding("vertical_force_off", "", {"mean_m_s2": vertical_force, "offset_m_s2": ZERO_G_OFFSET}))
    try:
        return notes + findings_on_sensors_at_rest(log_at_equal_steps(without_bad_quaternions(log)))
    except DataError:  # the checks of a log for a comparison report it
        return notes


def topic_summary(topic: Topic) -> TopicSummary:
    """Return size and times of a topic; stamps that are no numbers do not count."""
    stamps = topic.time[np.isfinite(topic.time)]
    steps = np.diff(stamps)
    rises = steps[steps > 0.0]
    rate = 1.0 / float(np.median(rises)) if rises.size else np.inf
    return TopicSummary(
        name=topic.name,
        instance=topic.instance,
        samples=topic.time.size,
        rate=rate if rate <= FASTEST_HZ else None,
        start=float(stamps[0]) if stamps.size else None,
        end=float(stamps[-1]) if stamps.size else None,
        longest_gap=float(rises.max()) if rises.size else None,
    )


def _channel_of_arming(raw: RawLog) -> LogChannel | None:
    channels = () if raw.format == "csv" else LOG_READERS.get(raw.format).channels(raw)
    return next((one for one in channels if one.quantity == "armed"), None)


def _spans_of_arming(armed: LogChannel | Stream | None) -> tuple[tuple[float, float], ...]:
    """Return the spans between arming and disarming [s], or the end of the log."""
    if armed is None:
        return ()
    time, spans = armed.time, true_spans(armed.values[:, 0] > 0.0)
    return tuple((float(time[a]), float(time[min(b, time.size - 1)])) for a, b in spans)


def csv_raw_log(path: Path, mapping: LogMapping | None) -> RawLog:
    """Return a CSV file as a log with one topic ``table``; raise ``DataError`` if it holds no time or no rows."""
    layout, notes = mapping or find_mapping("aerial_gym"), list[Finding]()
    table = read_table(path, layout, notes)
    columns = {str(name): np.asarray(values) for name, values in table.items()}
    columns = {name: values.astype("u1") if values.dtype == bool else values for name, values in columns.items()}
    columns = {name: values for name, values in columns.items() if values.dtype.kind in "fiu"}
    topic = Topic(name="table", time=read_time_stamps(table, layout, str(path)), columns=columns)
    facts = read_facts(path)
    metadata = {} if facts is None else {FACTS: facts.line()}
    return RawLog(path=str(path), format=CSV, topics=(topic,), metadata=metadata, notes=tuple(notes))


def _raw_log(file: Path, mapping: LogMapping | None, error: DataError) -> RawLog:
    """Return the content of a log without a usable flight; raise ``error`` if there is no such file or no header line."""
    raw = read_raw_log(file)
    if raw is not None:
        return raw
    try:
        return csv_raw_log(file, mapping)
    except DataError:
        return _raw_log_of_header(file, error)


def _raw_log_of_header(path: Path, error: DataError) -> RawLog:
    """Return the number of lines and the column names of a CSV file whose layout is unknown; raise ``error`` without names."""
    lines = read_lines(path)
    header = find_header(iter(lines), "")
    if header is None or len(header.names) < 2:
        raise error
    topic = Topic(name="table", time=np.full(len(lines) - 1, np.nan), columns={})
    return RawLog(path=str(path), format="csv", topics=(topic,), metadata={"columns": ", ".join(header.names)})
