"""Read PX4 ULog files with pyulog. Letters: T samples, R rotors.

Source: PX4 message definitions (github PX4/PX4-Autopilot, msg/): VehicleAttitude, VehicleLocalPosition, SensorCombined,
VehicleAngularVelocity, SensorGyroFifo, ActuatorMotors, ActuatorOutputs, EscReport, BatteryStatus, VehicleLandDetected; output
functions: src/lib/mixer_module/output_functions.yaml; thrust curve: THR_MDL_FAC in the PX4 parameter reference.
"""

from collections.abc import Iterator, Sequence
from contextlib import redirect_stdout
from dataclasses import replace
from io import BytesIO, StringIO
from pathlib import Path

import numpy as np

from aerial_gym.errors import DataError
from aerial_gym.extras import optional_import
from aerial_gym.sim2real.arrays import Array
from aerial_gym.sim2real.findings import Finding
from aerial_gym.sim2real.logs.raw_log import (
    LogChannel,
    LogMessage,
    RawLog,
    Topic,
    apply_parameter_records,
    faster_first,
    note_on_rotor_order,
)
from aerial_gym.sim2real.logs.readers.log_readers import LogReader
from aerial_gym.sim2real.logs.readers.mapping import UNITS, quantity_from_ned_frd
from aerial_gym.sim2real.logs.readers.stamps import correct_stamps, stamp_seconds
from aerial_gym.sim2real.logs.recording import FrameOrigin

ULOG_MAGIC = b"ULog\x01\x12\x35"  # Source: PX4 User Guide, ULog File Format, Header
FIFO_SAMPLES, SLOWEST_GYRO_HZ = (
    32,
    50.0,
)  # Samples in a message of raw data, which are used if all other gyros are slower
LONGEST_LATENCY_US = 1_000_000  # Largest delay from sampling to publication [us] on one clock
MOTOR_1 = 101  # Output function of motor 1; further motors follow
MOST_MOTORS = 12
QUADROTOR = 2  # MAV_TYPE. Source: MAVLink common.xml, as of the next numbers
ROTORS_BY_TYPE = {QUADROTOR: 4, 13: 6, 14: 8, 15: 3, 19: 2, 20: 4, 21: 4, 22: 4, 29: 12, 35: 10}  # 19 to 22: VTOL
DSHOT_MOST = 1999.0  # Output of full command; DSHOT_MIN is the share of the lowest one. Source: PX4 1.13, DShot.h
PWM_ENDS = {"MIN": 1000.0, "MAX": 2000.0}  # Default signals [us] without and with full command, by parameter
DSHOT_RATES = range(-5, -1)  # Values of PWM_MAIN_TIMn of the DShot protocols
MOST_REST_VALUES = 3  # Outputs below the range: not started, disarmed, failsafe
PLUS_FRAMES = 5  # Thousands of SYS_AUTOSTART of quadrotors in plus form
GPS_VELOCITY = ("vel_n_m_s", "vel_e_m_s", "vel_d_m_s")
ARMED = 2  # ``arming_state`` of an armed vehicle
ORDER = note_on_rotor_order("PX4")
LEVELS = {"DEBUG": "debug", "INFO": "info", "NOTICE": "info", "WARNING": "warning"}  # Any other level is an error

QUAD_X = np.array([(-1.0, 1.0, 1.0), (1.0, -1.0, 1.0), (1.0, 1.0, -1.0), (-1.0, -1.0, -1.0)]) * (0.7071, 0.7071, 1.0)
"""Roll, pitch and yaw factors of the rotors front right, rear left, front left, rear right. Source: PX4 1.12, quad_x mixer."""


class UlogStream(BytesIO):
    """The bytes of a file in which one can go back by twice its size: pyulog does so in damaged files, in some for ever."""

    def __init__(self, data: bytes) -> None:
        super().__init__(data)
        self._left = 2 * len(data) + 2**24  # Bytes by which a reader may still go back, each time counting as 8 more

    def seek(self, offset: int, whence: int = 0, /) -> int:
        """Go to a place; raise ``EOFError`` if the reader has gone back too often."""
        before, place = self.tell(), super().seek(offset, whence)
        self._left -= max(before - place, 0) + 8
        if self._left < 0:
            raise EOFError("it is damaged, so that no end of its messages is found")
        return place


