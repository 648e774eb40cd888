"""Check units, frames, quaternion order and the sign of gravity of a flight log by pairs of independent measurements.

Only a contradiction that no real vehicle can cause is refused. Letters: T rows.
"""

from collections.abc import Callable

import numpy as np
from scipy.spatial.transform import Rotation

from aerial_gym.config.robot import RobotCfg
from aerial_gym.config.sim import STANDARD_GRAVITY
from aerial_gym.errors import DataError
from aerial_gym.sim2real.arrays import Array
from aerial_gym.sim2real.findings import Finding
from aerial_gym.sim2real.logs.checks.duration import rms_of_vectors
from aerial_gym.sim2real.logs.checks.kinematics import (
    CHECK_BANDWIDTH_HZ,
    QUIET,
    WORST_AGREEMENT,
    SensorGain,
    findings_on_gains,
    gains_of_moving_sensors,
    imu_errors_from_kinematics,
    permutation_of_horizontal_axes,
)
from aerial_gym.sim2real.logs.checks.rotors import check_rotor_columns
from aerial_gym.sim2real.logs.checks.units import (
    check_units_against_accelerometer,
    check_units_of_velocity_and_position,
)
from aerial_gym.sim2real.logs.readers.mapping import UNITS
from aerial_gym.sim2real.logs.recording import AT_REST, FlightLog, sample_rate
from aerial_gym.sim2real.logs.signals import lowpass

MIRRORS = {"roll": (1, 1, -1), "pitch": (1, -1, 1), "yaw": (-1, 1, 1)}  # Signs of yaw, pitch and roll
LEAST_GAIN = 0.5  # Share of the attitude's turning that a working gyro shows at least
SURE_GAIN = 0.999  # One-sided confidence that the share is less
QUIET_SPEED = 0.3  # Below this RMS velocity [m/s] the comparison with the position is skipped
QUIET_FORCE = 0.5  # Least reference [m/s²] for the relative error of the acceleration
LEAST_ACROSS = 1.0  # Least horizontal RMS specific force [m/s²] that reveals world axes; drag alone causes less


def check_log(log: FlightLog, robot: RobotCfg) -> list[Finding]:
    """Raise ``DataError`` for a log that contradicts itself; return findings on smaller defects."""
    check_rotor_columns(log, robot)
    _check_constant_columns(log)
    attitude = Rotation.from_quat(log.attitude)
    _check_attitude_against_rate(log, attitude)
    _check_gravity(log, attitude)
    notes = check_units_of_velocity_and_position(log)
    _check_velocity_against_position(log, attitude)
    _check_force_frame(log, attitude)
    check_units_against_accelerometer(log)
    notes += [note for errors in imu_errors_from_kinematics(log) for note in errors.findings()]
    return [*notes, *findings_on_gains(log)]


def _check_constant_columns(log: FlightLog) -> None:
    for name in ("ang_vel", "specific_force", "rotor_speed", "rotor_command"):
        values = getattr(log, name)
        if values is None:
            continue
        still = np.flatnonzero(np.ptp(values, axis=0) == 0.0)
        if still.size:
            raise DataError(
                f"{log.path}: {name} {still[0] + 1} is {values[0, still[0]]:.6g} in every row; "
                "leave a sensor that did not work empty in all its columns"
            )


def _rows_of_comparison(log: FlightLog) -> slice:
    """Return the compared rows: all but half a second at either end."""
    edge = round(0.5 * sample_rate(log))
    return slice(edge, -edge)


def _lowpass_compared_rows(values: Array, log: FlightLog, *, derivative: bool = False) -> Array:
    """Return the low-passed signal, or its derivative, at the compared rows."""
    return lowpass(values, sample_rate(log), CHECK_BANDWIDTH_HZ, derivative=derivative)[_rows_of_comparison(log)]


