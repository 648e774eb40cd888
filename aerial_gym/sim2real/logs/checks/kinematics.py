"""Estimate bias, misalignment and delay of gyro and accelerometer from attitude and velocity.

The comparison is pure kinematics, without mass, thrust or drag. Its results concern sensors, not the model.
Letters: T rows, B blocks.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import product

import numpy as np
from scipy.spatial.transform import Rotation

from aerial_gym.sim2real.arrays import Array
from aerial_gym.sim2real.findings import Finding
from aerial_gym.sim2real.json_values import select_fields
from aerial_gym.sim2real.logs.recording import AT_REST, LATE_S, FlightLog, sample_rate, take_rows
from aerial_gym.sim2real.logs.signals import lowpass, num_edge_rows, turns_over_rows
from aerial_gym.sim2real.statistics import student_quantile

CHECK_BANDWIDTH_HZ = 4.0  # Low-pass frequency of the comparison [Hz], below the limits of all logs
WORST_AGREEMENT = 0.7  # Largest relative difference between two measurements of the same quantity
BLOCK_S = 0.5  # Length of blocks [s] whose residuals count as independent

ALL_MOTION = (0.0, CHECK_BANDWIDTH_HZ)
SLOW_AND_FAST = ((0.0, 1.0), (1.0, CHECK_BANDWIDTH_HZ))
"""Bands [Hz] in which an error of a sensor is the same; errors of a filtered attitude and of stamps are not."""

FEWEST_BLOCKS = 8
BETTER = 0.4  # Other axes are probable if their residual (rms) is less than this share of that of the logged ones

QUIET = {"gyro": 0.1, "accelerometer": 0.3, "velocity": 0.3}
"""Least RMS motion [rad/s], [m/s²], [m/s] that shows a gain, angles and a delay; a bias needs none."""

MATERIAL = {"gyro": 0.01, "accelerometer": 0.1, "misalignment": np.radians(1.0), "clock": 0.002, "gain": 0.02}
"""Smallest bias [rad/s], [m/s²], angle [rad], delay [s] and relative error of a gain that are reported."""


@dataclass(frozen=True, kw_only=True)
class ImuErrors:
    """Errors of one sensor: ``measured(t) = (I - [angle]x) motion(t - delay) + bias``."""

    sensor: str  # gyro, accelerometer or velocity
    bias: Array  # [rad/s] or [m/s²], body axes, (3,)
    angle: Array  # Rotation of the sensor's axes against the body's [rad], (3,)
    delay: float  # Delay of the sensor's clock behind that of attitude or velocity [s]
    half_width: Array  # Half widths of the 95 % intervals of bias, angle and delay, (7,); infinite if not observable

    def findings(self) -> list[Finding]:
        """Return findings on significant and material errors; unobservable axes have half width None."""
        unit, notes = {"gyro": "rad_s", "accelerometer": "m_s2"}[self.sensor], []
        sure = np.abs(np.concatenate((self.bias, self.angle, [self.delay]))) > self.half_width

        def half_widths(part: slice, scale: float = 1.0) -> list[float | None]:
            return [scale * value if np.isfinite(value) else None for value in self.half_width[part].tolist()]

        def append_finding(code: str, **values: object) -> None:
            notes.append(Finding(code, "", {"sensor": self.sensor, **values}))

        if np.any(sure[:3] & (np.abs(self.bias) > MATERIAL[self.sensor])):
            bias = {f"bias_{unit}": self.bias.tolist(), f"half_width_{unit}": half_widths(slice(0, 3))}
            append_finding("sensor_bias", **bias)
        if np.any(sure[3:6] & (np.abs(self.angle) > MATERIAL["misalignment"])):
            angle = np.degrees(self.angle).tolist()
            append_finding(
                "sensor_turned", angle_deg=angle, half_width_deg=half_widths(slice(3, 6), float(np.degrees(1.0)))
            )
        if sure[6] and abs(self.delay) > MATERIAL["clock"]:
            append_finding("sensor_late", late_ms=1e3 * self.delay, half_width_ms=1e3 * float(self.half_width[6]))
        return notes


def imu_errors_from_kinematics(log: FlightLog) -> list[ImuErrors]:
    """Return the errors of gyro and accelerometer against attitude rate and gravity plus acceleration, in body axes."""
    rate = sample_rate(log)
    fits = [
        fit_sensor_errors(one, measured, motion, level, rate)
        for one, _, measured, motion, level in _readings_and_motions_by_other_sensors(log)
    ]
    return [errors for errors in fits if errors is not None]


@dataclass(frozen=True, kw_only=True)
class SensorGain:
    """Share of the motion of another sensor that a sensor shows: 1 for a sound one, 0 at rest, -1 with the wrong sign."""

    sensor: str  # gyro or accelerometer
    axis: str  # x, y or z of the body; empty for all axes together
    other: str  # attitude or velocity
    gain: float
    std: float  # Standard deviation of the gain
    freedom: int  # Degrees of freedom of that deviation
    motion: float  # RMS of the motion by the other sensor [rad/s], [m/s²]

    def half_width(self, probability: float) -> float:
        """Return the distance of the gain from a one-sided limit of this probability."""
        return float(student_quantile(probability, self.freedom)) * self.std


def gains_of_moving_sensors(
    log: FlightLog, *, by_axis: bool = False, band: tuple[float, float] = ALL_MOTION
) -> list[SensorGain]:
    """Return the gains ``<m a> / <a a'>`` of sensors, or of their axes, that move enough in a band [Hz], for readings m.

    The motions a and a' are of even and odd rows, whose noise is independent (instrumental variables: Carroll et al. 2006,
    Measurement Error in Nonlinear Models, chapter 6).
    """
    even_rows, odd_rows = (take_rows(log, slice(k, log.time.size // 2 * 2, 2)) for k in (0, 1))
    rate, results = sample_rate(even_rows), list[SensorGain]()
    edge, size = edge_of_band(rate, band), block_rows(rate, band)
    inner = slice(edge, -edge)
    for pair in zip(
        _readings_and_motions_by_other_sensors(even_rows), _readings_and_motions_by_other_sensors(odd_rows), strict=True
    ):
        (sensor, other, measured, motion, level), (*_, next_motion, _) = pair
        shown, even, odd = (in_band(one - level, rate, band) for one in (measured, motion, next_motion))
        near, far = odd + np.roll(odd, 1, axis=0), np.roll(odd, -1, axis=0) + np.roll(odd, 2, axis=0)
        odd = (9.0 * near - far) / 16.0  # at the even rows, by a cubic
        starts = np.arange(0, len(shown[inner]), size)
        if starts.size <= FEWEST_BLOCKS:
            continue
        shown, even, odd = (one[inner] - one[inner].mean(axis=0) for one in (shown, even, odd))
        products = (0.5 * shown * (even + odd), even * odd)
        along, square = (np.add.reduceat(one, starts) for one in products)
        for axis, own in {"x": [0], "y": [1], "z": [2]}.items() if by_axis else [("", [0, 1, 2])]:
            moved = float(np.sqrt(max(square[:, own].sum(), 0.0) / len(shown)))
            if moved >= QUIET[sensor]:
                gain, std = gain_of_blocks(along[:, own].sum(axis=1), square[:, own].sum(axis=1))
                size_and_scatter = {"gain": gain, "std": std, "freedom": starts.size - 1, "motion": moved}
                results.append(SensorGain(sensor=sensor, axis=axis, other=other, **size_and_scatter))
    return results


def gains_on_gravity(log: FlightLog) -> list[SensorGain]:
    """Return the gain of the mean vertical specific force on gravity plus the change of velocity, for any rate of velocity.

    It holds in each flight, but a bias of the accelerometer looks like a gain.
    """
    if log.specific_force is None or log.lin_vel is None:
        return []
    starts = np.arange(0, log.time.size - 1, max(1, round(BLOCK_S * sample_rate(log))))
    if starts.size <= FEWEST_BLOCKS:
        return []
    force = Rotation.from_quat(log.attitude).apply(log.specific_force)[:, 2]
    means = np.add.reduceat(0.5 * (force[1:] + force[:-1]) * np.diff(log.time), starts[:-1])[:-1]
    times, gained = (np.diff(values[starts[:-1]]) for values in (log.time, log.lin_vel[:, 2]))
    gain, std = gain_of_blocks(means, gained + AT_REST[2] * times)
    about = {"sensor": "accelerometer", "axis": "z", "other": "velocity", "motion": float(AT_REST[2])}
    return [SensorGain(**about, gain=gain, std=std, freedom=times.size - 1)]


def _upper_end(rate: float, band: tuple[float, float]) -> float:
    return min(band[1], 0.2 * rate)


def in_band(values: Array, rate: float, band: tuple[float, float], *, derivative: bool = False) -> Array:
    """Return values (T, any), or their derivative, in a band [Hz] that begins at 0 or above."""
    upper = lowpass(values, rate, _upper_end(rate, band), derivative=derivative)
    return upper - lowpass(values, rate, band[0], derivative=derivative) if band[0] else upper


def edge_of_band(rate: float, band: tuple[float, float]) -> int:
    """Return the number of rows at each end that a filter of ``in_band`` spoils."""
    return num_edge_rows(rate, min(filter(None, (band[0], _upper_end(rate, band)))))


def block_rows(rate: float, band: tuple[float, float]) -> int:
    """Return the number of rows of a block, ``BLOCK_S`` for the whole band of the checks and longer for slower motion."""
    return max(1, round(BLOCK_S * rate * CHECK_BANDWIDTH_HZ / band[1]))


def gain_of_blocks(along: Array, square: Array) -> tuple[float, float]:
    """Return a gain and its standard deviation from the sums over independent blocks of products and of squares, (B,)."""
    gain = float(along.sum() / square.sum())
    return gain, float(np.sqrt(np.var(along - gain * square, ddof=1) * along.size) / abs(square.sum()))


def permutation_of_horizontal_axes(log: FlightLog) -> str:
    """Return signs and order of the accelerometer's x and y that fit the motion far better than those logged, or nothing."""
    for sensor, _, measured, motion, _ in _readings_and_motions_by_other_sensors(log):
        if sensor != "accelerometer":
            continue
        rate = sample_rate(log)
        inner = slice(num_edge_rows(rate, CHECK_BANDWIDTH_HZ), -num_edge_rows(rate, CHECK_BANDWIDTH_HZ))
        shown, moved = (lowpass(one[:, :2], rate, CHECK_BANDWIDTH_HZ)[inner] for one in (measured, motion))
        shown, moved = (one - one.mean(axis=0) for one in (shown, moved))
        left = {
            f"({'-' * (a < 0)}acc_{'xy'[i]}, {'-' * (b < 0)}acc_{'xy'[1 - i]})": float(
                np.sum((moved - shown[:, [i, 1 - i]] * (a, b)) ** 2)
            )
            for i, a, b in product((0, 1), (1, -1), (1, -1))
        }
        best, as_logged = min(left, key=left.__getitem__), left["(acc_x, acc_y)"]
        return best if left[best] < BETTER**2 * as_logged else ""
    return ""


