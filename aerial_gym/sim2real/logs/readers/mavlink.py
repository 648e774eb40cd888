"""Read telemetry logs of MAVLink 1 and 2 (.tlog), as ground stations of ArduPilot and PX4 write them. Letters: T samples.

Each packet follows its time of reception: microseconds since 1970, in 8 bytes, big-endian. Topics have the vehicle's own
stamps where a message holds one, since the link delays packets. World is NED, body is FRD.

Source: MAVLink guide, *Packet Serialization* and *Parameter Protocol*; ``common.xml`` and ``ardupilotmega.xml`` for fields and
units; ArduPilot, ``GCS_Common.cpp``, ``send_raw_imu``, for units of RAW_IMU.
"""

import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from aerial_gym.errors import DataError
from aerial_gym.sim2real.arrays import Array, Indices
from aerial_gym.sim2real.findings import Finding
from aerial_gym.sim2real.logs.raw_log import (
    LogChannel,
    LogMessage,
    RawLog,
    Topic,
    apply_parameter_records,
    faster_first,
    note_on_rotor_order,
    whole_records_in_chain,
)
from aerial_gym.sim2real.logs.readers.dataflash import SMALLEST_DAMAGE, DataflashReader
from aerial_gym.sim2real.logs.readers.log_readers import LogReader
from aerial_gym.sim2real.logs.readers.mapping import UNIT_G, UNITS, quantity_from_ned_frd
from aerial_gym.sim2real.logs.readers.ulog import UlogReader
from aerial_gym.sim2real.logs.recording import FrameOrigin

VERSIONS = {0xFE: 6, 0xFD: 10}  # Length of the header by the first byte of a packet
STAMP, CHECKSUM, SIGNATURE = 8, 2, 13  # Lengths [B]
YEARS = range(3, 15)  # Second byte of stamps from 1997 to 2105; the first is 0
ARDUPILOT, PX4 = 3, 12  # ``autopilot`` of HEARTBEAT
ARMED_FLAG, ON_GROUND, IN_AIR = 128, 1, 2  # ``base_mode`` of HEARTBEAT and ``landed_state`` of EXTENDED_SYS_STATE
INT32 = 6  # ``param_type`` of an integer
RESTART_S, OTHER_CLOCK_S = (
    10.0,
    60.0,
)  # Step back of the vehicle's clock, and distance from the link's, that are another clock
LEVELS = ("error", "error", "error", "error", "warning", "info", "info", "debug")  # By ``severity`` of STATUSTEXT
FIRST_BYTES = re.compile(rb"\0[\x03-\x0e].{6}[\xfd\xfe]", re.DOTALL)

KINDS = {
    "u8": "u1",
    "i8": "i1",
    "char": "S1",
    "u16": "<u2",
    "i16": "<i2",
    "u32": "<u4",
    "i32": "<i4",
    "f": "<f4",
    "u64": "<u8",
}
SERVOS = [f"servo{n}_raw" for n in range(1, 17)]
MESSAGES = {
    0: "HEARTBEAT u8:type,autopilot,base_mode u32:custom_mode u8:system_status,mavlink_version",
    1: "SYS_STATUS u32:onboard_control_sensors_present,onboard_control_sensors_enabled,onboard_control_sensors_health "
    "u16:load,voltage_battery i16:current_battery i8:battery_remaining u16:drop_rate_comm,errors_comm,errors_count1,"
    "errors_count2,errors_count3,errors_count4",
    22: "PARAM_VALUE char:param_id[16] f:param_value u8:param_type u16:param_count,param_index",
    26: "SCALED_IMU u32:time_boot_ms i16:xacc,yacc,zacc,xgyro,ygyro,zgyro,xmag,ymag,zmag",
    27: "RAW_IMU u64:time_usec i16:xacc,yacc,zacc,xgyro,ygyro,zgyro,xmag,ymag,zmag",
    30: "ATTITUDE u32:time_boot_ms f:roll,pitch,yaw,rollspeed,pitchspeed,yawspeed",
    31: "ATTITUDE_QUATERNION u32:time_boot_ms f:q1,q2,q3,q4,rollspeed,pitchspeed,yawspeed",
    32: "LOCAL_POSITION_NED u32:time_boot_ms f:x,y,z,vx,vy,vz",
    36: f"SERVO_OUTPUT_RAW u32:time_usec u8:port u16:{','.join(SERVOS[:8])} | u16:{','.join(SERVOS[8:])}",
    83: "ATTITUDE_TARGET u32:time_boot_ms u8:type_mask f:q[4],body_roll_rate,body_pitch_rate,body_yaw_rate,thrust",
    85: "POSITION_TARGET_LOCAL_NED u32:time_boot_ms u8:coordinate_frame u16:type_mask "
    "f:x,y,z,vx,vy,vz,afx,afy,afz,yaw,yaw_rate",
    105: "HIGHRES_IMU u64:time_usec f:xacc,yacc,zacc,xgyro,ygyro,zgyro,xmag,ymag,zmag,abs_pressure,diff_pressure,pressure_alt,"
    "temperature u16:fields_updated | u8:id",
    245: "EXTENDED_SYS_STATE u8:vtol_state,landed_state",
    253: "STATUSTEXT u8:severity char:text[50]",
    291: "ESC_STATUS u8:index u64:time_usec i32:rpm[4] f:voltage[4],current[4]",
    11030: "ESC_TELEMETRY_1_TO_4 u8:temperature[4] u16:voltage[4],current[4],totalcurrent[4],rpm[4],count[4]",
    11031: "ESC_TELEMETRY_5_TO_8 u8:temperature[4] u16:voltage[4],current[4],totalcurrent[4],rpm[4],count[4]",
}
"""Name and fields of the messages that are read, in the order of their definition; those behind ``|`` are extensions."""