class UlogReader(LogReader):
    """Reader of PX4 ULog files."""

    name = "ulog"
    summary = "PX4 ULog, by pyulog"

    def recognises(self, head: bytes) -> bool:
        """Return whether the file begins as a ULog."""
        return head.startswith(ULOG_MAGIC)

    def read(self, path: Path) -> RawLog:
        """Return all topics, parameters and messages of the file."""
        with optional_import("reading a PX4 ULog"):
            from pyulog import ULog  # pyright: ignore[reportMissingImports]
        try:
            with redirect_stdout(StringIO()):  # pyulog prints what it skips
                log = ULog(UlogStream(path.read_bytes()))
        except Exception as error:  # pyulog raises many types
            raise DataError(f"{path}: cannot be read as a PX4 ULog ({error!r})") from None
        told = [*log.logged_messages, *(one for some in log.logged_messages_tagged.values() for one in some)]
        texts = [(one.timestamp, LEVELS.get(one.log_level_str(), "error"), one.message.strip()) for one in told]
        texts += [(one.timestamp, "warning", f"messages of {one.duration} ms were lost") for one in log.dropouts]
        parameters, changes = apply_parameter_records(
            ((1e-6 * stamp, name, value) for stamp, name, value in log.changed_parameters), log.initial_parameters
        )
        lists = {
            name: "\n".join("".join(map(str, one)) for one in some) for name, some in log.msg_info_multiple_dict.items()
        }
        return RawLog(
            path=str(path),
            format=self.name,
            topics=tuple(
                _topic(part.name, part.multi_id, part.data) for part in log.data_list if "timestamp" in part.data
            ),
            parameters=parameters,
            parameter_changes=changes,
            messages=tuple(LogMessage(time=1e-6 * stamp, level=level, text=text) for stamp, level, text in texts),
            metadata={name: str(value) for name, value in log.msg_info_dict.items()} | lists,
            notes=(Finding("file_damaged"),) if log.file_corruption else (),
        )

    def channels(self, log: RawLog) -> Sequence[LogChannel]:
        """Return the quantities of the vehicle; of gyros and accelerometers a much faster one comes first."""
        vectors = (
            ("attitude", ("vehicle_attitude", "vehicle_odometry"), [f"q[{i}]" for i in range(4)]),
            ("position", ("vehicle_local_position", "vehicle_odometry"), list("xyz")),
            ("position", ("vehicle_odometry",), [f"position[{i}]" for i in range(3)]),  # since PX4 1.14
            ("lin_vel", ("vehicle_local_position", "vehicle_odometry"), ["vx", "vy", "vz"]),
            ("lin_vel", ("vehicle_odometry",), [f"velocity[{i}]" for i in range(3)]),
            ("ang_vel", ("vehicle_angular_velocity",), [f"xyz[{i}]" for i in range(3)]),
            ("ang_vel", ("sensor_combined",), [f"gyro_rad[{i}]" for i in range(3)]),
            ("ang_vel", ("vehicle_attitude",), ["rollspeed", "pitchspeed", "yawspeed"]),
            ("specific_force", ("sensor_combined",), [f"accelerometer_m_s2[{i}]" for i in range(3)]),
            ("specific_force", ("vehicle_acceleration",), [f"xyz[{i}]" for i in range(3)]),
        )
        usable = [
            _vector_channel(topic, quantity, fields)
            for quantity, names, fields in vectors
            for name in names
            for topic in log.topic_instances(name, *fields)
        ]
        origin = _estimator_origin(log)
        usable = [replace(one, origin=origin) for one in usable if np.isfinite(one.values).any()]
        gyros = [one.time.size / max(float(np.ptp(one.time)), 1e-9) for one in usable if one.quantity == "ang_vel"]
        return [
            *(_raw_gyro_channels(log) if max(gyros, default=0.0) < SLOWEST_GYRO_HZ else ()),
            *faster_first(usable),
            *(
                _vector_channel(topic, "lin_vel", GPS_VELOCITY)
                for name in ("vehicle_gps_position", "sensor_gps")
                for topic in log.topic_instances(name, *GPS_VELOCITY)
            ),
            *_rotor_speed_channels(log),
            *faster_first([*_channels_of_actuator_motors(log), *_channels_of_actuator_outputs(log)]),
            *_channels_of_actuator_controls(log),
            *(
                _channel_on_sampling_times(one, "battery", volts)
                for one, volts in log.batteries("battery_status", "voltage_v")
            ),
            *_channels_of_arming_and_landing(log),
        ]