def findings_on_sensors_at_rest(log: FlightLog) -> list[Finding]:
    """Return findings on gyro and accelerometer whose gain on the motion of attitude and velocity may be 0, but not 1."""
    pairs = [(one, one.half_width(0.975)) for one in gains_of_moving_sensors(log)]
    return [
        Finding("sensor_at_rest", "", {**select_fields(one, "sensor", "other", "gain"), "half_width": half_width})
        for one, half_width in pairs
        if abs(one.gain) <= half_width < abs(1.0 - one.gain)
    ]


def findings_on_gains(log: FlightLog) -> list[Finding]:
    """Return a finding on each gain on the motion of another sensor that certainly differs from 1.

    They are those of all axes of the gyro, but of the accelerometer's z alone: a little tilt spoils x and y.
    """
    names = {("gyro", axis): f"omega_{axis}" for axis in "xyz"} | {("accelerometer", "z"): "acc_z"}
    gains = [one for one in gains_of_moving_sensors(log, by_axis=True) if (one.sensor, one.axis) in names]
    if not any(one.sensor == "accelerometer" and one.half_width(0.975) < MATERIAL["gain"] for one in gains):
        gains = [one for one in gains if one.sensor != "accelerometer"] + gains_on_gravity(log)
    pairs = [(one, one.half_width(0.975)) for one in gains]
    return [
        Finding(
            "sensor_gain",
            "",
            {
                "column": names[one.sensor, one.axis],
                "other": one.other,
                "gain_ratio": one.gain,
                "half_width_ratio": half_width,
            },
        )
        for one, half_width in pairs
        if abs(one.gain - 1.0) - half_width > MATERIAL["gain"]
    ]