def body_rate_from_attitude(attitude: Array, rate: float, bandwidth: float) -> Array:
    """Return the angular velocity [rad/s], body, (T, 3), of quaternions (T, 4): ``2 q* q'`` (Sola 2017, eq. 198)."""
    smooth = lowpass(attitude, rate, bandwidth)
    x, y, z, w = smooth.T
    dx, dy, dz, dw = lowpass(attitude, rate, bandwidth, derivative=True).T
    rows = (w * dx - x * dw - y * dz + z * dy, w * dy - y * dw - z * dx + x * dz, w * dz - z * dw - x * dy + y * dx)
    return 2.0 * np.stack(rows, axis=1) / (smooth * smooth).sum(axis=1, keepdims=True)


READINGS: dict[str, Callable[[Array], Array]] = {
    "the quaternion is stored w first": lambda q: q[:, [1, 2, 3, 0]],
    "the quaternion turns world into body": lambda q: q * (-1.0, -1.0, -1.0, 1.0),
    "the quaternion is stored w first and turns world into body": lambda q: q[:, [1, 2, 3, 0]] * (-1, -1, -1, 1),
}
"""Common wrong conventions of the four quaternion columns, each with its correction."""


def _check_attitude_against_rate(log: FlightLog, attitude: Rotation) -> None:
    """Compare the derivative of the attitude with the gyro."""
    if log.ang_vel is None:
        return
    measured = _lowpass_compared_rows(log.ang_vel, log)
    size = rms_of_vectors(measured)
    if size < QUIET["gyro"]:
        _check_resting_gyro(log, size)
        return

    def difference_and_rate(quaternion: Array) -> tuple[float, Array]:
        rate = body_rate_from_attitude(quaternion, sample_rate(log), CHECK_BANDWIDTH_HZ)[_rows_of_comparison(log)]
        return rms_of_vectors(rate - measured) / max(size, rms_of_vectors(rate)), rate

    miss, rate = difference_and_rate(log.attitude)
    if miss < WORST_AGREEMENT:
        _check_gyro_axes(log)
        return
    alternatives = {text: difference_and_rate(read(log.attitude))[0] for text, read in READINGS.items()}
    slope = float((rate * measured).sum() / (measured * measured).sum())
    degrees = UNITS["deg/s"]
    if rms_of_vectors(rate - degrees * measured) < 0.5 * rms_of_vectors(rate) and abs(slope / degrees - 1.0) < 0.5:
        alternatives["omega is in degrees per second"] = 0.0
    in_world, in_frd = attitude[_rows_of_comparison(log)].apply(rate), rate * (1.0, -1.0, -1.0)
    alternatives["omega is in world axes"] = rms_of_vectors(in_world - measured) / size
    alternatives["omega is in axes x forward, y right, z down"] = rms_of_vectors(in_frd - measured) / size
    best = min(alternatives, key=lambda text: alternatives[text])
    guess = "check order, direction, axes and units of both"
    if alternatives[best] < 0.6 * miss:
        guess = f"it looks as if {best}"
    raise DataError(
        f"{log.path}: attitude (q_x, q_y, q_z, q_w) and omega contradict each other by {miss:.0%} of their size; "
        f"{guess}; correct the columns or declare it in a mapping file"
    )


def _check_resting_gyro(log: FlightLog, size: float) -> None:
    """Refuse a gyro, with RMS ``size`` [rad/s], that certainly shows less than half of the attitude's turning."""
    for one in _low_gyro_gains(log):
        raise DataError(
            f"{log.path}: omega is at rest ({size:.2g} rad/s RMS) while the attitude turns ({one.motion:.2g} rad/s RMS); "
            "leave the inertial sensors out, or give a log in which they flew along"
        )


def _check_gyro_axes(log: FlightLog) -> None:
    """Refuse a gyro with an axis that certainly shows less than half of the attitude's turning about it."""
    for one in _low_gyro_gains(log, by_axis=True):
        raise DataError(
            f"{log.path}: omega_{one.axis} shows {one.gain:.2f} ± {one.half_width(0.975):.2f} of the attitude's turning "
            f"({one.motion:.2g} rad/s RMS), must be 1; correct the column, or leave the gyro out"
        )


def _low_gyro_gains(log: FlightLog, *, by_axis: bool = False) -> list[SensorGain]:
    """Return the gains of the gyro that are certainly below ``LEAST_GAIN``."""
    gains = gains_of_moving_sensors(log, by_axis=by_axis)
    return [one for one in gains if one.sensor == "gyro" and one.gain + one.half_width(SURE_GAIN) < LEAST_GAIN]


