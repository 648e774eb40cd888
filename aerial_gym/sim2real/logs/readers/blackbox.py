"""Read blackbox logs of Betaflight and of INDIFLIGHT, its research branch. Letters: T samples, R rotors, B bytes.

One file holds the flights between two erasures, each with its own header; all of them become one log.
Betaflight's body axes are forward, left, up. INDIFLIGHT's quaternion, position and velocity are in NED and FRD.

Source: Betaflight documentation, *Blackbox Internals*; units: ``blackbox.c`` of Betaflight 4.5 and of INDIFLIGHT
(github tudelft/indiflight), function ``loadMainState``.
"""

import re
import struct
from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from math import radians
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from aerial_gym.errors import DataError
from aerial_gym.sim2real.arrays import Array
from aerial_gym.sim2real.findings import Finding
from aerial_gym.sim2real.logs.raw_log import LazyColumns, LogChannel, LogMessage, RawLog, Topic
from aerial_gym.sim2real.logs.readers.frames import attitude_from_ned_frd, enu_from_ned
from aerial_gym.sim2real.logs.readers.integration import integrate_attitude
from aerial_gym.sim2real.logs.readers.kernels import blackbox_frames as frames
from aerial_gym.sim2real.logs.readers.log_readers import LogReader
from aerial_gym.sim2real.logs.readers.mapping import UNIT_G, UNITS

MARK = b"H Product:Blackbox flight data recorder"  # First line of each flight
HEADER_LINE = re.compile(rb"H ([^:\n\0]{1,100}):([^\n\0]{0,16384})\n")
MOST_FLIGHTS, MOST_FIELDS = 1000, 1000  # Betaflight logs up to some 100 flights of some 50 fields, INDIFLIGHT of 200
MOST_GROWTH, FREE_BYTES = 24, 2**27  # A file may grow to so many times its size when decoded, and to 128 MB at least
BREAK_S = 10.0  # Time between two flights if the clock started anew between them
TIME = 1  # Place of the time among the main fields

INDIFLIGHT_UNIT = 8127.0  # Logged value of 1 in INDIFLIGHT's quaternions. Source: UNIT_FLOAT_TO_SIGNED16VB
INDIFLIGHT_GYRO = {
    "1a30175ae": 16.384
}  # Gyro counts per deg/s of builds that deviate. Source: tudelft/inertiaEstimation
COMPONENTS = {name: [f"{name}[{i}]" for i in range(size)] for name, size in (("quat", 4), ("pos", 3), ("vel", 3))}
EVENTS = {
    0: "arming beep",
    13: "adjustment of setting {0} to {1}",
    14: "logging resumed at iteration {0}",
    15: "disarmed, reason {0}",
    30: "flight modes {1} to {0}",
    255: "end of the log",
}
"""Texts of events by code. Source: Betaflight, ``blackbox_fielddefs.h``."""


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
    main: NDArray[np.int32]  # Main frames, (T, fields)
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
        flights = [_decode_flight(data, header, str(path)) for header in _read_headers(data, str(path))]
        flights = [flight for flight in flights if flight.main.shape[0] > 1]
        if not flights:
            raise DataError(f"{path}: holds no flight: no frame of the blackbox could be decoded")
        times = _flight_times(flights)
        topics = [_main_topic(flights, times)]
        for kind, name in ((frames.SLOW, "slow"), (frames.GPS, "gps")):
            topics += _other_topic(flights, times, kind, name)
        entries = flights[-1].header.entries
        damaged, lost = (sum(getattr(flight, name) for flight in flights) for name in ("damaged", "lost"))
        note = Finding("frames_damaged", "", {"damaged": damaged, "lost": lost, "total": topics[0].time.size + lost})
        return RawLog(
            path=str(path),
            format=self.name,
            topics=tuple(topics),
            parameters={k: _number_or_text(v) for k, v in entries.items() if not k.startswith("Field ")},
            messages=tuple(_event_messages(flights, times)),
            metadata={
                k: v for k, v in entries.items() if k[:1].isupper() and " " in k and not k.startswith("Field ") and v
            },
            notes=(note,) if damaged + lost else (),
        )

    def channels(self, log: RawLog) -> Sequence[LogChannel]:
        """Return the quantities of the vehicle; the attitude of Betaflight is integrated from the gyro."""
        main = log.topics[0]
        known = main.columns.keys()
        high_resolution = 10.0 if log.parameters.get("blackbox_high_resolution") == 1.0 else 1.0
        gyro_unit = radians(_gyro_scale(log)) / _indiflight_gyro(log, high_resolution)

        def vector(quantity: str, names: Sequence[str], unit: float) -> list[LogChannel]:
            name = next((n for n in names if f"{n}[2]" in known), None)
            if name is None:
                return []
            values = unit * _stack(main, [f"{name}[{i}]" for i in range(3)])
            return [LogChannel(quantity=quantity, time=main.time, values=values, source=main.source)]

        unit = UNIT_G / float(log.parameters.get("acc_1G") or 2048.0)
        results = [
            *vector("ang_vel", ("gyroADCafterRpm", "gyroUnfilt", "gyroADC"), gyro_unit),
            *vector("specific_force", ("accADCafterRpm", "accSmooth", "accADC"), unit),
            *_estimates(main),
            *_rotors(log, main),
        ]
        gyro = next((one for one in results if one.quantity == "ang_vel"), None)
        if gyro is not None and not any(one.quantity == "attitude" for one in results):
            results.append(integrate_attitude(gyro))
        return results


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

    from aerial_gym.interop.streams import start_warp

    counts, tables = _definitions(header, path)
    piece = data[header.start : header.stop]
    letters = np.bincount(piece, minlength=256)[list(frames.LETTERS.encode())]
    main_rows, other_rows = int(letters[:2].sum()) + 1, int(letters[2:].sum()) + 1
    width = tables.shape[2]
    if 4 * width * (main_rows + other_rows) > MOST_GROWTH * piece.size + FREE_BYTES:
        raise DataError(
            f"{path}: is no log of a flight: {piece.size} bytes would hold {main_rows} rows of {width} fields"
        )
    kinds = np.full(256, -1, dtype=np.int32)
    for kind, letter in enumerate(frames.LETTERS):
        if counts[kind] or kind == frames.EVENT:
            kinds[ord(letter)] = kind
    main, other = np.empty((main_rows, width), dtype=np.int32), np.empty((other_rows, width + 5), dtype=np.int32)
    result = np.zeros(4, dtype=np.int32)
    start_warp()
    inputs = (
        *(piece, np.array([0, piece.size], dtype=np.int32), kinds, counts, *tables, _constants(header)),
        *(np.zeros(width + 8, dtype=np.int32), np.zeros(2, dtype=np.int32), main, other, result),
    )
    arrays = [wp.array(one, dtype=wp.dtype_from_numpy(one.dtype), device="cpu", copy=False) for one in inputs]
    wp.launch(frames.decode_frames, dim=1, inputs=arrays, device="cpu")
    return BlackboxFlight(
        header=header,
        main=main[: result[frames.MAIN_ROWS]],
        other=other[: result[frames.OTHER_ROWS]],
        damaged=int(result[frames.DAMAGED]),
        lost=int(result[frames.LOST]),
    )


