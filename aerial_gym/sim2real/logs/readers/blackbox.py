"""Read blackbox logs of Betaflight and of INDIFLIGHT, its research branch. Letters: T samples, K kinds of frames, F fields.

One file holds the flights between two erasures, each with its own header; all of them become one log.
Betaflight's body axes are forward, left, up. INDIFLIGHT's quaternion, position and velocity are in NED and FRD.

Source: Betaflight documentation, *Blackbox Internals*; units: ``blackbox.c`` of Betaflight 4.5 and of INDIFLIGHT
(github tudelft/indiflight), function ``loadMainState``.
"""

import re
import struct
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import partial
from math import pi, radians, sqrt
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from aerial_gym.errors import DataError
from aerial_gym.sim2real.arrays import Array
from aerial_gym.sim2real.findings import Finding
from aerial_gym.sim2real.logs import raw_log
from aerial_gym.sim2real.logs.raw_log import LazyColumns, LogChannel, LogMessage, RawLog, Topic
from aerial_gym.sim2real.logs.readers.kernels import blackbox_frames as frames
from aerial_gym.sim2real.logs.readers.log_readers import LogReader
from aerial_gym.sim2real.logs.readers.mapping import UNIT_G, UNITS, quantity_from_ned_frd

MARK = b"H Product:Blackbox flight data recorder"  # First line of each flight
HEADER_LINE = re.compile(rb"H ([^:\n\0]{1,100}):([^\n\0]{0,16384})\n")
MOST_FLIGHTS, MOST_FIELDS = 500, 1000  # Betaflight logs up to some 100 flights of some 50 fields, INDIFLIGHT of 200
BREAK_S = 10.0  # Time between two flights if the clock started anew between them

INDIFLIGHT_UNIT = 8127.0  # Logged value of 1 in INDIFLIGHT's quaternions. Source: UNIT_FLOAT_TO_SIGNED16VB
INDIFLIGHT_GYRO = {"1a30175ae": 16.384}  # Gyro counts per deg/s of odd builds. Source: tudelft/inertiaEstimation
INDIFLIGHT_ESTIMATES = (
    ("attitude", [f"quat[{i}]" for i in range(4)], 1.0 / INDIFLIGHT_UNIT),
    ("position", [f"pos[{i}]" for i in range(3)], UNITS["mm"]),
    ("lin_vel", [f"vel[{i}]" for i in range(3)], UNITS["cm/s"]),
)
"""Quantity, fields and unit of INDIFLIGHT's estimates."""

VOLT_UNITS = {r"Betaflight (4|\d{4})\.|INAV|Indiflight": 0.01, r"Betaflight 3\.[1-9]|Cleanflight 2\.": 0.1}
"""Unit of the voltage [V] by firmware. Source: Betaflight blackbox viewer, ``flightlog.js``, function vbatADCToMillivolts."""

EVENTS = {
    0: "arming beep",
    13: "adjustment of setting {0} to {1}",
    14: "logging resumed at iteration {0}",
    15: "disarmed, reason {0}",
    30: "flight modes {1} to {0}",
    255: "end of the log",
}
"""Texts of events by code. Source: Betaflight, ``blackbox_fielddefs.h``."""

Numbers = NDArray[np.integer]


@dataclass(frozen=True, kw_only=True)
class BlackboxHeader:
    """Header of one flight."""

    entries: dict[str, str]
    start: int  # First byte of the frames
    stop: int  # First byte of the next flight, or the end of the file

    def numbers(self, key: str) -> list[int]:
        """Return the numbers of an entry, such as the encodings of a frame; empty if it is missing or no list of numbers."""
        try:
            return [int(text) for text in self.entries.get(key, "").split(",")]
        except ValueError:
            return []

    def names(self, letter: str) -> list[str]:
        """Return the field names of a kind of frame; those of I are those of P."""
        line = self.entries.get(f"Field {'I' if letter == 'P' else letter} name", "")
        return line.split(",") if line else []


@dataclass(frozen=True, kw_only=True)
class BlackboxFlight:
    """Decoded frames of one flight."""

    header: BlackboxHeader
    main: dict[str, Numbers]  # Fields of the main frames by name, each (T,)
    other: NDArray[np.int32]  # Kind, time [us] and values of each other frame
    damaged: int  # Number of damaged frames
    lost: int  # Number of frames that depend on a damaged one, or whose time does not fit