def _estimator_origin(log: RawLog) -> FrameOrigin:
    """Return the reference of the local position; unknown if the log states none or it moves."""
    fields = ("ref_lat", "ref_lon", "ref_alt")
    for topic in log.topic_instances("vehicle_local_position", *fields, "xy_global", "z_global"):
        states = (topic.columns["xy_global"] != 0.0) & (topic.columns["z_global"] != 0.0)
        origins = np.unique(topic.numbers(*fields)[states], axis=0)
        return FrameOrigin(*origins[0]) if len(origins) == 1 else FrameOrigin()
    return FrameOrigin()


def _topic(name: str, instance: int, data: dict[str, Array]) -> Topic:
    return Topic(name=name, instance=instance, time=stamp_seconds(data["timestamp"], 1e-6), columns=data)


def _channel_on_sampling_times(
    topic: Topic, quantity: str, values: Array, notes: tuple[Finding, ...] = ()
) -> LogChannel:
    """Return a channel of a topic on its sampling times, or on those of publication if the former are unusable."""
    time, latency = topic.time, None
    if "timestamp_sample" in topic.columns:
        sampled = stamp_seconds(topic.columns["timestamp_sample"], 1e-6)
        delays = time - sampled
        try:
            if np.median((delays >= 0.0) & (delays < 1e-6 * LONGEST_LATENCY_US)) > 0.0:
                correct_stamps(sampled, "")
                time, latency = sampled, float(np.median(delays))
        except DataError:
            pass
    return replace(topic.channel(quantity, values, notes), time=time, latency=latency)


def _vector_channel(topic: Topic, quantity: str, fields: Sequence[str]) -> LogChannel:
    """Return a channel in this package's frames, with the resets by the topic's counters."""
    values = topic.numbers(*fields)
    for flag in {"position": ("xy_valid", "z_valid"), "lin_vel": ("v_xy_valid", "v_z_valid")}.get(quantity, ()):
        if flag in topic.columns:
            values[topic.columns[flag] == 0.0] = np.nan
    channel = _channel_on_sampling_times(topic, quantity, quantity_from_ned_frd(quantity, values))
    counters = {
        "attitude": ("quat_reset_counter", "reset_counter"),
        "position": ("xy_reset_counter", "z_reset_counter", "reset_counter"),
        "lin_vel": ("vxy_reset_counter", "vz_reset_counter", "reset_counter"),
    }
    known = [name for name in counters.get(quantity, ()) if name in topic.columns]
    if not known:
        return channel
    changes = np.any(np.diff(topic.numbers(*known), axis=0) != 0.0, axis=1)
    return replace(channel, resets=channel.time[1:][changes])