def _definitions(header: BlackboxHeader, path: str) -> tuple[NDArray[np.int32], NDArray[np.int32]]:
    """Return the numbers of fields by kind, (K,), and the encodings, predictors and signs of the fields, (3, K, F)."""
    letters = frames.LETTERS[:-1]
    names = [header.names(letter) for letter in letters]
    if names[0][: TIME + 1] != ["loopIteration", "time"]:
        raise DataError(
            f"{path}: its header names no fields loopIteration and time; the file is damaged at its beginning"
        )
    width = max(len(one) for one in names)
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
    return np.array([len(one) for one in names] + [3], dtype=np.int32), tables


def _constants(header: BlackboxHeader) -> NDArray[np.int32]:
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


def _flight_times(flights: Sequence[BlackboxFlight]) -> list[float]:
    """Return the shift of each flight's clock [s], so that a clock that started anew follows the flight before."""
    shifts, end = list[float](), -np.inf
    for flight in flights:
        stamps = _microseconds(flight.main[:, TIME]) * 1e-6
        shift = 0.0 if stamps[0] >= end else end + BREAK_S - float(stamps[0])
        shifts.append(shift)
        end = float(stamps[-1]) + shift
    return shifts


def _microseconds(column: NDArray[np.int32]) -> Array:
    """Return unsigned counts of 32 bits, without the wraps of the counter."""
    counts = column.view(np.uint32).astype(np.float64) if column.flags.c_contiguous else column.astype(np.uint32) * 1.0
    return counts + 2.0**32 * np.cumsum(np.diff(counts, prepend=counts[:1]) < -(2.0**31))


def _main_topic(flights: Sequence[BlackboxFlight], shifts: Sequence[float]) -> Topic:
    time = [1e-6 * _microseconds(one.main[:, TIME]) + shift for one, shift in zip(flights, shifts, strict=True)]
    tables = [(one.header, one.main, "I", 0) for one in flights]
    return Topic(name="main", time=np.concatenate(time), columns=_columns(tables), units={"time": "us"})


def _other_topic(flights: Sequence[BlackboxFlight], shifts: Sequence[float], kind: int, name: str) -> list[Topic]:
    """Return the topic of a rare kind of frame; none if there is no such frame."""
    letter = frames.LETTERS[kind]
    tables = [(one.header, one.other[one.other[:, 0] == kind], letter, 2) for one in flights]
    time = [1e-6 * _microseconds(t[:, 1]) + shift for (_, t, _, _), shift in zip(tables, shifts, strict=True)]
    stamps = np.concatenate(time)
    return [Topic(name=name, time=stamps, columns=_columns(tables))] if stamps.size else []


