"""Read ArduPilot DataFlash logs, binary (.bin) or as text (.log). World is NED, body is FRD, angles are in degrees.

Letters: T samples, R rotors.

Source: ArduPilot, ``libraries/AP_Logger/README.md`` and ``LogStructure.h`` for formats, units and multipliers; *Onboard Message
Log Messages* of its documentation for fields; ``AP_Logger.h``, ``LogEvent``, for events; ``SRV_Channel.h`` for motor outputs;
``AP_Motors_Class.h`` for frame classes; ``AP_MotorsMulticopter.cpp``, ``update_throttle_range``, for the range of the signals;
``ArduPlane/Log.cpp``, ``Log_Write_Attitude``, for the axes of a tail-sitter.
"""

import re
from collections.abc import Iterator, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from aerial_gym.errors import DataError
from aerial_gym.sim2real.arrays import Array
from aerial_gym.sim2real.findings import Finding
from aerial_gym.sim2real.logs.raw_log import (
    LazyColumns,
    LogChannel,
    LogMessage,
    LogParameterChange,
    RawLog,
    Topic,
    apply_parameter_records,
    faster_first,
    note_on_rotor_order,
)
from aerial_gym.sim2real.logs.readers import dataflash_messages as messages
from aerial_gym.sim2real.logs.readers.dataflash_messages import TYPES, MessageTable, MessageType
from aerial_gym.sim2real.logs.readers.log_readers import LogReader
from aerial_gym.sim2real.logs.readers.mapping import UNITS, quantity_from_ned_frd
from aerial_gym.sim2real.logs.recording import FrameOrigin

INSTANCES = ("I", "Instance", "Inst", "C")  # Fields that number several sources of one message, if no unit marks them
SMALLEST_DAMAGE = 256  # A log cut by power loss ends within a message, whose length is at most 255 bytes
ARMED, DISARMED, LANDED_MAYBE, LANDED, FLYING = 10, 11, 17, 18, 28  # Codes of EV messages
HIGHEST_BATTERY_V = 110.0  # More than any pack, and less than the hundredths of a volt that copters before 3.4 log
RESETS = {"position": 60, "attitude": 62}  # Codes of EV messages, of height and of yaw
MOTOR_FUNCTIONS = (*range(33, 41), *range(82, 86))  # SERVOn_FUNCTION of motors 1 to 12
LEFT, RIGHT = 73, 74  # SERVOn_FUNCTION of the two motors of a tail-sitter with elevons
TAIL_SITTER = 10  # Q_FRAME_CLASS
MOTORS = {7: (0, 1, 3), 8: (4, 5), 9: (4, 5), **dict.fromkeys((6, 11, 13), ())}
"""Motor functions of rotors with variable speed, from 0, by frame class; the others turn servos, as of a helicopter."""

DIGITAL = range(4, 10)  # MOT_PWM_TYPE of signals with the range 1000 to 2000, in spite of MOT_PWM_MIN and MAX
HOVER_AXES = Rotation.from_euler("y", 90.0, degrees=True)
"""Rotation of a tail-sitter's body axes in hover to those of its sensors."""

BATTERIES = (("BAT", "Volt"), ("CURR", "Volt"), ("MOTB", "BatVolt"))  # Messages and fields of voltages

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