def _raw_gyro_channels(log: RawLog) -> Iterator[LogChannel]:
    """Yield the samples of ``sensor_gyro_fifo``, less the calibrated offset; none for a board that is mounted turned."""
    names = ["samples", "scale", "dt", *(f"{axis}[{i}]" for axis in "xyz" for i in range(FIFO_SAMPLES))]
    for topic in log.topic_instances("sensor_gyro_fifo", *names) if log.number("SENS_BOARD_ROT", 0.0) == 0.0 else ():
        count, place = topic.columns["samples"].astype(int)[:, None], np.arange(FIFO_SAMPLES)
        stamps = topic.columns.get("timestamp_sample", 1e6 * topic.time)
        time = stamp_seconds(stamps, 1e-6)[:, None] - 1e-6 * topic.columns["dt"][:, None] * (count - 1 - place)
        counts = np.stack([topic.numbers(*(f"{axis}[{i}]" for i in place)) for axis in "xyz"], axis=2)
        device = float(np.median(topic.columns.get("device_id", np.zeros(1))))
        number = next((k for k in range(4) if log.number(f"CAL_GYRO{k}_ID", -1.0) == device), 0)
        offset = [log.number(f"CAL_GYRO{number}_{axis}OFF", 0.0) for axis in "XYZ"]
        inside = place < count
        values = (topic.columns["scale"][:, None, None] * counts)[inside] - offset
        yield replace(topic.channel("ang_vel", quantity_from_ned_frd("ang_vel", values)), time=time[inside])


def _rotor_speed_channels(log: RawLog) -> Iterator[LogChannel]:
    """Yield measured rotor speeds in the order of motors, by ``actuator_function`` if that is logged."""
    for topic in log.topic_instances("esc_status"):
        usable: dict[int, Array] = {}
        for index in range(MOST_MOTORS):
            if f"esc[{index}].esc_rpm" not in topic.columns:
                break
            rpm, key = topic.numbers(f"esc[{index}].esc_rpm"), f"esc[{index}].actuator_function"
            function = float(np.median(topic.columns[key])) if key in topic.columns else 0.0
            if np.any(rpm != 0.0):
                usable[int(function) if function >= MOTOR_1 else MOTOR_1 + index] = np.abs(rpm)
        if usable:
            speeds = UNITS["rpm"] * np.concatenate([usable[number] for number in sorted(usable)], axis=1)
            yield _channel_on_sampling_times(topic, "rotor_speed", speeds, ORDER)


def _channels_of_actuator_motors(log: RawLog) -> Iterator[LogChannel]:
    """Yield commands of ``actuator_motors``: thrusts from 0 to 1, which become speeds by ``_invert_thrust_curve``."""
    for topic in log.topic_instances("actuator_motors"):
        columns = [name for name in (f"control[{i}]" for i in range(MOST_MOTORS)) if name in topic.columns]
        used = [name for name in columns if np.isfinite(topic.columns[name]).any()]
        if used:
            thrust = np.nan_to_num(topic.numbers(*used), nan=0.0)  # NaN stops a motor
            command = np.sign(thrust) * _invert_thrust_curve(np.abs(thrust), log)
            yield _channel_on_sampling_times(topic, "rotor_command", command, ORDER)


def _invert_thrust_curve(thrust: Array, log: RawLog) -> Array:
    """Return the motor signal u of a relative thrust ``f u^2 + (1 - f) u``, PX4's thrust curve."""
    factor = log.number("THR_MDL_FAC", 0.0)
    if factor <= 0.0:
        return thrust
    linear = 1.0 - factor
    return (np.sqrt(linear**2 + 4.0 * factor * np.maximum(thrust, 0.0)) - linear) / (2.0 * factor)


def _channels_of_actuator_outputs(log: RawLog) -> Iterator[LogChannel]:
    """Yield motor signals of ``actuator_outputs``; each instance has the driver whose range fits its outputs."""
    drivers = _motor_ranges_of_output_drivers(log)
    for topic in log.topic_instances("actuator_outputs"):
        options = [_motor_signals_from_outputs(topic, ranges) for ranges in drivers]
        fitting = [values for values in options if values is not None]
        if fitting:
            yield _channel_on_sampling_times(topic, "rotor_command", fitting[0], ORDER)


