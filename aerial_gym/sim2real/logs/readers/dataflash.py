"""Read ArduPilot DataFlash logs (.bin). World is NED, body is FRD, angles are in degrees. Letters: T samples, R rotors.

Source: ArduPilot, ``libraries/AP_Logger/README.md`` and ``LogStructure.h`` for formats, units and multipliers; *Onboard Message
Log Messages* of its documentation for fields; ``AP_Logger.h``, ``LogEvent``, for events; ``SRV_Channel.h`` for motor outputs.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from aerial_gym.errors import DataError
from aerial_gym.sim2real.arrays import Array, Indices
from aerial_gym.sim2real.findings import Finding
from aerial_gym.sim2real.logs.raw_log import (
    LOWEST_BATTERY_V,
    LazyColumns,
    LogChannel,
    LogMessage,
    RawLog,
    Topic,
    faster_first,
    note_on_rotor_order,
    read_records,
)
from aerial_gym.sim2real.logs.readers.frames import quantity_from_ned_frd
from aerial_gym.sim2real.logs.readers.log_readers import LogReader
from aerial_gym.sim2real.logs.readers.mapping import UNITS

HEAD = b"\xa3\x95"  # First bytes of each message, before its type
FMT, FMT_LENGTH = 128, 89  # Type and length of the messages that define the others
TYPES: dict[str, tuple[str, float]] = {
    **dict.fromkeys("BM", ("u1", 1.0)),
    **{"b": ("i1", 1.0), "h": ("<i2", 1.0), "H": ("<u2", 1.0), "i": ("<i4", 1.0), "I": ("<u4", 1.0)},
    **{"q": ("<i8", 1.0), "Q": ("<u8", 1.0), "g": ("<f2", 1.0), "f": ("<f4", 1.0), "d": ("<f8", 1.0)},
    **{"c": ("<i2", 0.01), "C": ("<u2", 0.01), "e": ("<i4", 0.01), "E": ("<u4", 0.01)},
    **{"L": ("<i4", 1e-7), "a": ("(32,)<i2", 1.0), "n": ("S4", 0.0), "N": ("S16", 0.0), "Z": ("S64", 0.0)},
}
"""NumPy type and unit of each format character; 0 for text."""

TIMES = {"TimeUS": 1e-6, "TimeMS": 1e-3}  # Fields of the time and their units [s]
INSTANCES = ("I", "Instance", "Inst", "C")  # Fields that number several sources of one message, if no unit marks them
SMALLEST_DAMAGE = 256  # A log cut by power loss ends within a message, whose length is at most 255 bytes
ARMED, DISARMED, LANDED_MAYBE, LANDED, FLYING = 10, 11, 17, 18, 28  # Codes of EV messages
MOTOR_FUNCTIONS = (*range(33, 41), *range(82, 86))  # SERVOn_FUNCTION of motors 1 to 12
METRES_PER_DEG = 111_319.5  # Length of a degree of the equator. Source: WGS 84, 6378137 m pi / 180

VECTORS = (
    ("ang_vel", ("IMU", "GYR"), ("GyrX", "GyrY", "GyrZ"), 1.0),
    ("ang_vel", ("RATE",), ("R", "P", "Y"), UNITS["deg/s"]),
    ("specific_force", ("IMU", "ACC"), ("AccX", "AccY", "AccZ"), 1.0),
    ("position", ("XKF1", "NKF1", "EKF1"), ("PN", "PE", "PD"), 1.0),
    ("lin_vel", ("XKF1", "NKF1", "EKF1"), ("VN", "VE", "VD"), 1.0),
    ("attitude", ("ATT", "XKF1", "NKF1", "EKF1"), ("Roll", "Pitch", "Yaw"), UNITS["deg/s"]),
    ("attitude", ("XKQ", "XKQ1", "NKQ1"), ("Q1", "Q2", "Q3", "Q4"), 1.0),
)
"""Quantity, messages from the best to the worst, fields, and unit."""


@dataclass(frozen=True, kw_only=True)
class MessageType:
    """Definition of one type of message."""

    name: str
    length: int  # [B], with the head
    format: str  # One character per field
    fields: tuple[str, ...]

    @property
    def columns(self) -> list[tuple[str, str]]:
        """Name and format character of each field."""
        return list(zip(self.fields, self.format, strict=False))

    @property
    def record(self) -> np.dtype[Any]:
        """Return the NumPy type of the fields, named by their place; raise ``KeyError`` for an unknown character."""
        return np.dtype([(str(i), TYPES[code][0]) for i, code in enumerate(self.format)])


class DataflashReader(LogReader):
    """Reader of ArduPilot logs."""

    name = "dataflash"
    summary = "DataFlash of ArduPilot"

    def recognises(self, head: bytes) -> bool:
        """Return whether the file begins with the head of a message."""
        return head.startswith(HEAD)

    def read(self, path: Path) -> RawLog:
        """Return all messages with a time as topics, and the parameters and texts."""
        data = np.fromfile(path, dtype=np.uint8)
        types = _message_types(data)
        tables, used = _split_messages(data, types)
        if not any(types[number].name in ("IMU", "ATT", "RATE", "GYR") for number in tables):
            raise DataError(f"{path}: holds no messages IMU, ATT, RATE or GYR of ArduPilot; log them (LOG_BITMASK)")
        named = {types[number].name: (types[number], table) for number, table in tables.items()}
        units = _field_units(types, named)
        texts = [(_seconds(*named["MSG"])[i], text) for i, text in enumerate(_text(named, "MSG", "Message"))]
        lost = data.size - used
        return RawLog(
            path=str(path),
            format=self.name,
            topics=tuple(
                topic for one, table in named.values() for topic in _topics(one, table, units.get(one.name, {}))
            ),
            parameters=_parameters(named),
            messages=tuple(LogMessage(time=float(time), level="info", text=text) for time, text in texts),
            metadata={"firmware": texts[0][1]} if texts else {},
            notes=(Finding("bytes_left_out", "", {"bytes": lost, "total": data.size}),)
            if lost >= SMALLEST_DAMAGE
            else (),
        )

    def channels(self, log: RawLog) -> Sequence[LogChannel]:
        """Return the quantities of the vehicle; of several sources a much faster one comes first."""
        vectors = [
            _vector_channel(topic, quantity, fields, unit)
            for quantity, names, fields, unit in VECTORS
            for name in names
            for topic in log.find_topics(name, *fields)
        ]
        return [
            *faster_first(vectors),
            *_gps_channels(log),
            *_rotor_channels(log),
            *_batteries(log),
            *_flight_states(log),
        ]


def _message_types(data: NDArray[np.uint8]) -> dict[int, MessageType]:
    """Return the types that FMT messages define, by number. The first definition of a type counts."""
    places = _head_places(data)
    places = places[data[places + 2] == FMT]
    results: dict[int, MessageType] = {}
    for place in places[places + FMT_LENGTH <= data.size].tolist():
        row = data[place + 3 : place + FMT_LENGTH].tobytes()
        name, codes, fields = (part.rstrip(b"\0").decode("latin-1") for part in (row[2:6], row[6:22], row[22:]))
        one = MessageType(name=name, length=row[1], format=codes, fields=tuple(fields.split(",")))
        known = name.isalnum() and codes and set(codes) <= TYPES.keys() and len(one.fields) >= len(codes)
        if known and one.record.itemsize + 3 == one.length:
            results.setdefault(row[0], one)
    return results


def _head_places(data: NDArray[np.uint8]) -> Indices:
    """Return the places of heads that a type follows."""
    places = np.flatnonzero(data[:-2] == HEAD[0])
    return places[data[places + 1] == HEAD[1]]


def _split_messages(data: NDArray[np.uint8], types: dict[int, MessageType]) -> tuple[dict[int, NDArray[Any]], int]:
    """Return the messages as one table for each type, and the number of bytes in them.

    A message counts if another one, or the end of the file, follows it; data that look like a head are inside of messages.
    """
    lengths = np.zeros(256, dtype=np.int64)
    lengths[list(types)] = [one.length for one in types.values()]
    places = _head_places(data)
    places = places[lengths[data[places + 2]] > 0]
    numbers = data[places + 2]
    ends = places + lengths[numbers]
    following = np.searchsorted(places, ends)
    whole = (ends == data.size) | (np.append(places, -1)[following] == ends)
    steps = np.where(whole, following, np.arange(1, places.size + 1))
    kept = _chain(steps) & whole
    tables = {
        number: read_records(data, places[kept & (numbers == number)] + 3, types[number].record)
        for number in np.unique(numbers[kept]).tolist()
    }
    return tables, int((ends - places)[kept].sum())


def _chain(steps: Indices) -> NDArray[np.bool_]:
    """Return the places that are visited from place 0 on, where each states the next one."""
    visited = np.zeros(steps.size, dtype=bool)
    if np.array_equal(steps, np.arange(1, steps.size + 1)):
        return ~visited
    places, following, place = [], steps.tolist(), 0
    while place < steps.size:
        places.append(place)
        place = following[place]
    visited[places] = True
    return visited


def _numbers(one: MessageType, table: NDArray[Any], field: str) -> Array:
    """Return the numbers of a field; raise ``ValueError`` if the message has no such field of numbers."""
    place = next((i for i, (name, code) in enumerate(one.columns) if name == field and TYPES[code][1] != 0.0), None)
    if place is None or one.format[place] == "a":
        raise ValueError(f"no numbers {field}")
    values = table[str(place)].astype(np.float64)
    unit = TYPES[one.format[place]][1]
    return values if unit == 1.0 else values * unit


def _text(named: dict[str, tuple[MessageType, NDArray[Any]]], name: str, field: str) -> list[str]:
    """Return the texts of a field; empty without such a message or text field."""
    one, table = named.get(name, (None, None))
    if one is None or table is None or field not in one.fields[: len(one.format)]:
        return []
    column = table[str(one.fields.index(field))]
    return [text.decode("latin-1") for text in column.tolist()] if column.dtype.kind == "S" else []


def _seconds(one: MessageType, table: NDArray[Any]) -> Array:
    """Return the times [s]; zeros for a message without time."""
    field = next((name for name in TIMES if name in one.fields[: len(one.format)]), None)
    if field is None:
        return np.zeros(table.size)
    values = table[str(one.fields.index(field))]
    return values.astype(np.float64) * TIMES[field] if values.dtype.kind in "uif" else np.zeros(table.size)


def _parameters(named: dict[str, tuple[MessageType, NDArray[Any]]]) -> dict[str, float | str]:
    """Return the last value of each parameter."""
    try:
        values = _numbers(*named["PARM"], "Value").tolist()
    except (KeyError, ValueError):
        return {}
    return dict(zip(_text(named, "PARM", "Name"), values, strict=False))


def _field_units(
    types: dict[int, MessageType], named: dict[str, tuple[MessageType, NDArray[Any]]]
) -> dict[str, dict[str, str]]:
    """Return the unit of each field by message and field, from the messages FMTU, UNIT and MULT."""
    try:
        units = dict(zip(_numbers(*named["UNIT"], "Id").tolist(), _text(named, "UNIT", "Label"), strict=True))
        factors = dict(
            zip(_numbers(*named["MULT"], "Id").tolist(), _numbers(*named["MULT"], "Mult").tolist(), strict=True)
        )
        texts = (_text(named, "FMTU", field) for field in ("UnitIds", "MultIds"))
        rows = zip(_numbers(*named["FMTU"], "FmtType").tolist(), *texts, strict=False)
    except (KeyError, ValueError):
        return {}
    results: dict[str, dict[str, str]] = {}
    for number, unit_ids, factor_ids in rows:
        if (one := types.get(int(number))) is None:
            continue
        for field, code, unit, factor in zip(one.fields, one.format, unit_ids, factor_ids, strict=False):
            scale = factors.get(float(ord(factor)), 0.0) if TYPES[code][1] == 1.0 else 1.0
            label = "#" if unit == "#" else units.get(float(ord(unit)), "")
            results.setdefault(one.name, {})[field] = (
                label if scale in (0.0, 1.0) or not label else f"{scale:g} {label}"
            )
    return results


def _topics(one: MessageType, table: NDArray[Any], units: dict[str, str]) -> Iterator[Topic]:
    """Yield the numeric fields of a message with a time, one topic for each instance."""
    if not set(TIMES) & set(one.fields) or not table.size:
        return
    pairs = one.columns
    counted = [field for field, code in pairs if code in "bB"]
    marked = [field for field in counted if units.get(field) == "#"] or [
        field for field in counted if field in INSTANCES and one.name != "CMD"
    ]
    keys = _numbers(one, table, marked[0]).astype(int) if marked else np.zeros(table.size, dtype=int)
    digits = one.name.lstrip("ABCDEFGHIJKLMNOPQRSTUVWXYZ")
    for key in np.unique(keys).tolist():
        rows = table if not keys.any() else table[keys == key]
        columns: dict[str, Any] = {}
        for place, (field, code) in enumerate(pairs):
            if code == "a":
                columns |= {f"{field}[{i}]": partial(_array_column, rows, place, i) for i in range(32)}
            elif TYPES[code][1] != 0.0:
                columns[field] = partial(_numbers, one, rows, field)
        old = marked == [] and one.name[:-1] in ("IMU", "ACC", "GYR", "GPS", "BAT", "ESC") and digits.isdigit()
        number = int(digits) - 1 if old else key  # before Copter 4.1 instances had names, such as IMU2
        name = one.name[:-1] if old else one.name
        yield Topic(name=name, instance=number, time=_seconds(one, rows), columns=LazyColumns(columns), units=units)


def _array_column(rows: NDArray[Any], place: int, index: int) -> Array:
    return rows[str(place)][:, index].astype(np.float64)


def _vector_channel(topic: Topic, quantity: str, fields: Sequence[str], unit: float) -> LogChannel:
    """Return a channel in this package's frames, on the sampling times if they are logged."""
    values = topic.numbers(*fields, unit=unit)
    if len(fields) == 3 and quantity == "attitude":  # roll, pitch, yaw
        turned = Rotation.from_euler("ZYX", np.nan_to_num(values[:, ::-1])).as_quat()
        values = np.where(np.isfinite(values).all(axis=1)[:, None], turned, np.nan)[:, [3, 0, 1, 2]]
    channel = topic.channel(quantity, quantity_from_ned_frd(quantity, values))
    return replace(channel, time=1e-6 * topic.columns["SampleUS"]) if "SampleUS" in topic.columns else channel