def _check_gravity(log: FlightLog, attitude: Rotation) -> None:
    """Check that the mean specific force in world axes is about +g on z, apart from the mean acceleration."""
    if log.specific_force is None:
        return
    mean = attitude.apply(log.specific_force).mean(axis=0)
    norm = float(np.linalg.norm(log.specific_force, axis=1).mean())
    body_z = float(log.specific_force[:, 2].mean())
    if 0.5 * STANDARD_GRAVITY < mean[2] < 2.0 * STANDARD_GRAVITY:
        if body_z > 0.0:
            return
        raise DataError(
            f"{log.path}: acc_z is {body_z:.2f} m/s² on average, though acc and attitude agree on what is up; it looks as if "
            "body axes are x forward, y right, z down: give body_frame: frd in a mapping file"
        )
    start = f"{log.path}: mean specific force (acc_x, acc_y, acc_z) in world axes is {np.round(mean, 2).tolist()} m/s²"
    rule = "a flight has about [0, 0, +9.81]"
    for text, read in READINGS.items():
        other = Rotation.from_quat(read(log.attitude)).apply(log.specific_force).mean(axis=0)
        if body_z > 0.0 and 0.8 * STANDARD_GRAVITY < other[2] < 1.2 * STANDARD_GRAVITY:
            raise DataError(f"{start}, {rule}; it looks as if {text}; reorder the columns q_x, q_y, q_z, q_w")
    if 0.8 < norm < 1.5:
        guess = "it looks like multiples of g: multiply by 9.81, or give unit: g in a mapping file"
    elif np.linalg.norm(mean) < 0.25 * STANDARD_GRAVITY:
        guess = "gravity was taken out: log the accelerometer itself, which reads +9.81 on z at hover"
    elif mean[2] < 0.0 and body_z > 0.0:
        guess = "it looks as if world axes are north, east, down: give world_frame: ned in a mapping file"
    elif mean[2] < 0.0:
        rule_of_sign = "gravity has the wrong sign: an accelerometer reads +9.81 on z at hover with z up"
        guess = f"{rule_of_sign}; {_remedy_for_inverted_gravity(log, attitude)}"
    else:
        guess = "check unit and axes of acc and the order of the quaternion"
    raise DataError(f"{start}, {rule}; {guess}")


def _remedy_for_inverted_gravity(log: FlightLog, attitude: Rotation) -> str:
    """Return the remedy for gravity that is negative in body and world axes: if both have z down, velocity rises with acc."""
    both = "give body_frame: frd and world_frame: ned in a mapping file"
    if log.lin_vel is None:
        return f"if only its signs are inverted, invert them; if body and world axes have z down, {both}"
    assert log.specific_force is not None
    motion = _lowpass_compared_rows(log.lin_vel, log, derivative=True)
    felt = _lowpass_compared_rows(attitude.apply(log.specific_force), log) + AT_REST
    return f"body and world axes have z down: {both}" if np.sum(felt * motion) > 0.0 else "invert the signs of acc"


def _check_velocity_against_position(log: FlightLog, attitude: Rotation) -> None:
    """Compare velocity with the derivative of position."""
    if log.lin_vel is None or log.position is None:
        return
    velocity = _lowpass_compared_rows(log.lin_vel, log)
    derived = _lowpass_compared_rows(log.position, log, derivative=True)
    size = max(rms_of_vectors(velocity), rms_of_vectors(derived))
    if size < QUIET_SPEED or (miss := rms_of_vectors(velocity - derived) / size) < WORST_AGREEMENT:
        return
    turned = _lowpass_compared_rows(attitude.apply(log.lin_vel), log)
    guess = "check units and axes of both"
    if rms_of_vectors(turned - derived) < 0.5 * miss * size:
        guess = "it looks as if v is in body axes: turn it into world axes"
    raise DataError(
        f"{log.path}: velocity (v_x, v_y, v_z) and the derivative of position (p_x, p_y, p_z) differ by {miss:.0%} of "
        f"their size; {guess}"
    )