class DataflashReader(LogReader):
    """Reader of ArduPilot logs."""

    name = "dataflash"
    summary = "DataFlash of ArduPilot, binary or as text"

    def recognises(self, head: bytes) -> bool:
        """Return whether the file begins with the head of a message, or with the definition of one as text."""
        return head.startswith(messages.HEAD) or messages.TEXT_LOG.search(head) is not None

    def read(self, path: Path) -> RawLog:
        """Return all messages with a time as topics, and the parameters and texts."""
        data = np.fromfile(path, dtype=np.uint8)
        if data[: len(messages.HEAD)].tobytes() == messages.HEAD:
            types = messages.message_types_in_binary_log(data)
            tables, used = messages.tables_of_binary_messages(data, types)
        else:
            (types, tables), used = messages.read_lines(data.tobytes().decode("latin-1")), data.size
        named = {table.type.name: table for table in tables}
        if named.keys().isdisjoint(("IMU", "ATT", "RATE", "GYR")):
            raise DataError(f"{path}: holds no messages IMU, ATT, RATE or GYR of ArduPilot; log them (LOG_BITMASK)")
        if not any(set(messages.TIMES) & set(table.type.fields) for table in tables):
            raise DataError(
                f"{path}: has messages without times, as .px4log of PX4 before 1.6; convert it by sdlog2_dump.py of PX4, and "
                "give the CSV file with a mapping"
            )
        parameters, changes = _parameters_and_changes(named)
        units, lost = _field_units(types, named), data.size - used
        texts = list(zip(named["MSG"].seconds, named["MSG"].texts("Message"), strict=False)) if "MSG" in named else []
        return RawLog(
            path=str(path),
            format=self.name,
            topics=tuple(
                topic for name, table in named.items() for topic in _topics_of_instances(table, units.get(name, {}))
            ),
            parameters=parameters,
            parameter_changes=changes,
            messages=tuple(LogMessage(time=float(time), level="info", text=text) for time, text in texts),
            metadata=_log_names([text for _, text in texts]),
            notes=(Finding("bytes_left_out", "", {"bytes": lost, "total": data.size}),) * (lost >= SMALLEST_DAMAGE),
        )

    def channels(self, log: RawLog) -> Sequence[LogChannel]:
        """Return the quantities of the vehicle; of several sources a much faster one comes first."""
        hovers = log.number("Q_TAILSIT_ENABLE", 0.0) > 0.0 or log.number("Q_FRAME_CLASS", 0.0) == TAIL_SITTER
        vectors = [
            _vector_channel(topic, quantity, fields, unit, hovers=hovers)
            for quantity, names, fields, unit in VECTORS
            for name in names
            if not (hovers and name in ("ATT", "RATE"))  # whose axes change between hover and forward flight
            for topic in log.topic_instances(name, *fields)
        ]
        return [
            *(
                replace(_add_resets_of_estimator(channel, log), origin=_estimator_origin(log))
                for channel in faster_first(vectors)
            ),
            *_gps_channels(log),
            *_rotor_channels(log),
            *(
                topic.channel("battery", volts * (0.01 if np.median(volts) > HIGHEST_BATTERY_V else 1.0))
                for names in BATTERIES
                for topic, volts in log.batteries(*names)
            ),
            *_channels_of_arming_and_landing(log),
        ]


def _log_names(texts: Sequence[str]) -> dict[str, str]:
    """Return the firmware, which is the first text, and the board with its serial number of three words, if stated."""
    boards = [text for text in texts if re.search(r"[0-9A-F]{8} [0-9A-F]{8} [0-9A-F]{8}$", text.strip())]
    return {name: some[0] for name, some in (("firmware", texts), ("board", boards)) if some}


def _parameters_and_changes(
    named: dict[str, MessageTable],
) -> tuple[dict[str, float | str], tuple[LogParameterChange, ...]]:
    """Return the last value of each parameter, and its changes."""
    try:
        columns = (named["PARM"].seconds.tolist(), named["PARM"].texts("Name"), named["PARM"].numbers("Value").tolist())
    except (KeyError, ValueError):
        return {}, ()
    first = dict(reversed([(name, value) for _, name, value in zip(*columns, strict=False)]))
    return apply_parameter_records(zip(*columns, strict=False), first)


def _field_units(types: dict[int, MessageType], named: dict[str, MessageTable]) -> dict[str, dict[str, str]]:
    """Return the unit of each field by message and field, from the messages FMTU, UNIT and MULT."""
    try:
        units = dict(zip(named["UNIT"].numbers("Id").tolist(), named["UNIT"].texts("Label"), strict=True))
        factors = dict(zip(*(named["MULT"].numbers(field).tolist() for field in ("Id", "Mult")), strict=True))
        texts = (named["FMTU"].texts(field) for field in ("UnitIds", "MultIds"))
        rows = zip(named["FMTU"].numbers("FmtType").tolist(), *texts, strict=False)
    except (KeyError, ValueError):
        return {}
    results: dict[str, dict[str, str]] = {}
    for number, unit_ids, factor_ids in rows:
        if (one := types.get(int(number))) is None:
            continue
        for field, code, unit, factor in zip(one.fields, one.format, unit_ids, factor_ids, strict=False):
            scale = factors.get(float(ord(factor)), 0.0) if TYPES[code][1] == 1.0 else 1.0
            label = "#" if unit == "#" else units.get(float(ord(unit)), "")
            text = label if scale in (0.0, 1.0) or not label else f"{scale:g} {label}"
            results.setdefault(one.name, {})[field] = text
    return results


