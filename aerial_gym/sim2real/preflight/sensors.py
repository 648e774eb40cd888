"""Signs, scales and delays of the sensors of a log, by kinematics alone, and the log without these errors."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.integrate import trapezoid
from scipy.spatial.transform import Rotation

from aerial_gym.config.sim import STANDARD_GRAVITY
from aerial_gym.sim2real.findings import Finding
from aerial_gym.sim2real.logs.checks.kinematics import SensorGain, gains_of_moving_sensors, gains_on_gravity
from aerial_gym.sim2real.logs.recording import FlightLog
from aerial_gym.sim2real.logs.stream_delays import stream_delays, stream_later
from aerial_gym.sim2real.preflight.constants import CONTRADICTED, TOLERANCES, Constant, pool
from aerial_gym.sim2real.statistics import Estimate

SLOWEST_ATTITUDE_HZ = 50.0  # Straight lines between slower samples lose 2 % of a turning at 4 Hz
STATE = ("attitude", "lin_vel", "position")  # Streams that a policy takes as its state


@dataclass(frozen=True, kw_only=True)
class SensorStage:
    """Constants and findings on the sensors, and the logs without these errors."""

    logs: tuple[FlightLog, ...]  # At equal steps, corrected
    constants: tuple[Constant, ...]
    findings: tuple[Finding, ...]


def check_sensors(logs: Sequence[FlightLog]) -> SensorStage:
    """Return the sensor errors of logs at equal steps of one vehicle, each corrected before the next ones are measured."""
    even, findings = _with_gyro_signs(logs)
    even, delays = _without_delays(even)
    gains = [gain for log in even for gain in gains_of_moving_sensors(log, by_axis=True)]
    slow = any("attitude" in log.streams and log.streams["attitude"].rate < SLOWEST_ATTITUDE_HZ for log in even)
    scales = [_gyro_scale(axis, [] if slow else gains, slow) for axis in "xyz"]
    scales.append(_accelerometer_scale(even, gains))
    corrected = [_with_gravity(_without_scales(log, scales)) for log in even]
    return SensorStage(logs=tuple(corrected), constants=(*scales, *delays), findings=tuple(findings))


def _gain_of_axis(gains: Sequence[SensorGain], sensor: str, axis: str) -> Estimate | None:
    own = [one for one in gains if (one.sensor, one.axis) == (sensor, axis)]
    return pool([Estimate.from_half_width(one.gain, one.half_width(0.975)) for one in own])


def _with_gyro_signs(logs: Sequence[FlightLog]) -> tuple[list[FlightLog], list[Finding]]:
    """Return the logs with the axes of the gyro turned round that the attitude contradicts, and a finding on each."""
    gains = [gain for log in logs for gain in gains_of_moving_sensors(log, by_axis=True)]
    signs, findings = np.ones(3), list[Finding]()
    for index, axis in enumerate("xyz"):
        gain = _gain_of_axis(gains, "gyro", axis)
        if gain is None:
            findings.append(Finding("gyro_sign_assumed", axis))
        elif gain.high < 0.0:
            signs[index] = -1.0
            findings.append(Finding("gyro_sign_contradicted", axis, {"gain_ratio": gain.value}))
        else:
            findings.append(Finding("gyro_sign_measured", axis, {"gain_ratio": gain.value}))
    turned = [log if log.ang_vel is None else replace(log, ang_vel=signs * log.ang_vel) for log in logs]
    return turned, findings


def _without_delays(logs: Sequence[FlightLog]) -> tuple[list[FlightLog], list[Constant]]:
    """Return the logs with attitude, velocity and position on the clock of the inertial sensors, and their delays."""
    each = [stream_delays(log) for log in logs]
    constants, moves = list[Constant](), dict[str, float]()
    for name in STATE:
        if all(getattr(log, name) is None for log in logs):
            continue
        delay = pool([Estimate.from_half_width(d[name].delay, d[name].half_width) for d in each if name in d])
        moves[name] = 0.0 if delay is None else delay.value
        constants.append(Constant(
            name=f"{name}_latency", kind="state_latency", declared=0.0, unit="s", estimate=delay, reason="delay_not_shown",
            setting="the observation delay_steps of the task", new=moves[name],
        ))  # fmt: skip
    moved = [replace(log, **{n: stream_later(log, n, s) for n, s in moves.items() if s}) for log in logs]
    return moved, constants


def _gyro_scale(axis: str, gains: Sequence[SensorGain], slow: bool) -> Constant:
    gain = _gain_of_axis(gains, "gyro", axis)
    return Constant(
        name=f"gyro_scale_{axis}", kind="gyro_scale", declared=1.0, estimate=gain,
        reason="slow_attitude" if slow else "little_turning",
        setting=f"the factor of the gyro about {axis}", new=None if gain is None else 1.0 / gain.value,
        tied=("attitude_scale",), remedy="turn_by_known_angle",
    )  # fmt: skip


def _accelerometer_scale(logs: Sequence[FlightLog], gains: Sequence[SensorGain]) -> Constant:
    """Return the scale along z by climbs; without climbs by gravity, where a bias looks the same."""
    gain, tied = _gain_of_axis(gains, "accelerometer", "z"), tuple[str, ...]()
    if gain is None or gain.high - gain.low > 2.0 * TOLERANCES["accelerometer_scale"]:
        still = [one for log in logs for one in gains_on_gravity(log)]
        gain, tied = _gain_of_axis(still, "accelerometer", "z"), ("accelerometer_bias",)
    return Constant(
        name="accelerometer_scale", kind="accelerometer_scale", declared=1.0, estimate=gain, reason="no_velocity",
        setting="the factor of the accelerometer", new=None if gain is None else 1.0 / gain.value, tied=tied,
        remedy="turn_accelerometer",
    )  # fmt: skip


def _without_scales(log: FlightLog, scales: Sequence[Constant]) -> FlightLog:
    """Return the log without the scales that are contradicted."""
    *turning, force = (one.estimate.value if one.estimate and one.state == CONTRADICTED else 1.0 for one in scales)
    return replace(
        log,
        ang_vel=None if log.ang_vel is None else log.ang_vel / turning,
        specific_force=None if log.specific_force is None else log.specific_force / force,
    )


def _with_gravity(log: FlightLog) -> FlightLog:
    """Return the log with the bias of the accelerometer that its mean vertical force shows, less the gain of velocity."""
    if log.specific_force is None or log.lin_vel is None:
        return log
    up = Rotation.from_quat(log.attitude).as_matrix()[:, 2]
    mean = trapezoid((up * log.specific_force).sum(axis=1), log.time) - (log.lin_vel[-1, 2] - log.lin_vel[0, 2])
    bias = (mean / np.ptp(log.time) - STANDARD_GRAVITY) / float(up[:, 2].mean())
    return replace(log, specific_force=log.specific_force - (0.0, 0.0, bias))