def _motor_ranges_of_output_drivers(log: RawLog) -> list[list[tuple[int, float, float]]]:
    """Return for each output driver the index, lowest and highest value of its motor outputs, in the order of motors."""
    parameters = {name: float(value) for name, value in log.parameters.items() if not isinstance(value, str)}
    drivers: dict[str, list[tuple[float, int, float, float]]] = {}
    for name, function in parameters.items():
        prefix, _, number = name.rpartition("_FUNC")
        if prefix and number.isdigit() and MOTOR_1 <= function < MOTOR_1 + MOST_MOTORS:
            low, high = (parameters.get(f"{prefix}_{end}{number}", signal) for end, signal in PWM_ENDS.items())
            drivers.setdefault(prefix, []).append((function, int(number) - 1, low, high))
    count = parameters.get("CA_ROTOR_COUNT", 0.0)  # a driver with some of the rotors only does not show the others
    results = [[row[1:] for row in sorted(rows)] for rows in drivers.values() if count in (0.0, len(rows))]
    if not drivers:  # before PX4 1.13 the first outputs were the motors
        low, high = (
            parameters.get(f"PWM_MAIN_{end}", parameters.get(f"PWM_{end}", signal)) for end, signal in PWM_ENDS.items()
        )
        count = ROTORS_BY_TYPE.get(int(log.number("MAV_TYPE", QUADROTOR)), 0)
        results = [[(index, low, high) for index in range(count)]]
    rates = [value for name, value in parameters.items() if name.startswith("PWM_") and "_TIM" in name]
    if parameters.get("DSHOT_CONFIG", 0.0) > 0.0 or any(rate in DSHOT_RATES for rate in rates):
        idle = DSHOT_MOST * parameters.get("DSHOT_MIN", 0.055)
        results += [[(index, idle, DSHOT_MOST) for index, _, _ in rows] for rows in results]
    return results


def _motor_signals_from_outputs(topic: Topic, ranges: Sequence[tuple[int, float, float]]) -> Array | None:
    """Return motor signals from 0 to 1, (T, R); None if the outputs do not vary, or vary outside of the range."""
    names = [f"output[{index}]" for index, _, _ in ranges]
    if not names or not set(names) <= topic.columns.keys():
        return None
    outputs = topic.numbers(*names)
    low, high = (np.array([row[place] for row in ranges]) for place in (1, 2))
    if np.any(np.ptp(outputs, axis=0) == 0.0):
        return None
    if outputs.max() <= 1.0:  # hardware in the loop: shares
        return np.maximum(outputs, 0.0)
    signal = (outputs - low) / (high - low)
    at_rest = max(np.unique(column[column < 0.0]).size for column in signal.T)
    fits = np.all((signal > 0.0).any(axis=0)) and signal.max() <= 1.0 and at_rest <= MOST_REST_VALUES
    return np.clip(signal, 0.0, 1.0) if fits else None


def _channels_of_actuator_controls(log: RawLog) -> Iterator[LogChannel]:
    """Yield motor signals of a quadrotor from ``actuator_controls_0`` (before PX4 1.13) by the mixer of an X frame."""
    names = [f"control[{index}]" for index in range(4)]
    is_x = log.number("MAV_TYPE", QUADROTOR) == QUADROTOR and log.number("SYS_AUTOSTART", 0.0) // 1000 != PLUS_FRAMES
    for topic in log.topic_instances("actuator_controls_0", *names) if is_x else ():
        controls = topic.numbers(*names)  # roll, pitch, yaw and thrust
        thrust = controls[:, :3] @ QUAD_X.T + controls[:, 3:]
        signal = _invert_thrust_curve(np.clip(thrust, 0.0, 1.0), log)
        yield _channel_on_sampling_times(topic, "rotor_command", signal, (*ORDER, Finding("commands_mixed")))


def _channels_of_arming_and_landing(log: RawLog) -> Iterator[LogChannel]:
    """Yield arming and contact with the ground."""
    for topic in log.topic_instances("actuator_armed", "armed"):
        yield _channel_on_sampling_times(topic, "armed", topic.numbers("armed"))
    for topic in log.topic_instances("vehicle_status", "arming_state"):
        yield _channel_on_sampling_times(topic, "armed", (topic.numbers("arming_state") == ARMED).astype(float))
    for topic in log.topic_instances("vehicle_land_detected"):
        flags = [name for name in ("landed", "maybe_landed", "ground_contact") if name in topic.columns]
        yield _channel_on_sampling_times(
            topic, "landed", np.any(topic.numbers(*flags) != 0.0, axis=1, keepdims=True).astype(float)
        )
