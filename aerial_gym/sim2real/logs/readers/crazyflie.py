"""Read logs of the Crazyflie's micro-SD card. World is z up, body is FLU, as in this package. Letters: T samples.

Source: Bitcraze documentation, *Micro SD card deck*, for the format, and *Log groups and variables* for units;
*The coordinate system of the Crazyflie* for frames and rotors.
"""

import struct
import zlib
from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from aerial_gym.errors import DataError
from aerial_gym.sim2real.arrays import Array
from aerial_gym.sim2real.findings import Finding
from aerial_gym.sim2real.logs.raw_log import LazyColumns, LogChannel, RawLog, Topic, read_records
from aerial_gym.sim2real.logs.readers.log_readers import LogReader
from aerial_gym.sim2real.logs.readers.mapping import UNIT_G, UNITS

MAGIC = 0xBC
STAMPS = {1: ("<u4", 1e-3), 2: ("<u8", 1e-6)}  # NumPy type and unit [s] of the time by version
CHECKSUM_BYTES = 4
NUMBERS = dict(
    zip("bBhHiIqQefd", ["i1", "u1", "<i2", "<u2", "<i4", "<u4", "<i8", "<u8", "<f2", "<f4", "<f8"], strict=True)
)
ARMED, FLYING = 2, 16  # Bits of ``supervisor.info``
FULL_THROTTLE = 65535.0  # Motor command of full thrust

VECTORS = (
    ("attitude", "stateEstimate.", ("qx", "qy", "qz", "qw"), 1.0),
    ("attitude", "kalman.", ("q1", "q2", "q3", "q0"), 1.0),
    ("attitude", "stateEstimateZ.", ("quat",), 1.0),
    ("attitude", "stateEstimate.", ("roll", "pitch", "yaw"), 1.0),
    ("attitude", "stabilizer.", ("roll", "pitch", "yaw"), 1.0),
    ("position", "stateEstimate.", ("x", "y", "z"), 1.0),
    ("position", "kalman.", ("stateX", "stateY", "stateZ"), 1.0),
    ("position", "stateEstimateZ.", ("x", "y", "z"), UNITS["mm"]),
    ("lin_vel", "stateEstimate.", ("vx", "vy", "vz"), 1.0),
    ("lin_vel", "stateEstimateZ.", ("vx", "vy", "vz"), UNITS["mm/s"]),
    ("ang_vel", "gyro.", ("x", "y", "z"), UNITS["deg/s"]),
    ("specific_force", "acc.", ("x", "y", "z"), UNIT_G),
    ("rotor_speed", "rpm.", ("m1", "m2", "m3", "m4"), UNITS["rpm"]),
    ("rotor_command", "motor.", ("m1", "m2", "m3", "m4"), 1.0 / FULL_THROTTLE),
    ("rotor_command", "pwm.", ("m1_pwm", "m2_pwm", "m3_pwm", "m4_pwm"), 1.0 / FULL_THROTTLE),
    ("battery", "pm.", ("vbat",), 1.0),
    ("armed", "sys.", ("armed",), 1.0),
)
"""Quantity, log group, variables and unit, from the best to the worst source."""


