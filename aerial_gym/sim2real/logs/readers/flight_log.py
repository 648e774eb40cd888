"""Open logs of all formats, and read their flights.

World is ENU (z up), body is x forward, y left, z up, quaternions are xyzw, body to world, SI units.
Letters: T rows.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from math import inf
from pathlib import Path

import numpy as np

from aerial_gym.errors import DataError
from aerial_gym.sim2real.arrays import Array
from aerial_gym.sim2real.findings import Finding
from aerial_gym.sim2real.logs.flight_spans import SHORTEST_S, FlightSpan, flight_spans
from aerial_gym.sim2real.logs.identity import log_identity
from aerial_gym.sim2real.logs.raw_log import QUANTITIES, SETPOINTS, LogChannel, RawLog, Topic
from aerial_gym.sim2real.logs.readers.binary_log import flight_of_streams, streams_of_log
from aerial_gym.sim2real.logs.readers.csv_log import read_csv_log
from aerial_gym.sim2real.logs.readers.log_readers import read_raw_log
from aerial_gym.sim2real.logs.readers.mapping import LogMapping, find_mapping
from aerial_gym.sim2real.logs.recording import (
    FlightLog,
    longest_bridgeable_gap,
    sample_rate,
    split_flight_number,
    take_rows,
)
from aerial_gym.sim2real.logs.row_grid import without_slow_rotor_data
from aerial_gym.sim2real.logs.streams import Stream, without_incomplete_rotor_data


@dataclass(frozen=True, kw_only=True)
class LogFlights:
    """A log of any format with its flights."""

    raw: RawLog
    streams: Mapping[str, Stream]
    spans: Sequence[FlightSpan]  # Of the flights in order
    notes: Sequence[Finding]
    mapping: LogMapping | None = None
    hover: bool = False  # Whether only rotor states at hover are needed
    partial: bool = False  # Whether flights may lack what comparisons need
    rows: FlightLog | None = None  # All rows of a CSV file; None for binary logs, whose streams have own rates
    chosen: int | None = None  # Number of the flight that ``FILE#2`` selects, from 1

    @property
    def numbers(self) -> Sequence[int]:
        """Numbers of the selected flights, from 1."""
        return range(1, len(self.spans) + 1) if self.chosen is None else (self.chosen,)

    def flight_path(self, number: int) -> str:
        """Return the path of a flight, with its number if there are several or one is selected."""
        return self.raw.path if len(self.spans) == 1 and self.chosen is None else f"{self.raw.path}#{number}"

    def flight(self, number: int, *, fastest: float = inf) -> FlightLog:
        """Return a flight; ``fastest``: largest rate of the rows of a binary log [Hz].

        Raise ``DataError`` if a needed quantity is missing.
        """
        span, path = self.spans[number - 1], self.flight_path(number)
        if self.rows is not None:
            inside = (self.rows.time >= span.start) & (self.rows.time <= span.end)
            log = replace(self.rows if inside.all() else take_rows(self.rows, inside), path=path)
        else:
            notes = [note for note in self.notes if span.start <= note.values.get("time_s", span.start) <= span.end]
            relative = self.mapping is None or self.mapping.rotor_command is None
            log = flight_of_streams(
                self.streams, span, path, notes, relative=relative, hover=self.hover, partial=self.partial,
                fastest=fastest,
            )  # fmt: skip
            asked = {name: (one.time, one.values) for name, one in self.streams.items() if name in SETPOINTS}
            log = replace(
                log, setpoints=asked, parameters=self.raw.parameters_in_force(span.start), log_format=self.raw.format,
                identity=log_identity(self.raw, float(log.time[0])),
            )  # fmt: skip
        return log if self.mapping is None else _with_mapping(log, self.mapping)

    def select(self, number: int | None) -> "LogFlights":
        """Return the log with one selected flight, or all for None; raise ``DataError`` if there is no such flight."""
        if number is not None and not 1 <= number <= len(self.spans):
            raise DataError(f"{self.raw.path}#{number}: the file holds {len(self.spans)} flights, numbered from 1")
        return replace(self, chosen=number)

    def flights(self) -> Iterator[FlightLog]:
        """Yield the selected flights."""
        return (self.flight(number) for number in self.numbers)

    def single_flight(self) -> FlightLog:
        """Return the selected flight; raise ``DataError`` if there are several."""
        if len(self.numbers) == 1:
            return self.flight(self.numbers[0])
        spans = zip(self.numbers, self.spans, strict=True)
        listed = ", ".join(f"{self.flight_path(n)} ({one.start:.1f} to {one.end:.1f} s)" for n, one in spans)
        raise DataError(f"{self.raw.path}: holds {len(self.spans)} flights; give one of them: {listed}")


def open_log(
    path: str | Path, mapping: LogMapping | None = None, *, hover: bool = False, partial: bool = False
) -> LogFlights:
    """Return a log of any format, known by its content, with its flights.

    Args:
        path: The file; ``FILE#2`` selects its second flight.
        mapping: Layout; None takes that of this package for CSV, and of the format itself for binary logs.
        hover: Whether only hover rotor states are needed: a missing attitude counts as level in CSV files, and neither
            gyro nor accelerometer is required.
        partial: Whether flights may lack rotors and inertial sensors, as for a plot.

    Raise ``DataError`` if file, columns or fields are unusable, or if there is no such flight.
    """
    file, chosen = split_flight_number(path)
    raw = read_raw_log(Path(file))
    opened = _open_csv(file, mapping, hover, partial) if raw is None else open_raw_log(raw, mapping, hover=hover)
    return replace(opened, partial=partial).select(chosen)


def open_raw_log(raw: RawLog, mapping: LogMapping | None = None, *, hover: bool = False) -> LogFlights:
    """Return the flights of a decoded binary log; raise ``DataError`` if it holds none."""
    streams, notes = streams_of_log(raw, mapping)
    streams = streams if hover else without_incomplete_rotor_data(streams, notes)
    spans = flight_spans(streams, notes)
    if not spans:
        raise DataError(f"{raw.path}: holds no flight of {SHORTEST_S:g} s without a gap in its topics")
    return LogFlights(raw=raw, streams=streams, spans=spans, notes=notes, mapping=mapping, hover=hover)


def _open_csv(file: str, mapping: LogMapping | None, hover: bool, partial: bool) -> LogFlights:
    """Return the flights of a CSV file; without any of ``SHORTEST_S`` all rows are one."""
    table = read_csv_log(Path(file), mapping or find_mapping("aerial_gym"), hover=hover, partial=partial)
    rows, notes = table.rows, list(table.rows.notes)
    values = {name: getattr(rows, name, None) for name in QUANTITIES} | table.states
    streams = {name: _stream_of_rows(name, rows.time, one) for name, one in values.items() if one is not None}
    spans = [] if table.is_converted else flight_spans(streams, notes)
    spans = spans or [FlightSpan(start=float(rows.time[0]), end=float(rows.time[-1]), ended_by="log_end")]
    if not table.states:
        notes += _finding_on_short_parts(rows.time, spans)
    raw = RawLog(path=file, format="csv", topics=(Topic(name="table", time=rows.time, columns={}),))
    rates = dict.fromkeys(("rotor_speed", "rotor_command"), sample_rate(rows))
    rates |= {name: timing.rate for name, timing in rows.streams.items()}
    rows = without_slow_rotor_data(replace(rows, notes=tuple(notes)), rates)
    return LogFlights(raw=raw, streams=streams, spans=spans, notes=(), mapping=mapping, rows=rows)


def _stream_of_rows(quantity: str, time: Array, values: Array) -> Stream:
    table = values.reshape(time.size, -1)
    channel = LogChannel(quantity=quantity, time=time, values=table, source="table[0]")
    return Stream(channel=channel, time=time, values=table)


def _finding_on_short_parts(time: Array, spans: Sequence[FlightSpan]) -> list[Finding]:
    """Return the finding on rows between gaps that are too few for a flight; empty without any."""
    steps = np.diff(time)
    part = np.concatenate(([0], np.cumsum(steps > longest_bridgeable_gap(float(np.median(steps))))))
    flown = np.unique(part[np.searchsorted(time, [span.start for span in spans])])
    lost = ~np.isin(part, flown)
    return [Finding("rows_cut", "", {"rows": int(lost.sum()), "gap_s": float(steps.max())})] if lost.any() else []


def _with_mapping(log: FlightLog, layout: LogMapping) -> FlightLog:
    """Return a log with the facts on its flight that a mapping declares."""
    notes = list(log.notes)
    if layout.lacks:
        notes.append(Finding("mapping_note", "", {"text": layout.lacks}))
    scaled = layout.rotor_command
    of_share = scaled is not None and scaled.columns == ("rotor_command",) and scaled.times is scaled.over is None
    return replace(
        log,
        command_curve=(scaled.offset, scaled.gain, scaled.power)
        if scaled is not None and of_share
        else log.command_curve,
        lift_off=layout.lift_off_m,
        hover_above=layout.hover_above_m,
        torques=log.torques and layout.torques,
        wind=_wind_of_mapping(Path(log.path), layout, notes),
        notes=tuple(notes),
    )


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


def read_flights(
    paths: Sequence[str | Path], *, mapping: LogMapping | None = None, hover: bool = False
) -> list[FlightLog]:
    """Return all flights of logs, of ``FILE#2`` only that one."""
    return [flight for path in paths for flight in open_log(path, mapping, hover=hover).flights()]


def read_flight_log(path: str | Path, *, mapping: LogMapping | None = None, hover: bool = False) -> FlightLog:
    """Return the only or selected flight of a log; arguments and errors as for ``open_log``.

    Raise ``DataError`` if the file holds several flights and the path selects none.
    """
    return open_log(path, mapping, hover=hover).single_flight()