INSTANCES = {"SERVO_OUTPUT_RAW": "port", "HIGHRES_IMU": "id", "ESC_STATUS": "index"}  # Field that numbers the sources
CLOCKS = {"time_boot_ms": 1e-3, "time_usec": 1e-6}  # Fields of the vehicle's time and their units [s]
WRAP_S = 2**32 * 1e-6  # Period of SERVO_OUTPUT_RAW's stamps [s], which have 32 bits

GYRO, FORCE, TURNS = ("xgyro", "ygyro", "zgyro"), ("xacc", "yacc", "zacc"), ("rollspeed", "pitchspeed", "yawspeed")
VECTORS = (
    ("attitude", "ATTITUDE_QUATERNION", ("q1", "q2", "q3", "q4"), 1.0),
    ("attitude", "ATTITUDE", ("yaw", "pitch", "roll"), 1.0),
    ("position", "LOCAL_POSITION_NED", ("x", "y", "z"), 1.0),
    ("lin_vel", "LOCAL_POSITION_NED", ("vx", "vy", "vz"), 1.0),
    ("ang_vel", "HIGHRES_IMU", GYRO, 1.0),
    ("ang_vel", "RAW_IMU", GYRO, 1e-3),
    ("ang_vel", "SCALED_IMU", GYRO, 1e-3),
    ("ang_vel", "ATTITUDE_QUATERNION", TURNS, 1.0),
    ("ang_vel", "ATTITUDE", TURNS, 1.0),
    ("specific_force", "HIGHRES_IMU", FORCE, 1.0),
    ("specific_force", "RAW_IMU", FORCE, 1e-3 * UNIT_G),
    ("specific_force", "SCALED_IMU", FORCE, 1e-3 * UNIT_G),
)
"""Quantity, message, fields and unit, from the best to the worst source."""


@dataclass(frozen=True, kw_only=True)
class MavlinkMessage:
    """Definition of a message."""

    text: str  # As in ``MESSAGES``

    @property
    def name(self) -> str:
        """Name of the message."""
        return self.text.split(" ", 1)[0]

    @cached_property
    def record(self) -> np.dtype[Any]:
        """Return the NumPy type of the payload: larger numbers come first, extensions at the end."""
        parts = [self._fields(part) for part in self.text.partition(" ")[2].partition(" | ")[::2]]
        wire = [*sorted(parts[0], key=lambda field: -np.dtype(field[1]).itemsize), *parts[1]]
        return np.dtype([(name, kind, count) if count else (name, kind) for name, kind, count in wire])

    @staticmethod
    def _fields(text: str) -> list[tuple[str, str, int]]:
        groups = [group.partition(":")[::2] for group in text.split()]
        names = [(name, KINDS[kind]) for kind, listed in groups for name in listed.split(",")]
        return [(name.partition("[")[0], kind, int(name.partition("[")[2][:-1] or 0)) for name, kind in names]