class CrazyflieReader(LogReader):
    """Reader of micro-SD logs."""

    name = "crazyflie"
    summary = "micro-SD card of the Crazyflie"

    def recognises(self, head: bytes) -> bool:
        """Return whether the file begins with the mark, a known version and the definition of an event."""
        if len(head) < 9 or head[0] != MAGIC or int.from_bytes(head[1:3], "little") not in STAMPS:
            return False
        return head[7:8].isalnum()

    def read(self, path: Path) -> RawLog:
        """Return one topic for each kind of event."""
        data = path.read_bytes()
        version = int.from_bytes(data[1:3], "little")
        try:
            events, start = _event_types(data, version)
        except (IndexError, ValueError, KeyError, struct.error):
            raise DataError(f"{path}: the definitions of its events are damaged; read the card again") from None
        places, end = _event_places(data, start, {number: record.itemsize for number, (_, record) in events.items()})
        unit, last, notes = STAMPS[version][1], len(data) - CHECKSUM_BYTES, list[Finding]()
        topics = [_topic_of_events(data, *events[number], starts, unit) for number, starts in places.items() if starts]
        if not topics:
            raise DataError(f"{path}: holds no event, only definitions")
        if end < last:
            notes.append(Finding("bytes_left_out", "", {"bytes": last - end, "total": len(data)}))
        elif zlib.crc32(data[:last]) != int.from_bytes(data[last:], "little"):
            notes.append(Finding("checksum_wrong"))
        return RawLog(path=str(path), format=self.name, topics=tuple(topics), notes=tuple(notes))

    def channels(self, log: RawLog) -> Sequence[LogChannel]:
        """Return the quantities of the vehicle; rotor 1 is front right, and the others follow clockwise."""
        channels = list[LogChannel]()
        for quantity, group, names, unit in VECTORS:
            variables = [group + name for name in names]
            for topic in (one for one in log.topics if set(variables) <= one.columns.keys()):
                values = topic.numbers(*variables, unit=unit)
                if quantity == "attitude":
                    values = {1: _decompress_quaternions, 3: _quaternions_of_angles}.get(len(names), np.array)(values)
                channels.append(topic.channel(quantity, values))
        for topic in (one for one in log.topics if "supervisor.info" in one.columns):
            bits = topic.columns["supervisor.info"].astype(int)[:, None]
            channels.append(topic.channel("armed", (bits & ARMED != 0).astype(float)))
            channels.append(topic.channel("landed", (bits & FLYING == 0).astype(float)))
        return channels


def _event_types(data: bytes, version: int) -> tuple[dict[int, tuple[str, np.dtype[Any]]], int]:
    """Return name and NumPy record of each kind of event by number, and the place of the first event."""
    results, place = {}, 5
    for _ in range(int.from_bytes(data[3:5], "little")):
        number, end = struct.unpack_from("<H", data, place)[0], data.index(b"\0", place + 2)
        name = data[place + 2 : end].decode("latin-1")
        (count,), place = struct.unpack_from("<H", data, end + 1), end + 3
        fields = [("id", "<u2"), ("time", STAMPS[version][0])]
        for _ in range(count):
            end = data.index(b"\0", place)
            variable, kind = data[place:end].decode("latin-1").rsplit("(", 1)
            fields.append((variable, NUMBERS[kind.rstrip(")")]))
            place = end + 1
        results[number] = (name, np.dtype(fields))
    return results, place


def _event_places(data: bytes, start: int, sizes: dict[int, int]) -> tuple[dict[int, list[int]], int]:
    """Return the places of events by number, and the first place behind them; an unknown event ends the search."""
    places: dict[int, list[int]] = {number: [] for number in sizes}
    place, last = start, len(data) - CHECKSUM_BYTES
    while place + 2 <= last:
        number = data[place] | data[place + 1] << 8
        size = sizes.get(number)
        if size is None or place + size > last:
            break
        places[number].append(place)
        place += size
    return places, place


def _topic_of_events(data: bytes, name: str, record: np.dtype[Any], places: Sequence[int], unit: float) -> Topic:
    """Return the events of one kind as a topic."""
    table = read_records(np.frombuffer(data, dtype=np.uint8), np.array(places), record)
    columns = {variable: partial(np.asarray, table[variable], np.float64) for variable in (record.names or ())[2:]}
    return Topic(name=name, time=unit * table["time"].astype(np.float64), columns=LazyColumns(columns))


def _quaternions_of_angles(angles: Array) -> Array:
    """Return quaternions, xyzw, of roll, pitch and yaw [deg]; the firmware counts nose up as positive pitch."""
    return Rotation.from_euler("ZYX", np.nan_to_num(angles[:, ::-1]) * (1.0, -1.0, 1.0), degrees=True).as_quat()


def _decompress_quaternions(numbers: Array) -> Array:
    """Return quaternions, xyzw, of 2 bits for the place of the largest component and 10 bits for each other one.

    Source: crazyflie-firmware, ``quatcompress.h``.
    """
    bits = numbers[:, 0].astype(np.uint32)
    largest, values = bits >> 30, np.zeros((bits.size, 4))
    for component in (3, 2, 1, 0):
        stored = largest != component
        size = (bits & 511) / (511.0 * np.sqrt(2.0))
        values[:, component] = np.where(stored, np.where(bits >> 9 & 1, -size, size), 0.0)
        bits = np.where(stored, bits >> 10, bits)
    values[np.arange(bits.size), largest] = np.sqrt(1.0 - np.minimum(np.sum(values**2, axis=1), 1.0))
    return values