class BlackboxReader(LogReader):
    """Reader of blackbox logs."""

    name = "blackbox"
    summary = "blackbox of Betaflight and INDIFLIGHT"

    def recognises(self, head: bytes) -> bool:
        """Return whether the file begins with a blackbox header."""
        return MARK in head

    def read(self, path: Path) -> RawLog:
        """Return the frames, header entries and events of all flights."""
        data = np.fromfile(path, dtype=np.uint8)
        headers = [header for header in _read_headers(data, str(path)) if header.stop > header.start]
        flights = [_decode_flight(data, header, str(path)) for header in headers]
        flights = [flight for flight in flights if flight.main["time"].size > 1]
        if not flights:
            raise DataError(f"{path}: holds no flight: no frame of the blackbox could be decoded")
        times = _clock_shifts_of_flights(flights)
        topics = [_topic_of_main_frames(flights, times)]
        topics += [
            _topic_of_rare_frames(flights, times, *kind) for kind in ((frames.SLOW, "slow"), (frames.GPS, "gps"))
        ]
        entries = [{k: v for k, v in one.header.entries.items() if not k.startswith("Field ")} for one in flights]
        starts = topics[0].time[np.cumsum([0, *(one.main["time"].size for one in flights[:-1])])].tolist()
        records = [(at, k, _number_or_text(v)) for at, one in zip(starts, entries, strict=True) for k, v in one.items()]
        first = {k: _number_or_text(v) for k, v in entries[0].items()}
        parameters, changes = raw_log.apply_parameter_records(records, first)
        damaged, lost = (sum(getattr(flight, name) for flight in flights) for name in ("damaged", "lost"))
        note = Finding("frames_damaged", "", {"damaged": damaged, "lost": lost, "total": topics[0].time.size + lost})
        return RawLog(
            path=str(path),
            format=self.name,
            topics=tuple(topic for topic in topics if topic.time.size),
            parameters=parameters,
            parameter_changes=changes,
            messages=tuple(_event_messages(flights, times)),
            metadata={k: v for k, v in entries[-1].items() if k[:1].isupper() and " " in k and v},
            notes=(note,) if damaged + lost else (),
        )

    def channels(self, log: RawLog) -> Sequence[LogChannel]:
        """Return the quantities of the vehicle; Betaflight before 2025.12 logs no attitude."""
        main = log.topics[0]
        known = main.columns.keys()

        def vector(quantity: str, names: Sequence[str], unit: float | None = None) -> list[LogChannel]:
            name = next((n for n in names if {f"{n}[{i}]" for i in range(3)} <= known), None)
            if name is None:
                return []
            values = main.numbers(*(f"{name}[{i}]" for i in range(3)), unit=unit or _radians_per_gyro_count(log, name))
            return [main.channel(quantity, values)]

        unit = UNIT_G / (log.number("acc_1G", 0.0) or 2048.0)
        forces = vector("specific_force", ("accADCafterRpm",), unit)
        turns = vector("attitude", ("imuQuaternion",), 1.0 / 0x7FFF)  # FLU to a world with z up, less w >= 0
        return [
            *(replace(q, values=np.c_[q.values, np.sqrt(1.0 - np.sum(q.values**2, 1).clip(0, 1))]) for q in turns),
            *vector("ang_vel", ("gyroADCafterRpm", "gyroUnfilt", "gyroADC")),
            *(forces or _before_filter(log, vector("specific_force", ("accSmooth", "accADC"), unit))),
            *(
                main.channel(quantity, quantity_from_ned_frd(quantity, main.numbers(*fields, unit=unit)))
                for quantity, fields, unit in INDIFLIGHT_ESTIMATES
                if set(fields) <= known
            ),
            *_rotor_and_battery_channels(log, main),
        ]


def _read_headers(data: NDArray[np.uint8], path: str) -> list[BlackboxHeader]:
    """Return the headers of all flights."""
    starts = [match.start() for match in re.finditer(re.escape(MARK), data.data)]
    if len(starts) > MOST_FLIGHTS:
        raise DataError(f"{path}: holds {len(starts)} flights, at most {MOST_FLIGHTS} are read; cut the file")
    results = []
    for start, stop in zip(starts, [*starts[1:], data.size], strict=True):
        entries, place = dict[str, str](), start
        while match := HEADER_LINE.match(data.data, place, stop):
            entries[match[1].decode("latin-1")] = match[2].decode("latin-1").strip()
            place = match.end()
        results.append(BlackboxHeader(entries=entries, start=place, stop=stop))
    return results