def _topics_of_instances(table: MessageTable, units: dict[str, str]) -> Iterator[Topic]:
    """Yield the numeric fields of a message with a time, one topic for each instance."""
    kind, rows = table.type, table.rows
    if not set(messages.TIMES) & set(kind.fields) or not rows.size:
        return
    counted = [field for field, code in kind.columns if code in "bB"]
    marked = [field for field in counted if units.get(field) == "#"]
    marked = marked or [field for field in counted if field in INSTANCES and kind.name != "CMD"]
    keys = table.numbers(marked[0]).astype(int) if marked else np.zeros(rows.size, dtype=int)
    digits = kind.name.lstrip("ABCDEFGHIJKLMNOPQRSTUVWXYZ")
    for key in np.unique(keys).tolist():
        part = MessageTable(type=kind, rows=rows[keys == key]) if keys.any() else table
        columns: dict[str, Any] = {}
        for place, (field, code) in enumerate(kind.columns):
            if code == "a":
                columns |= {f"{field}[{i}]": partial(_array_column, part.rows, place, i) for i in range(32)}
            elif TYPES[code][1] != 0.0:
                columns[field] = partial(part.numbers, field)
        old = not marked and kind.name[:-1] in ("IMU", "ACC", "GYR", "GPS", "BAT", "ESC") and digits.isdigit()
        number = int(digits) - 1 if old else key  # before Copter 4.1 instances had names, such as IMU2
        name = kind.name[:-1] if old else kind.name
        yield Topic(name=name, instance=number, time=part.seconds, columns=LazyColumns(columns), units=units)


def _array_column(rows: NDArray[Any], place: int, index: int) -> Array:
    return rows[str(place)][:, index].astype(np.float64)


def _vector_channel(topic: Topic, quantity: str, fields: Sequence[str], unit: float, *, hovers: bool) -> LogChannel:
    """Return a channel in this package's frames, of a tail-sitter in hover axes, on the sampling times if they are logged."""
    values = topic.numbers(*fields, unit=unit)
    if len(fields) == 3 and quantity == "attitude":  # roll, pitch, yaw
        turned = Rotation.from_euler("ZYX", np.nan_to_num(values[:, ::-1])).as_quat()
        values = np.where(np.isfinite(values).all(axis=1)[:, None], turned, np.nan)[:, [3, 0, 1, 2]]
    values = quantity_from_ned_frd(quantity, values)
    if hovers and quantity == "attitude":
        known = np.linalg.norm(np.nan_to_num(values), axis=1) > 0.0
        values[known] = (Rotation.from_quat(values[known]) * HOVER_AXES).as_quat()
    elif hovers and quantity in ("ang_vel", "specific_force"):
        values = HOVER_AXES.inv().apply(values)
    channel = topic.channel(quantity, values)
    return replace(channel, time=1e-6 * topic.columns["SampleUS"]) if "SampleUS" in topic.columns else channel


def _add_resets_of_estimator(channel: LogChannel, log: RawLog) -> LogChannel:
    """Return a channel with the resets that the estimator reported, at the first sample after each."""
    code = RESETS.get(channel.quantity)
    events = [topic.time[topic.columns["Id"] == code] for topic in log.topic_instances("EV", "Id")]
    rows = np.searchsorted(channel.time, np.concatenate([[], *events]))
    return replace(channel, resets=channel.time[rows[rows < channel.time.size]]) if rows.size else channel


def _estimator_origin(log: RawLog) -> FrameOrigin:
    """Return the origin of the estimator's frame (ORGN of type 0); unknown if it is not logged or moves."""
    for topic in log.topic_instances("ORGN", "Type", "Lat", "Lng", "Alt"):
        origins = np.unique(topic.numbers("Lat", "Lng", "Alt")[topic.columns["Type"] == 0.0], axis=0)
        return FrameOrigin(*origins[0]) if len(origins) == 1 else FrameOrigin()
    return FrameOrigin()


def _gps_channels(log: RawLog) -> Iterator[LogChannel]:
    """Yield position, from the first fix, and velocity of the GPS."""
    fields = ("Lat", "Lng", "Alt", "Spd", "GCrs", "VZ")
    for topic in log.topic_instances("GPS", "Status", *fields):
        fix = topic.columns["Status"] >= 3.0  # three-dimensional
        if not fix.any():
            continue
        lat, lng, alt, speed, course, down = topic.numbers(*fields)[fix].T
        origin = FrameOrigin(lat[0], lng[0], alt[0])
        position = origin.local_position(lat, lng, alt)
        heading = np.radians(course)
        velocity = np.stack((speed * np.sin(heading), speed * np.cos(heading), -down), axis=1)
        for quantity, values in (("position", position), ("lin_vel", velocity)):
            yield LogChannel(quantity=quantity, time=topic.time[fix], values=values, source=topic.source, origin=origin)


