"""Signs, scales and delays of the sensors of a log, by kinematics alone, and the log without these errors."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.integrate import trapezoid
from scipy.spatial.transform import Rotation

from aerial_gym.config.sim import STANDARD_GRAVITY
from aerial_gym.sim2real.findings import Finding
from aerial_gym.sim2real.logs.checks.kinematics import (
    SLOW_AND_FAST,
    SensorGain,
    gains_of_moving_sensors,
    gains_on_gravity,
)
from aerial_gym.sim2real.logs.recording import FlightLog
from aerial_gym.sim2real.logs.stream_delays import StreamDelay, stream_delays, stream_later
from aerial_gym.sim2real.preflight.constants import CONTRADICTED, TOLERANCES, Constant, pool
from aerial_gym.sim2real.statistics import Estimate

Delays = Mapping[str, StreamDelay]

SLOWEST_HZ = 50.0  # Straight lines between slower samples of gyro or attitude lose 2 % of a turning at 4 Hz
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
    slow = any(not log.torques or _slowest_rate(log) < SLOWEST_HZ for log in even)
    bands = [
        [gain for log in even for gain in gains_of_moving_sensors(log, by_axis=True, band=band)]
        for band in SLOW_AND_FAST
    ]
    scales = [_gyro_scale(axis, [[], []] if slow else bands, slow) for axis in "xyz"]
    scales.append(_accelerometer_scale(even))
    corrected = [_with_gravity(_without_scales(log, scales)) for log in even]
    return SensorStage(logs=tuple(corrected), constants=(*scales, *delays), findings=tuple(findings))


def _slowest_rate(log: FlightLog) -> float:
    return min(log.streams[name].rate if name in log.streams else np.inf for name in ("attitude", "ang_vel"))


def _gain_of_axis(gains: Sequence[SensorGain], sensor: str, axis: str, *, scatter: bool = True) -> Estimate | None:
    own = [one for one in gains if (one.sensor, one.axis) == (sensor, axis)]
    return pool([Estimate.from_half_width(one.gain, one.half_width(0.975)) for one in own], scatter=scatter)


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
    each = [[stream_delays(log, band) for log in logs] for band in SLOW_AND_FAST]
    constants, moves = list[Constant](), dict[str, float]()
    for name in STATE:
        if all(getattr(log, name) is None for log in logs):
            continue
        delay = _delay_of_position(each) if name == "position" else _delay_of_stream(each, name)
        moves[name] = 0.0 if delay is None else delay.value
        constants.append(Constant(
            name=f"{name}_latency", kind="state_latency", declared=0.0, unit="s", estimate=delay, reason="delay_not_shown",
            setting="the observation delay_steps of the task", new=moves[name], tied=("clock_offset",), remedy="one_clock",
        ))  # fmt: skip
    moved = [replace(log, **{n: stream_later(log, n, s) for n, s in moves.items() if s}) for log in logs]
    return moved, constants


def _delay_of_stream(bands: Sequence[Sequence[Delays]], name: str) -> Estimate | None:
    """Return the delay of a stream by slow and fast motion, which an attitude's errors delay differently; None without both."""
    parts = [
        [Estimate.from_half_width(one[name].delay, one[name].half_width) for one in part if name in one]
        for part in bands
    ]
    return pool([one for part in parts for one in part]) if all(parts) else None


def _delay_of_position(bands: Sequence[Sequence[Delays]]) -> Estimate | None:
    """Return the delay of the position: its delay behind the velocity, and that of the velocity."""
    velocity = _delay_of_stream(bands, "lin_vel")
    pairs = [(one["position"], one["lin_vel"]) for part in bands for one in part if "position" in one]
    if velocity is None or not pairs:
        return None
    behind = pool(
        [
            Estimate.from_half_width(p.delay - v.delay, np.sqrt(max(p.half_width**2 - v.half_width**2, 0.0)))
            for p, v in pairs
        ]
    )
    if behind is None:  # both of one topic
        return velocity
    width = float(np.hypot(velocity.high - velocity.low, behind.high - behind.low))
    return Estimate.from_half_width(velocity.value + behind.value, 0.5 * width)


def _gyro_scale(axis: str, bands: Sequence[Sequence[SensorGain]], slow: bool) -> Constant:
    """Return the scale of the gyro; about x and y its interval has those by slow and by fast motion.

    A scale is the same in both. A filtered attitude follows the gyro in fast motion, and errs by accelerations in slow motion.
    """
    gain = _gain_of_axis([one for part in bands for one in part], "gyro", axis)
    parts = [_gain_of_axis(part, "gyro", axis, scatter=False) for part in bands]
    if gain is not None and axis != "z":
        ends = [end for one in (gain, *parts) if one is not None for end in (one.low, one.high)]
        gain = None if None in parts else replace(gain, low=min(ends), high=max(ends))
    return Constant(
        name=f"gyro_scale_{axis}", kind="gyro_scale", declared=1.0, estimate=gain,
        reason="slow_attitude" if slow else "little_turning",
        setting=f"the factor of the gyro about {axis}", new=None if gain is None else 1.0 / gain.value,
        tied=("attitude_scale",), remedy="turn_by_known_angle",
    )  # fmt: skip


def _accelerometer_scale(logs: Sequence[FlightLog]) -> Constant:
    """Return the scale along z by climbs; without climbs by gravity, where a bias looks the same."""
    gains = [gain for log in logs for gain in gains_of_moving_sensors(log, by_axis=True)]
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