def _decode_flight(data: NDArray[np.uint8], header: BlackboxHeader, path: str) -> BlackboxFlight:
    """Return the frames of a flight; raise ``DataError`` if its header is unusable or they would fill the memory."""
    import warp as wp

    from aerial_gym.interop.warp_start import start_warp

    counts, tables = _field_definitions(header, path)
    piece = data[header.start : header.stop]
    letters = np.bincount(piece, minlength=256)[list(frames.LETTERS.encode())]
    main_rows, other_rows = int(letters[:2].sum()) + 1, int(letters[2:].sum()) + 1
    width = tables.shape[2]
    if 4 * width * (main_rows + other_rows) > raw_log.MOST_GROWTH * piece.size + raw_log.FREE_BYTES:
        raise DataError(
            f"{path}: is no log of a flight: {piece.size} bytes would hold {main_rows} rows of {width} fields"
        )
    kinds = np.full(256, -1, dtype=np.int32)
    for kind, letter in enumerate(frames.LETTERS):
        if counts[kind] or kind == frames.EVENT:
            kinds[ord(letter)] = kind
    main, other = np.empty((width, main_rows), dtype=np.int32), np.empty((other_rows, width + 5), dtype=np.int32)
    result = np.zeros(4, dtype=np.int32)
    start_warp()
    inputs = (
        *(piece, np.array([0, piece.size], dtype=np.int32), kinds, counts, *tables, _predictor_constants(header)),
        *(np.zeros(width + 8, dtype=np.int32), np.zeros(2, dtype=np.int32), main, other, result),
    )
    arrays = [wp.array(one, dtype=wp.dtype_from_numpy(one.dtype), device="cpu", copy=False) for one in inputs]
    wp.launch(frames.decode_frames, dim=1, inputs=arrays, device="cpu")
    return BlackboxFlight(
        header=header,
        main={
            name: _narrow_column(column[: result[frames.MAIN_ROWS]], sign == 1)
            for name, column, sign in zip(header.names("I"), main, tables[2, frames.INTRA], strict=False)
        },
        other=other[: result[frames.OTHER_ROWS]],
        damaged=int(result[frames.DAMAGED]),
        lost=int(result[frames.LOST]),
    )


def _field_definitions(header: BlackboxHeader, path: str) -> tuple[NDArray[np.int32], NDArray[np.int32]]:
    """Return the numbers of fields by kind, (K,), and the encodings, predictors and signs of the fields, (3, K, F)."""
    letters = frames.LETTERS[:-1]
    names = [header.names(letter) for letter in letters]
    if names[0][:2] != ["loopIteration", "time"]:
        raise DataError(
            f"{path}: its header names no fields loopIteration and time; the file is damaged at its beginning"
        )
    width = max(map(len, names))
    if width > MOST_FIELDS:
        raise DataError(f"{path}: its header names {width} fields, at most {MOST_FIELDS} are read")
    tables = np.zeros((3, len(letters), width), dtype=np.int32)
    for kind, letter in enumerate(letters):
        signs = header.numbers(f"Field {'I' if letter == 'P' else letter} signed")
        rows = (header.numbers(f"Field {letter} encoding"), header.numbers(f"Field {letter} predictor"), signs)
        for table, row, entry in zip(tables, rows, ("encoding", "predictor", "signed"), strict=True):
            if len(row) < len(names[kind]) or any(not -(2**31) <= value < 2**31 for value in row):
                raise DataError(
                    f"{path}: its header lacks the {entry} of a field of frames {letter}; the file is damaged"
                )
            table[kind, : len(names[kind])] = row[: len(names[kind])]
        for field, name in enumerate(names[kind]):
            if tables[1, kind, field] == frames.HOME_COORDINATE and name.endswith("[1]"):
                tables[1, kind, field] = frames.HOME_LONGITUDE
    if unknown := set(tables[0].ravel().tolist()) - set(frames.ENCODINGS):
        raise DataError(f"{path}: a field has the unknown encoding {min(unknown)}; known are {frames.ENCODINGS}")
    if header.entries.get("Data version") == "1" and np.any(tables[0] == frames.FOUR):
        raise DataError(f"{path}: has version 1 of the data, of 2014, whose encoding 8 differs; only version 2 is read")
    return np.array([len(one) for one in names] + [3], dtype=np.int32), tables