def _output_numbers_of_motors(log: RawLog) -> list[int]:
    """Return the output number of each motor, from 1, by ``SERVOn_FUNCTION``; the first outputs where no function is logged."""
    functions = {n: log.parameters[name] for n in range(1, 33) if (name := f"SERVO{n}_FUNCTION") in log.parameters}
    frame = log.number("FRAME_CLASS", log.number("Q_FRAME_CLASS", 1.0))
    wanted = [MOTOR_FUNCTIONS[motor] for motor in MOTORS.get(int(frame), range(len(MOTOR_FUNCTIONS)))]
    outputs = {function: n for n, function in functions.items() if isinstance(function, float)}
    if motors := [outputs[function] for function in wanted if function in outputs]:
        return motors
    if functions and frame != TAIL_SITTER and log.number("Q_ENABLE", 0.0) == 0.0:
        return []
    if functions:
        return [outputs[side] for side in (LEFT, RIGHT) if side in outputs]
    count = {2.0: 6, 3.0: 8, 4.0: 8, 5.0: 6}.get(frame, 4)
    return list(range(1, count + 1)) if "Plane" not in log.metadata.get("firmware", "") else []


def _motor_signals_at_rest_and_full(log: RawLog, output: int) -> tuple[float, float]:
    """Return the signals [us] of a motor at rest and at full command."""
    if log.number(f"SERVO{output}_FUNCTION", 0.0) in (LEFT, RIGHT):
        return log.number(f"SERVO{output}_MIN", 1000.0), log.number(f"SERVO{output}_MAX", 2000.0)
    if log.number("MOT_PWM_TYPE", log.number("Q_M_PWM_TYPE", 0.0)) in DIGITAL:
        return 1000.0, 2000.0
    low, high = (
        log.number(f"MOT_PWM_{end}", log.number(f"Q_M_PWM_{end}", 0.0)) or log.number(f"RC3_{end}", 0.0) or default
        for end, default in (("MIN", 1000.0), ("MAX", 2000.0))
    )
    return low, high


def _rotor_channels(log: RawLog) -> Iterator[LogChannel]:
    """Yield rotor speeds by ESC telemetry, and motor signals from 0 to 1, in the order of motors."""
    note, outputs = note_on_rotor_order("ArduPilot"), _output_numbers_of_motors(log)
    if not outputs:
        return
    escs = {topic.instance: topic for topic in log.topic_instances("ESC", "RPM")}
    numbers = [n - 1 for n in outputs]
    if not set(numbers) <= escs.keys() and len(escs) == len(outputs):
        numbers = sorted(escs)  # before 4.1 ESCs were counted in the order of motors
    if set(numbers) <= escs.keys():
        used = [escs[n] for n in numbers]
        time = max(used, key=lambda topic: topic.time.size).time
        speeds = [
            np.interp(time, *_samples_in_order_of_time(topic.time, np.abs(topic.columns["RPM"]))) for topic in used
        ]
        values = UNITS["rpm"] * np.stack(speeds, axis=1)
        yield LogChannel(quantity="rotor_speed", time=time, values=values, source=used[0].source, notes=note)
    low, high = np.array([_motor_signals_at_rest_and_full(log, n) for n in outputs]).T
    for prefix in ("C", "Ch", "Chan") if np.all(high > low) else ():  # the latter before Copter 3.4
        fields = [f"{prefix}{n}" for n in outputs]
        for topic in log.topic_instances("RCOU", *fields):
            yield topic.channel("rotor_command", np.clip((topic.numbers(*fields) - low) / (high - low), 0.0, 1.0), note)


def _samples_in_order_of_time(time: Array, values: Array) -> tuple[Array, Array]:
    """Return the samples in order of time, each time once."""
    times, places = np.unique(time, return_index=True)
    return times, values[places]


def _channels_of_arming_and_landing(log: RawLog) -> Iterator[LogChannel]:
    """Yield arming and contact with the ground; before the first event the state is the opposite one."""
    start = min((float(topic.time[0]) for topic in log.topics), default=0.0)
    for topic in log.topic_instances("EV", "Id"):
        codes = topic.columns["Id"]
        for quantity, on, off in (("armed", (ARMED,), (DISARMED,)), ("landed", (LANDED_MAYBE, LANDED), (FLYING,))):
            rows = np.isin(codes, (*on, *off))
            if rows.any():
                states = np.isin(codes[rows], on).astype(float)
                time = np.append(min(start, topic.time[rows][0]), topic.time[rows])
                values = np.append(1.0 - states[0], states)[:, None]
                yield replace(topic.channel(quantity, values), time=time)
    for name, quantity, field, flying in (("STAT", "armed", "Armed", 1.0), ("STAT", "landed", "isFlying", 0.0)):
        for topic in log.topic_instances(name, field):  # of planes
            yield topic.channel(quantity, (topic.numbers(field) == flying).astype(float))