def rate_by_differences(attitude: Array, rate: float) -> Array:
    """Return the angular velocity [rad/s], body, (T, 3), by central differences of an attitude (T, 4) at a rate [Hz]."""
    inner = turns_over_rows(attitude, 2) * (0.5 * rate)
    return np.concatenate((inner[:1], inner, inner[-1:]))


def _readings_and_motions_by_other_sensors(log: FlightLog) -> Iterator[tuple[str, str, Array, Array, Array]]:
    """Yield sensor, other sensor, values of the sensor, the motion that the other one shows, and the motion at hover."""
    rate, turn = sample_rate(log), Rotation.from_quat(log.attitude)
    if log.ang_vel is not None:
        mean = np.concatenate((log.ang_vel[:1], log.ang_vel, log.ang_vel[-1:]))
        mean = (mean[:-2] + 4.0 * mean[1:-1] + mean[2:]) / 6.0  # over the span of the differences, by Simpson's rule
        yield "gyro", "attitude", mean, rate_by_differences(log.attitude, rate), np.zeros(3)
    if log.specific_force is not None and log.lin_vel is not None:
        change = lowpass(log.lin_vel, rate, 2.0 * CHECK_BANDWIDTH_HZ, derivative=True)
        motion = turn.apply(change + AT_REST, inverse=True)
        yield "accelerometer", "velocity", log.specific_force, motion, AT_REST