@dataclass(frozen=True, kw_only=True)
class Packets:
    """Places of whole packets in a file, each array (T,)."""

    received: Array  # [s] since 1970
    number: Indices  # Of the message
    system: Indices  # Number of the sender
    start: Indices  # First byte of the payload
    length: Indices  # Of the payload [B]; MAVLink 2 leaves out zeros at the end
    bytes: int  # In all packets

    @classmethod
    def of_file(cls, data: NDArray[np.uint8]) -> "Packets":
        """Return the packets of a file; those are whole that another one, or the end of the file, follows."""
        padded = np.concatenate((data, np.zeros(STAMP + 10, dtype=np.uint8)))
        places = np.flatnonzero((data[:-STAMP] == 0) & (data[STAMP:] >= 0xFD) & (data[STAMP:] < 0xFF))
        places = places[(padded[places + 1] >= YEARS.start) & (padded[places + 1] < YEARS.stop)]
        head, two = places + STAMP, padded[places + STAMP] == 0xFD
        signed = two & (padded[head + 2] & 1 == 1)
        start = head + np.where(two, VERSIONS[0xFD], VERSIONS[0xFE])
        ends = start + padded[head + 1] + CHECKSUM + SIGNATURE * signed
        kept = whole_records_in_chain(places, ends, data.size)
        places, head, two, start, ends = (one[kept] for one in (places, head, two, start, ends))
        stamps = sum(padded[places + i].astype(np.float64) * 256.0 ** (7 - i) for i in range(8))
        long = padded[head + 7] + 256 * padded[head + 8].astype(np.int64) + 65536 * padded[head + 9].astype(np.int64)
        return cls(
            received=1e-6 * np.asarray(stamps, dtype=np.float64),
            number=np.where(two, long, padded[head + 5]),
            system=padded[head + np.where(two, 5, 3)].astype(np.int64),
            start=start,
            length=padded[head + 1].astype(np.int64),
            bytes=int((ends - places).sum()),
        )

    def payloads(self, data: NDArray[np.uint8], rows: Indices, record: np.dtype[Any]) -> NDArray[Any]:
        """Return the payloads of packets of one message, filled up with zeros."""
        table = np.zeros((rows.size, record.itemsize), dtype=np.uint8)
        for column in range(record.itemsize):
            inside = column < self.length[rows]
            table[inside, column] = data[self.start[rows[inside]] + column]
        return table.view(record)[:, 0]