def _columns(tables: Sequence[tuple[BlackboxHeader, NDArray[np.int32], str, int]]) -> LazyColumns:
    """Return the columns of all flights by field name, NaN where a flight lacks the field."""
    names = dict.fromkeys(name for header, _, letter, _ in tables for name in header.names(letter))
    return LazyColumns({name: partial(_column, tables, name) for name in names})


def _column(tables: Sequence[tuple[BlackboxHeader, NDArray[np.int32], str, int]], name: str) -> Array:
    parts = []
    for header, table, letter, first in tables:
        names = header.names(letter)
        if name not in names:
            parts.append(np.full(table.shape[0], np.nan))
            continue
        place = names.index(name)
        values = table[:, first + place]
        signs = header.numbers(f"Field {letter} signed")
        parts.append((values if signs[place] else values.astype(np.uint32)).astype(np.float64))
    return np.concatenate(parts)


def _event_messages(flights: Sequence[BlackboxFlight], shifts: Sequence[float]) -> list[LogMessage]:
    return [
        LogMessage(time=1e-6 * (stamp & 0xFFFFFFFF) + shift, level="info", text=EVENTS[code].format(first, second))
        for flight, shift in zip(flights, shifts, strict=True)
        for kind, stamp, code, first, second in flight.other[:, :5].tolist()
        if kind == frames.EVENT and code in EVENTS
    ]


def _number_or_text(text: str) -> float | str:
    try:
        return float(text)
    except ValueError:
        return text


def _gyro_scale(log: RawLog) -> float:
    """Return the unit of the gyro [deg/s]; logs before Cleanflight 1.x, which state rad/us, are refused by its size."""
    text = str(log.parameters.get("gyro_scale", ""))
    try:
        scale = struct.unpack(">f", int(text, 16).to_bytes(4, "big"))[0]
    except (ValueError, OverflowError):
        return 1.0
    return scale if 1e-3 < scale < 1e3 else 1.0


def _indiflight_gyro(log: RawLog, usual: float) -> float:
    revision = str(log.parameters.get("Firmware revision", ""))
    return next((scale for build, scale in INDIFLIGHT_GYRO.items() if build in revision), usual)


def _stack(topic: Topic, names: Sequence[str]) -> Array:
    return np.stack([topic.columns[name] for name in names], axis=1)


def _column_names(topic: Topic, name: str) -> list[str]:
    """Return the columns ``name[0]``, ``name[1]``, ... of a topic."""
    return [f"{name}[{i}]" for i in range(32) if f"{name}[{i}]" in topic.columns]


def _estimates(main: Topic) -> list[LogChannel]:
    """Return INDIFLIGHT's attitude, position and velocity."""
    rows = (
        ("attitude", "quat", attitude_from_ned_frd, 1.0 / INDIFLIGHT_UNIT),
        ("position", "pos", enu_from_ned, UNITS["mm"]),
        ("lin_vel", "vel", enu_from_ned, UNITS["cm/s"]),
    )
    return [
        LogChannel(
            quantity=quantity, time=main.time, values=convert(unit * _stack(main, COMPONENTS[name])), source=main.source
        )
        for quantity, name, convert, unit in rows
        if set(COMPONENTS[name]) <= main.columns.keys()
    ]


def _rotors(log: RawLog, main: Topic) -> list[LogChannel]:
    """Return rotor speeds, commands and the battery voltage."""
    results = list[LogChannel]()

    def append(quantity: str, values: Array) -> None:
        used = np.nanmax(values, axis=0, initial=0.0) > 0.0
        if used.any():
            results.append(LogChannel(quantity=quantity, time=main.time, values=values[:, used], source=main.source))

    erpm = 100.0 * UNITS["rpm"] / (float(log.parameters.get("motor_poles") or 14.0) / 2.0)
    for name, unit in (("omegaUnfiltered", 1.0), ("eRPM", erpm), ("erpm", erpm)):
        if columns := _column_names(main, name):
            append("rotor_speed", unit * _stack(main, columns))
    if columns := _column_names(main, "motor"):
        low, high = _motor_range(log)
        append("rotor_command", np.clip((_stack(main, columns) - low) / (high - low), 0.0, 1.0))
    if "vbatLatest" in main.columns:
        append("battery", _volt_unit(log) * _stack(main, ["vbatLatest"]))
    return results


def _motor_range(log: RawLog) -> tuple[float, float]:
    """Return the motor values of idle and of full throttle."""
    low, high = (
        float(log.parameters.get(name, value)) for name, value in (("minthrottle", 1000.0), ("maxthrottle", 2000.0))
    )
    parts = str(log.parameters.get("motorOutput", "")).split(",")
    if len(parts) == 2 and all(part.isdigit() for part in parts):
        low, high = map(float, parts)
    return low, high if high > low else low + 1.0


def _volt_unit(log: RawLog) -> float:
    """Return the unit of the battery voltage [V]: 0.1 before Betaflight 4."""
    return 0.1 if re.match(r"Betaflight [0-3]\.", str(log.parameters.get("Firmware revision", ""))) else 0.01