def _predictor_constants(header: BlackboxHeader) -> NDArray[np.int32]:
    """Return the header entries that predictors need."""

    def first(key: str, default: int) -> int:
        return min(max([*header.numbers(key), default][0], -(2**30)), 2**30)

    low = first("minthrottle", 1150)
    interval = max(first("I interval", 32), 1)
    ratio = re.fullmatch(r"(\d{1,6})/(\d{1,6})", header.entries.get("P interval", ""))
    num, denom = (int(ratio[1]), int(ratio[2])) if ratio else (1, first("P interval", 1))
    names = header.names("I")
    motor = names.index("motor[0]") if "motor[0]" in names else 0
    return np.array(
        [low, first("vbatref", 4095), first("motorOutput", low), motor, min(interval, 10_000), num, max(denom, 1)],
        dtype=np.int32,
    )


def _clock_shifts_of_flights(flights: Sequence[BlackboxFlight]) -> list[float]:
    """Return the shift of each flight's clock [s], so that a clock that started anew follows the flight before."""
    shifts, end = list[float](), -np.inf
    for flight in flights:
        stamps = _seconds_of_wrapped_stamps(flight.main["time"])
        shift = 0.0 if stamps[0] >= end else end + BREAK_S - float(stamps[0])
        shifts.append(shift)
        end = float(stamps[-1]) + shift
    return shifts


def _narrow_column(values: NDArray[np.int32], has_sign: bool) -> Numbers:
    """Return a copy of a column with its own sign, in 16 bits if they are enough, which most fields are."""
    numbers = values if has_sign else values.view(np.uint32)
    small = np.int16 if has_sign else np.uint16
    fits = numbers.size and np.iinfo(small).min <= numbers.min() and numbers.max() <= np.iinfo(small).max
    return numbers.astype(small if fits else numbers.dtype)


def _seconds_of_wrapped_stamps(stamps: Numbers) -> Array:
    """Return the times [s] of counts of microseconds in 32 bits, without the wraps of the counter."""
    counts = stamps.astype(np.uint32).astype(np.float64)
    return 1e-6 * (counts + 2.0**32 * np.cumsum(np.diff(counts, prepend=counts[:1]) < -(2.0**31)))


def _topic_of_main_frames(flights: Sequence[BlackboxFlight], shifts: Sequence[float]) -> Topic:
    time = [_seconds_of_wrapped_stamps(one.main["time"]) + shift for one, shift in zip(flights, shifts, strict=True)]
    columns = _columns_of_all_flights([one.main for one in flights], [one.size for one in time])
    return Topic(name="main", time=np.concatenate(time), columns=columns, units={"time": "us"})


def _topic_of_rare_frames(flights: Sequence[BlackboxFlight], shifts: Sequence[float], kind: int, name: str) -> Topic:
    """Return the topic of a rare kind of frame."""
    tables, time = list[dict[str, Numbers]](), list[Array]()
    for flight, shift in zip(flights, shifts, strict=True):
        rows, letter = flight.other[flight.other[:, 0] == kind], frames.LETTERS[kind]
        signs, columns = flight.header.numbers(f"Field {letter} signed"), np.ascontiguousarray(rows[:, 2:].T)
        fields = zip(flight.header.names(letter), columns, signs, strict=False)
        tables.append({name: _narrow_column(column, sign == 1) for name, column, sign in fields})
        time.append(_seconds_of_wrapped_stamps(rows[:, 1]) + shift)
    sizes = [one.size for one in time]
    return Topic(name=name, time=np.concatenate(time), columns=_columns_of_all_flights(tables, sizes))


def _columns_of_all_flights(tables: Sequence[dict[str, Numbers]], sizes: Sequence[int]) -> LazyColumns:
    """Return the columns of all flights by field name, NaN where a flight lacks the field."""

    def column(name: str) -> Array:
        parts = [table.get(name, np.full(size, np.nan)) for table, size in zip(tables, sizes, strict=True)]
        return np.concatenate(parts, dtype=np.float64)

    return LazyColumns({name: partial(column, name) for table in tables for name in table})