def _check_force_frame(log: FlightLog, attitude: Rotation) -> None:
    """Refuse an accelerometer in world axes, by the motion or else by thrust, and velocities in other world axes."""
    if log.specific_force is None:
        return
    as_body = _lowpass_compared_rows(attitude.apply(log.specific_force), log)
    as_world = _lowpass_compared_rows(log.specific_force, log)
    if log.lin_vel is None and log.position is None:
        across = _lowpass_compared_rows(attitude.inv().apply(log.specific_force), log)
        size, turned_size = (rms_of_vectors(one[:, :2]) for one in (as_world, across))
        is_world, motion = size > LEAST_ACROSS and turned_size < 0.3 * size, "thrust"
    else:
        world = _acceleration_from_motion(log) + AT_REST
        pairs = ((as_body, as_world), (as_world, world), (as_body, world))
        difference, of_world, of_body = (rms_of_vectors(one - other) for one, other in pairs)
        is_world, motion = difference > 0.5 and of_world < 0.4 * of_body, "the motion"
    if is_world:
        raise DataError(
            f"{log.path}: specific force (acc_x, acc_y, acc_z) agrees with {motion} in world axes, not in body axes; "
            "turn it into body axes with the inverse of the attitude"
        )
    if log.lin_vel is not None or log.position is not None:
        _check_motion_frame(log, attitude, as_body - AT_REST)


def _acceleration_from_motion(log: FlightLog, velocity: Array | None = None) -> Array:
    """Return the acceleration [m/s²], (T, 3), from ``velocity``, the logged velocity or else the position."""
    if velocity is None:
        velocity = log.lin_vel
    if velocity is None:
        assert log.position is not None
        velocity = lowpass(log.position, sample_rate(log), CHECK_BANDWIDTH_HZ, derivative=True)
    return _lowpass_compared_rows(velocity, log, derivative=True)


def _check_motion_frame(log: FlightLog, attitude: Rotation, felt: Array) -> None:
    """Compare the accelerometer in world axes without gravity, (T, 3), with the derivative of velocity or position, (T, 3)."""
    motion = _acceleration_from_motion(log)
    if order := permutation_of_horizontal_axes(log):
        raise DataError(
            f"{log.path}: acc contradicts velocity and attitude; it looks as if x and y of the body are {order}; reorder the "
            "columns or declare it in a mapping file"
        )
    size = max(rms_of_vectors(motion), rms_of_vectors(felt))
    miss = rms_of_vectors(motion - felt) / max(size, QUIET_FORCE)
    if miss < WORST_AGREEMENT:
        return
    alternatives = {
        "world axes there are north, east, down": motion[:, [1, 0, 2]] * (1.0, 1.0, -1.0),
        "z is down there": motion * (1.0, 1.0, -1.0),
    }
    if log.lin_vel is not None:
        alternatives["v is in body axes"] = _acceleration_from_motion(log, attitude.apply(log.lin_vel))
    across = motion[:, 0] * felt[:, 1] - motion[:, 1] * felt[:, 0]
    angle = float(np.arctan2(across.sum(), (motion[:, :2] * felt[:, :2]).sum()))
    way = f"x and y there must be turned by {np.degrees(angle):.0f} deg about z to be those of the attitude"
    alternatives[way] = Rotation.from_euler("z", angle).apply(motion)
    misses = {text: rms_of_vectors(other - felt) / size for text, other in alternatives.items()}
    assert log.specific_force is not None
    angles = attitude.as_euler("ZYX")
    for name, signs in MIRRORS.items():
        turned = Rotation.from_euler("ZYX", angles * signs).apply(log.specific_force)
        other = _lowpass_compared_rows(turned, log) - AT_REST
        misses[f"the {name} of the attitude has the wrong sign"] = rms_of_vectors(motion - other) / size
    best = min(misses, key=lambda text: misses[text])
    if misses[best] < 0.5 * miss:
        name = "position (p_x, p_y, p_z)" if log.lin_vel is None else "velocity (v_x, v_y, v_z)"
        raise DataError(
            f"{log.path}: {name} contradicts acc and attitude by {miss:.0%} of the acceleration; it looks as if {best}; "
            "correct the columns or declare it in a mapping file"
        )