def fit_sensor_errors(
    sensor: str, measured: Array, motion: Array, level: Array, rate: float, *, own_change: Array | None = None,
    band: tuple[float, float] = ALL_MOTION,
) -> ImuErrors | None:  # fmt: skip
    """Return the fitted errors of a sensor; None if the log is too short.

    Args:
        sensor: gyro, accelerometer or velocity.
        measured: Readings, (T, 3).
        motion: The same quantity by another sensor, (T, 3).
        level: The motion at hover, (3,).
        rate: Rows per second [Hz].
        own_change: Derivative of the readings in axes whose clock they may lag by some ``LATE_S``, (T, 3); None: no lag.
        band: Lowest and highest frequency of the comparison [Hz].
    """
    slow, rise = in_band(motion, rate, band), in_band(motion, rate, band, derivative=True)
    edge = edge_of_band(rate, band)
    inner = slice(edge, -edge)
    left = (in_band(measured, rate, band) - slow)[inner]
    slow, rise = slow[inner], rise[inner]
    blocks = np.arange(len(left)) // block_rows(rate, band)
    if len(left) < 1 or blocks[-1] + 1 < FEWEST_BLOCKS:
        return None
    # -[angle]x m = m x angle, so that row i of the regressor is d(m x angle)_i / d angle.
    x, y, z = slow.T
    zero = np.zeros_like(x)
    turned = np.stack((zero, -z, y, z, zero, -x, -y, x, zero), axis=1).reshape(-1, 3, 3)
    shifted = -rise[:, :, None]
    still = np.broadcast_to(np.eye(3), (len(left), 3, 3))
    causes = np.concatenate((still, turned, shifted), axis=2)
    # An angle is observable only with motion across its axis, a delay only with motion that varies.
    across = np.sqrt(np.mean(np.sum(turned**2, axis=1), axis=0))
    moving = float(np.sqrt(np.mean(np.sum((slow - level) ** 2, axis=1)))) > QUIET[sensor]
    shown = np.flatnonzero(np.concatenate((np.ones(3), (across > QUIET[sensor]) & moving, [moving])))
    causes = causes[:, :, shown]
    if own_change is not None:
        causes = np.concatenate((causes, -in_band(own_change, rate, band)[inner, :, None]), axis=2)
    product = np.einsum("tik,til->kl", causes, causes)
    if own_change is not None:  # prior of the lag, against noise with ``rate / 2 f`` rows per independent sample
        noise = np.mean((left - causes @ (np.linalg.pinv(product) @ np.einsum("tik,ti->k", causes, left))) ** 2)
        product[-1, -1] += noise * rate / (2.0 * _upper_end(rate, band)) / (2.0 * LATE_S**2)
    bread = np.linalg.pinv(product)
    gains = bread @ np.einsum("tik,ti->k", causes, left)
    scores = np.einsum("tik,ti->tk", causes, left - causes @ gains)
    sums = np.stack([np.bincount(blocks, weights=column) for column in scores.T], axis=1)
    count = len(sums)
    variance = np.diag(bread @ (sums.T @ sums) @ bread) * count / max(count - gains.size, 1)
    spread = np.sqrt(np.maximum(variance, 0.0))
    values, half_width = np.zeros(7), np.full(7, np.inf)
    values[shown] = gains[: shown.size]
    half_width[shown] = (student_quantile(0.975, max(count - gains.size, 1)) * spread)[: shown.size]
    return ImuErrors(sensor=sensor, bias=values[:3], angle=values[3:6], delay=float(values[6]), half_width=half_width)