class MavlinkReader(LogReader):
    """Reader of telemetry logs."""

    name = "mavlink"
    summary = "telemetry logs of MAVLink (.tlog)"

    def recognises(self, head: bytes) -> bool:
        """Return whether the file begins with a stamp and a packet, which another stamp and packet follow."""
        if not FIRST_BYTES.match(head):
            return False
        signed = head[STAMP] == 0xFD and head[STAMP + 2] & 1
        end = STAMP + VERSIONS[head[STAMP]] + head[STAMP + 1] + CHECKSUM + SIGNATURE * signed
        return len(head) <= end or FIRST_BYTES.match(head, end) is not None

    def read(self, path: Path) -> RawLog:
        """Return the messages in ``MESSAGES`` of the vehicle that sent most attitudes."""
        data = np.fromfile(path, dtype=np.uint8)
        packets = Packets.of_file(data) if data.size > STAMP else None
        attitudes = np.zeros(0, dtype=int) if packets is None else packets.system[np.isin(packets.number, (30, 31))]
        if packets is None or not attitudes.size:
            raise DataError(f"{path}: holds no message ATTITUDE of a vehicle; record its telemetry")
        own = packets.system == np.argmax(np.bincount(attitudes))
        tables = dict[str, tuple[Array, NDArray[Any]]]()
        for number in sorted(MESSAGES.keys() & set(packets.number[own].tolist())):
            message, rows = MavlinkMessage(text=MESSAGES[number]), np.flatnonzero(own & (packets.number == number))
            tables[message.name] = (packets.received[rows], packets.payloads(data, rows, message.record))
        clock = VehicleClock.of_tables(list(tables.values()))
        autopilot = int(np.median(tables["HEARTBEAT"][1]["autopilot"])) if "HEARTBEAT" in tables else ARDUPILOT
        parameters, changes = apply_parameter_records(_parameter_records(tables, clock, is_px4=autopilot == PX4), {})
        lost = data.size - packets.bytes
        return RawLog(
            path=str(path),
            format=self.name,
            topics=tuple(topic for name, table in tables.items() for topic in _topics(name, *table, clock)),
            parameters=parameters,
            parameter_changes=tuple(one for one in changes if one.before is not None),
            messages=tuple(_texts(*tables["STATUSTEXT"], clock)) if "STATUSTEXT" in tables else (),
            metadata={"autopilot": {ARDUPILOT: "ArduPilot", PX4: "PX4"}.get(autopilot, str(autopilot))},
            notes=(Finding("bytes_left_out", "", {"bytes": lost, "total": data.size}),) * (lost >= SMALLEST_DAMAGE),
        )

    def channels(self, log: RawLog) -> Sequence[LogChannel]:
        """Return the quantities of the vehicle; of several sources a much faster one comes first."""
        is_ardupilot = log.metadata.get("autopilot") == "ArduPilot"
        vectors = [
            _vector_channel(topic, quantity, fields, unit)
            for quantity, name, fields, unit in VECTORS
            if name != "RAW_IMU" or is_ardupilot  # others send counts of the sensor
            for topic in log.topic_instances(name, *fields)
        ]
        status = [
            replace(one, columns={"V": 1e-3 * one.columns["voltage_battery"]})
            for one in log.topic_instances("SYS_STATUS", "voltage_battery")
        ]
        return [
            *faster_first([replace(one, origin=FrameOrigin()) for one in vectors if np.ptp(one.values, axis=0).any()]),
            *_rotor_channels(log, DataflashReader() if is_ardupilot else UlogReader()),
            *(
                one.channel("battery", values)
                for one, values in replace(log, topics=tuple(status)).batteries("SYS_STATUS", "V")
            ),
            *_channels_of_arming_and_landing(log),
        ]


@dataclass(frozen=True, kw_only=True)
class VehicleClock:
    """The vehicle's clock since each start, relative to the time of reception; times count from the first start."""

    begins: Array  # Reception of the first packet after each start [s]
    offsets: Array  # Least delay behind the vehicle's own time [s]

    @classmethod
    def of_tables(cls, tables: Sequence[tuple[Array, NDArray[Any]]]) -> "VehicleClock":
        """Return the clock that messages with ``time_boot_ms`` show."""
        stamped = [table for table in tables if "time_boot_ms" in (table[1].dtype.names or ())]
        known = [(received, rows["time_boot_ms"] * 1e-3) for received, rows in stamped]
        received, own = (np.concatenate(part) for part in zip(*known, strict=True))
        order = np.argsort(received, kind="stable")
        received, own = received[order], own[order]
        first = np.concatenate(([0], np.flatnonzero(np.diff(own) < -RESTART_S) + 1))
        return cls(begins=received[first], offsets=np.minimum.reduceat(received - own, first))

    def times(self, received: Array, own: Array | None, wrap: float = 0.0) -> Array:
        """Return the times [s] of packets by their own stamps, or by reception if these are missing or of another clock."""
        offset = self.offsets[np.clip(np.searchsorted(self.begins, received, side="right") - 1, 0, None)]
        by_link = received - self.offsets[0]
        if own is None:
            return by_link
        own = own + wrap * np.round((received - offset - own) / wrap) if wrap else own
        stamps = own + (offset - self.offsets[0])
        return stamps if np.median(np.abs(stamps - by_link)) < OTHER_CLOCK_S else by_link