def _event_messages(flights: Sequence[BlackboxFlight], shifts: Sequence[float]) -> list[LogMessage]:
    return [
        LogMessage(time=1e-6 * (stamp & 0xFFFFFFFF) + shift, level="info", text=EVENTS[code].format(first, second))
        for flight, shift in zip(flights, shifts, strict=True)
        for kind, stamp, code, first, second in flight.other[:, :5].tolist()
        if kind == frames.EVENT and code in EVENTS
    ]


def _number_or_text(text: str) -> float | str:
    with suppress(ValueError):
        return float(text)
    return text


def _radians_per_gyro_count(log: RawLog, name: str) -> float:
    """Return the unit of a gyro's columns [rad/s] from the scale in the header, deg/s, and the resolution."""
    keys = ("Firmware revision", "gyro_scale", "gyro.scale")
    revision, text, old = (str(log.parameters.get(key, "")) for key in keys)
    usual = 10.0 if log.parameters.get("blackbox_high_resolution") == 1.0 or "Indiflight" in revision else 1.0
    builds = INDIFLIGHT_GYRO.items() if name == "gyroADC" else ()
    counts = next((scale for build, scale in builds if build in revision), usual)
    hexadecimal = re.fullmatch(r"0x([0-9a-fA-F]{8})", text or old)
    scale = struct.unpack(">f", bytes.fromhex(hexadecimal[1]))[0] if hexadecimal else 1.0
    if log.parameters.get("Firmware type") == "Baseflight" and 0.0 < scale < 1.0:  # radians per microsecond
        return 1e6 * scale
    return radians(scale if 1e-3 < scale < 1e3 else 1.0) / counts


def _before_filter(log: RawLog, forces: Sequence[LogChannel]) -> list[LogChannel]:
    """Return the accelerometer's channels with the time before the firmware's low-pass, which the header states [0.01 Hz].

    A Butterworth filter of order 2 delays slow signals by ``sqrt(2) / (2 pi f)``. Later versions have two filters of order 1
    in its place, with 9 % less. Source: Betaflight, ``acceleration_init.c`` and ``blackbox.c``.
    """
    cutoff = 0.01 * log.number("acc_lpf_hz", 0.0)
    delay = sqrt(2.0) / (2.0 * pi * cutoff) if cutoff > 0.0 else 0.0
    return [replace(one, time=one.time - delay, latency=delay) for one in forces] if delay else list(forces)


def _column_names(topic: Topic, name: str) -> list[str]:
    """Return the columns ``name[0]``, ``name[1]``, ... of a topic."""
    return [f"{name}[{i}]" for i in range(32) if f"{name}[{i}]" in topic.columns]


def _rotor_and_battery_channels(log: RawLog, main: Topic) -> list[LogChannel]:
    """Return rotor speeds, commands and the battery voltage."""
    results = list[LogChannel]()

    def append(quantity: str, values: Array) -> None:
        used = np.nanmax(values, axis=0, initial=0.0) > 0.0
        if used.any():
            results.append(main.channel(quantity, values[:, used]))

    erpm = 100.0 * UNITS["rpm"] / ((log.number("motor_poles", 0.0) or 14.0) / 2.0)
    for name, unit in (("omegaUnfiltered", 1.0), ("eRPM", erpm), ("erpm", erpm)):
        if columns := _column_names(main, name):
            append("rotor_speed", main.numbers(*columns, unit=unit))
    if columns := _column_names(main, "motor"):
        low, high = _motor_values_at_idle_and_full(log)
        append("rotor_command", np.clip((main.numbers(*columns) - low) / (high - low), 0.0, 1.0))
    for name in {"vbatLatest", "vbat"} & main.columns.keys():  # the latter in iNav
        append("battery", main.numbers(name, unit=_volts_per_battery_count(log)))
    return results


def _motor_values_at_idle_and_full(log: RawLog) -> tuple[float, float]:
    """Return the motor values of idle and of full throttle."""
    ends = re.fullmatch(r"(\d+),(\d+)", str(log.parameters.get("motorOutput", "")))
    low, high = map(float, ends.groups()) if ends else (log.number("minthrottle", 1e3), log.number("maxthrottle", 2e3))
    return low, high if high > low else low + 1.0


def _volts_per_battery_count(log: RawLog) -> float:
    """Return the unit of the battery voltage [V]; 0 for older and for unknown firmwares, which log counts of a converter."""
    name = str(log.parameters.get("Firmware revision", ""))
    return next((unit for pattern, unit in VOLT_UNITS.items() if re.match(pattern, name)), 0.0)