def _gps_channels(log: RawLog) -> Iterator[LogChannel]:
    """Yield position, from the first fix, and velocity of the GPS."""
    fields = ("Lat", "Lng", "Alt", "Spd", "GCrs", "VZ")
    for topic in log.find_topics("GPS", "Status", *fields):
        fix = topic.columns["Status"] >= 3.0  # three-dimensional
        if not fix.any():
            continue
        lat, lng, alt, speed, course, down = topic.numbers(*fields)[fix].T
        east = METRES_PER_DEG * np.cos(np.radians(lat[0])) * (lng - lng[0])
        position = np.stack((east, METRES_PER_DEG * (lat - lat[0]), alt - alt[0]), axis=1)
        heading = np.radians(course)
        velocity = np.stack((speed * np.sin(heading), speed * np.cos(heading), -down), axis=1)
        for quantity, values in (("position", position), ("lin_vel", velocity)):
            yield LogChannel(quantity=quantity, time=topic.time[fix], values=values, source=topic.source)


def _motor_outputs(log: RawLog) -> list[int]:
    """Return the output number of each motor, from 1, by ``SERVOn_FUNCTION``; the first outputs without such parameters."""
    outputs = {
        MOTOR_FUNCTIONS.index(int(value)): n
        for n in range(1, 33)
        if isinstance(value := log.parameters.get(f"SERVO{n}_FUNCTION"), float) and value in MOTOR_FUNCTIONS
    }
    count = {2.0: 6, 3.0: 8, 4.0: 8, 5.0: 6}.get(log.number("FRAME_CLASS", 1.0), 4)
    return [outputs[motor] for motor in sorted(outputs)] or list(range(1, count + 1))