def _topics(name: str, received: Array, rows: NDArray[Any], clock: VehicleClock) -> Iterator[Topic]:
    """Yield the numbers of a message, one topic for each source."""
    fields = [field for field in rows.dtype.names or () if rows.dtype[field].base.kind != "S"]
    stamp = next((field for field in fields if field in CLOCKS), None)
    own = None if stamp is None else rows[stamp] * CLOCKS[stamp]
    time = clock.times(received, own, WRAP_S if name == "SERVO_OUTPUT_RAW" else 0.0)
    order = np.argsort(time, kind="stable")  # a link may exchange packets
    rows, time = rows[order], time[order]
    keys = rows[INSTANCES[name]] if name in INSTANCES else np.zeros(rows.size, dtype=int)
    for key in np.unique(keys).tolist():
        part = rows[keys == key]
        columns = {field: part[field] for field in fields if part[field].ndim == 1}
        for field in (field for field in fields if part[field].ndim == 2):
            columns |= {f"{field}[{i}]": column for i, column in enumerate(part[field].T)}
        yield Topic(name=name, instance=int(key), time=time[keys == key], columns=columns)


def _parameter_records(
    tables: dict[str, tuple[Array, NDArray[Any]]], clock: VehicleClock, *, is_px4: bool
) -> Iterator[tuple[float, str, float]]:
    """Yield time [s], name and value of each parameter; PX4 sends the bytes of an integer in place of a number."""
    if "PARAM_VALUE" not in tables:
        return
    received, rows = tables["PARAM_VALUE"]
    values = rows["param_value"].astype(np.float64)
    values = np.where(
        is_px4 & (rows["param_type"] == INT32), np.ascontiguousarray(rows["param_value"]).view("<i4"), values
    )
    names = [b"".join(name).decode("latin-1") for name in rows["param_id"].tolist()]
    yield from zip(clock.times(received, None).tolist(), names, values.tolist(), strict=True)


def _texts(received: Array, rows: NDArray[Any], clock: VehicleClock) -> Iterator[LogMessage]:
    texts = [b"".join(text).decode("utf-8", "replace") for text in rows["text"].tolist()]
    for time, severity, text in zip(
        clock.times(received, None).tolist(), rows["severity"].tolist(), texts, strict=True
    ):
        yield LogMessage(time=time, level=LEVELS[min(severity, 7)], text=text)


def _vector_channel(topic: Topic, quantity: str, fields: Sequence[str], unit: float) -> LogChannel:
    values = topic.numbers(*fields, unit=unit)
    if fields[0] == "yaw":
        values = Rotation.from_euler("ZYX", np.nan_to_num(values)).as_quat()[:, [3, 0, 1, 2]]
    return topic.channel(quantity, quantity_from_ned_frd(quantity, values))


def _rotor_channels(log: RawLog, firmware: LogReader) -> Iterator[LogChannel]:
    """Yield speeds by ESC telemetry, and motor signals as the firmware's own log gives them by its parameters."""
    for name, first in (("ESC_STATUS", "rpm[0]"), ("ESC_TELEMETRY_1_TO_4", "rpm[0]")):
        for topic in log.topic_instances(name, first):
            speeds = topic.numbers(*(f"rpm[{i}]" for i in range(4)), unit=UNITS["rpm"])
            used = np.abs(speeds).max(axis=0, initial=0.0) > 0.0
            if used.any() and topic.instance == 0:
                yield topic.channel("rotor_speed", np.abs(speeds[:, used]), note_on_rotor_order("the ESCs"))
    name, column = ("RCOU", "C{}") if isinstance(firmware, DataflashReader) else ("actuator_outputs", "output[{}]")
    base = int(name == "RCOU")
    views = [
        replace(one, name=name, columns={column.format(i): one.columns[field] for i, field in enumerate(SERVOS, base)})
        for one in log.topic_instances("SERVO_OUTPUT_RAW", *SERVOS)
    ]
    for channel in firmware.channels(replace(log, topics=tuple(views))):
        if channel.quantity == "rotor_command":
            yield replace(channel, source=channel.source.replace(name, "SERVO_OUTPUT_RAW"))


def _channels_of_arming_and_landing(log: RawLog) -> Iterator[LogChannel]:
    for topic in log.topic_instances("HEARTBEAT", "base_mode"):
        yield topic.channel("armed", ((topic.numbers("base_mode").astype(int) & ARMED_FLAG) > 0).astype(float))
    for topic in log.topic_instances("EXTENDED_SYS_STATE", "landed_state"):
        state = topic.columns["landed_state"]
        known = np.isin(state, (ON_GROUND, IN_AIR))
        if known.any():
            values = (state[known] == ON_GROUND).astype(float)[:, None]
            yield replace(topic.channel("landed", values), time=topic.time[known])