def _rotor_channels(log: RawLog) -> Iterator[LogChannel]:
    """Yield rotor speeds by ESC telemetry, and motor signals from 0 to 1, in the order of motors."""
    note, outputs = note_on_rotor_order("ArduPilot"), _motor_outputs(log)
    escs = {topic.instance: topic for topic in log.find_topics("ESC", "RPM")}
    used = [escs[n - 1] for n in outputs if n - 1 in escs]
    if used and len(used) == len(outputs):
        time = max(used, key=lambda topic: topic.time.size).time
        speeds = [np.interp(time, *_time_order(topic.time, np.abs(topic.columns["RPM"]))) for topic in used]
        values = UNITS["rpm"] * np.stack(speeds, axis=1)
        yield LogChannel(quantity="rotor_speed", time=time, values=values, source=used[0].source, notes=note)
    low, high = (
        log.number(f"MOT_PWM_{end}", 0.0) or log.number(f"RC3_{end}", 0.0) or default
        for end, default in (("MIN", 1000.0), ("MAX", 2000.0))
    )
    fields = [f"C{n}" for n in outputs]
    for topic in log.find_topics("RCOU", *fields) if high > low else ():
        values = np.clip((topic.numbers(*fields) - low) / (high - low), 0.0, 1.0)
        yield topic.channel("rotor_command", values, note)


def _time_order(time: Array, values: Array) -> tuple[Array, Array]:
    """Return the samples in order of time, each time once."""
    times, places = np.unique(time, return_index=True)
    return times, values[places]


def _batteries(log: RawLog) -> Iterator[LogChannel]:
    """Yield the voltages that are measured."""
    for name, field in (("BAT", "Volt"), ("CURR", "Volt"), ("MOTB", "BatVolt")):
        for topic in log.find_topics(name, field):
            if np.median(topic.columns[field]) > LOWEST_BATTERY_V:
                yield topic.channel("battery", topic.numbers(field))


def _flight_states(log: RawLog) -> Iterator[LogChannel]:
    """Yield arming and contact with the ground; before the first event the state is the opposite one."""
    start = min(float(topic.time[0]) for topic in log.topics)
    for topic in log.find_topics("EV", "Id"):
        codes = topic.columns["Id"]
        for quantity, on, off in (("armed", (ARMED,), (DISARMED,)), ("landed", (LANDED_MAYBE, LANDED), (FLYING,))):
            rows = np.isin(codes, (*on, *off))
            if rows.any():
                states = np.isin(codes[rows], on).astype(float)
                time = np.append(min(start, topic.time[rows][0]), topic.time[rows])
                values = np.append(1.0 - states[0], states)[:, None]
                yield replace(topic.channel(quantity, values), time=time)
