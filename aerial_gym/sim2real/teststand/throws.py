"""Inertia of a body that was thrown by hand while a flywheel of known inertia turned on it.

In free flight the angular momentum about the centre of mass stays constant in world axes, except for air drag:

    R (J w + j W n) = h + R-turned sum of drag,   drag = -D |w| w.

R turns body axes into the axes at the release and is the integrated gyro; J is the inertia of all that was thrown, with the
wheel at rest; j, W and n are the wheel's inertia, speed and axis. The equation is linear in J, D, the tilt of n and the time by
which W is logged late. Means over ``BLOCK_S`` are compared with the means before, so that neither noise nor unmodelled torques
add up over the flight. Several bodies that were thrown with one wheel share its tilt and its lateness.
The accelerometer then gives the position of the IMU: in free flight it reads ``w' x r + w x (w x r)``.

Letters: T samples, B blocks. Axes are those of the IMU, as the log's reader gives them.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import accumulate

import numpy as np
from scipy.ndimage import binary_dilation
from scipy.optimize import lsq_linear
from scipy.signal import butter, sosfiltfilt
from scipy.spatial.transform import Rotation

from aerial_gym.errors import DataError
from aerial_gym.sim2real.arrays import Array, Flags, true_spans
from aerial_gym.sim2real.teststand.statistics import hac_covariance

BLOCK_S = 0.04  # Length of the blocks whose mean momentum is compared [s]
SMOOTHING_HZ = 40.0  # Band of the accelerations from which the position of the IMU is found
SLOWEST_WHEEL = 0.08  # Wheel speeds below this share of the largest one are not measured well
EDGE_S = 0.03  # Samples at both ends of a free flight that are left out [s]
HEAVIEST = (
    3.0  # Largest typical reading that the spin does not explain [m/s²]: between 1 by drag at 5 m/s and 9.8 if held
)
GYRO_RANGES_DEG_S = (
    2000.0,
    4000.0,
)  # Of the gyros on flight controllers. Source: data sheets of MPU-6000, BMI270, ICM-45686
NEAR_END = 0.015  # Largest distance from the end of the range, relative to it, by which calibration moves it
FEWEST_SURPLUS = 6  # Least surplus of equations over unknowns, of whose scatter the intervals are made
TILTS = 8  # Corrections of the wheel's axis, whose first estimate knows no drag; each leaves the square of its tilt
CONCENTRATIONS = 10  # Steps of the trimmed fit; it settles in some five
PAIRS = ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2))  # Order of the elements of an inertia matrix


@dataclass(frozen=True, kw_only=True)
class FreeFlight:
    """Samples of one throw between release and catch."""

    name: str
    time: Array  # [s], (T,)
    ang_vel: Array  # [rad/s], (T, 3)
    specific_force: Array  # [m/s²], (T, 3)
    wheel_speed: Array  # [rad/s], along the wheel's axis, (T,)
    saturated: Flags | None = None  # Samples at and near the end of the gyro's range, (T,); None: none

    @property
    def spans(self) -> list[tuple[int, int]]:
        """First and last sample of each part without saturation."""
        return [(0, self.time.size)] if self.saturated is None else true_spans(~self.saturated)


@dataclass(frozen=True, kw_only=True)
class WheelFit:
    """What the flights say about the flywheel."""

    axis: Array  # Unit vector along its positive speed, (3,)
    lateness: float  # Time by which its speed is logged after the gyro [s]


@dataclass(frozen=True, kw_only=True)
class MomentumFit:
    """Inertia of everything that was thrown, for a wheel inertia of 1."""

    inertia: Array  # About the centre of mass, per wheel inertia, (3, 3)
    covariance: Array  # Of its elements in the order of ``PAIRS``, (6, 6)
    imu_position: Array  # Of the IMU from the centre of mass [m], (3,)
    residual: float  # RMS of the unexplained change of momentum, as a share of the wheel's


def cross_matrices(vectors: Array) -> Array:
    """Return the matrices that multiply as cross products from the left, (T, 3, 3)."""
    x, y, z = vectors.T
    zero = np.zeros_like(x)
    return np.stack((zero, -z, y, z, zero, -x, -y, x, zero), axis=1).reshape(-1, 3, 3)


def acceleration_matrices(time: Array, ang_vel: Array) -> Array:
    """Return ``[w'] + [w]²``, which turns a position into the acceleration of that point, (T, 3, 3)."""
    rate = sample_rate_of_times(time)
    smooth = lowpass_filter(ang_vel, rate)
    turn = cross_matrices(smooth)
    return cross_matrices(np.gradient(smooth, 1.0 / rate, axis=0)) + turn @ turn


def sample_rate_of_times(time: Array) -> float:
    """Return the mean sample rate [Hz]."""
    return float((time.size - 1) / (time[-1] - time[0]))


def lowpass_filter(values: Array, rate: float) -> Array:
    """Return values (T, any) below ``SMOOTHING_HZ`` without delay."""
    return sosfiltfilt(butter(2, min(SMOOTHING_HZ, 0.4 * rate), fs=rate, output="sos"), values, axis=0)


def find_free_flight(flight: FreeFlight) -> FreeFlight:
    """Return the samples of free flight.

    It is the longest span in which the wheel has begun to turn and the accelerometer reads the motion of one point of a body in
    free flight: hands and the ground push, air hardly does. Where the gyro saturates, nothing tells this.
    """
    speed = np.abs(flight.wheel_speed)
    rate = sample_rate_of_times(flight.time)
    edge = round(EDGE_S * rate)
    turning = np.flatnonzero(speed > 0.5 * speed.max())
    if speed.max() <= 0.0 or turning.size < 5 * edge:
        raise DataError(
            f"{flight.name}: the flywheel does not turn long enough; throw with a wheel that spins up in flight"
        )
    force, matrices = lowpass_filter(flight.specific_force, rate), acceleration_matrices(flight.time, flight.ang_vel)
    core = slice(turning[0], turning[-1])
    saturated = np.asarray(binary_dilation(is_gyro_saturated(flight.ang_vel), np.ones(edge + 1)), dtype=np.bool_)
    known = np.flatnonzero(~saturated[core]) + turning[0]
    if known.size < edge:
        raise DataError(f"{flight.name}: the gyro reaches the end of its range all the time; throw with less spin")
    residual = np.linalg.norm(force - matrices @ _position_of_most_rows(matrices[known], force[known]), axis=1)
    if (typical := float(np.median(residual[known]))) > HEAVIEST:
        raise DataError(
            f"{flight.name}: is no throw: while the wheel turns, the accelerometer reads {typical:.1f} m/s² that the spin does "
            "not explain, and 0 in free flight; let the wheel spin up in the air, with nothing but the wheel turning"
        )
    free = (residual < 5.0 * np.median(residual[known]) + 0.3) | saturated
    free &= np.arange(speed.size) >= np.argmax(speed > SLOWEST_WHEEL * speed.max())
    first, last = max(true_spans(free), key=lambda span: span[1] - span[0], default=(0, 0))
    rows = slice(first + edge, max(last - edge, first + edge))
    if (seconds := np.sum(~saturated[rows]) / rate) < 5.0 * BLOCK_S:
        raise DataError(
            f"{flight.name}: only {seconds:.2f} s of free flight in which the gyro does not saturate; throw higher, 0.3 s are "
            "enough, and with less spin if the gyro reaches its end"
        )
    names = ("time", "ang_vel", "specific_force", "wheel_speed")
    samples = {name: getattr(flight, name)[rows] for name in names}
    return FreeFlight(name=flight.name, **samples, saturated=saturated[rows] if saturated[rows].any() else None)


def _position_of_most_rows(matrices: Array, force: Array) -> Array:
    """Return the position [m], (3,), that explains the best half of the readings, as hands may hold the body in others.

    Least trimmed squares by concentration. Source: Rousseeuw, Van Driessen (2006), Computing LTS regression for large data
    sets.
    """
    kept = np.ones(len(force), dtype=bool)
    for _ in range(CONCENTRATIONS):
        position = np.linalg.lstsq(matrices[kept].reshape(-1, 3), force[kept].reshape(-1), rcond=None)[0]
        residual = np.linalg.norm(force - matrices @ position, axis=1)
        kept = residual <= np.median(residual)
    return position


def is_gyro_saturated(ang_vel: Array) -> Flags:
    """Return the rows in which a rate is at the end of a gyro's range, (T,): within ``NEAR_END`` of it, and none beyond."""
    ends = np.radians(GYRO_RANGES_DEG_S)
    largest = np.abs(ang_vel).max(axis=0)
    end = ends[np.argmin(np.abs(np.log(np.maximum(largest, 1e-9)[:, None] / ends)), axis=1)]
    at_end = np.abs(largest / end - 1.0) < NEAR_END
    return np.any(at_end & (np.abs(ang_vel) > (1.0 - NEAR_END) * end), axis=1)


@dataclass(frozen=True, kw_only=True)
class MomentumChanges:
    """Terms of the change of momentum from block to block, for a wheel inertia of 1."""

    body: Array  # By the elements of the inertia, and by drag about each axis, (B, 3, 9)
    wheel: Array  # By the components of the wheel's axis, (B, 3, 3)
    lateness: Array  # The same for the change of the wheel's speed per second, (B, 3, 3)


def momentum_changes(flight: FreeFlight) -> MomentumChanges:
    """Return the terms of the momentum of one flight, as changes between blocks of its parts without saturation."""
    rate = sample_rate_of_times(flight.time)
    acceleration = np.gradient(lowpass_filter(flight.wheel_speed, rate), flight.time)
    long = [slice(*span) for span in flight.spans if span[1] - span[0] >= 2 * max(round(BLOCK_S * rate), 1)]
    parts = [
        _changes_of_part(*(one[rows] for one in (flight.time, flight.ang_vel, flight.wheel_speed, acceleration)))
        for rows in long
    ]
    names = ("body", "wheel", "lateness")
    return MomentumChanges(**{name: np.concatenate([getattr(part, name) for part in parts]) for name in names})


def _changes_of_part(time: Array, rates: Array, speed: Array, acceleration: Array) -> MomentumChanges:
    rate, steps = sample_rate_of_times(time), np.diff(time)
    turns = Rotation.from_rotvec(0.5 * (rates[1:] + rates[:-1]) * steps[:, None]).as_matrix()
    axes = np.array([*accumulate(turns, np.matmul, initial=np.eye(3))])
    elements = np.zeros((time.size, 3, 6))
    for column, (i, j) in enumerate(PAIRS):
        elements[:, i, column] += rates[:, j]
        elements[:, j, column] += rates[:, i] if i != j else 0.0
    drag = axes * (np.linalg.norm(rates, axis=1)[:, None] * rates)[:, None, :]
    lost = np.concatenate((np.zeros((1, 3, 3)), np.cumsum(0.5 * (drag[1:] + drag[:-1]) * steps[:, None, None], axis=0)))
    size = max(round(BLOCK_S * rate), 1)
    count = time.size // size
    terms = (
        np.concatenate((axes @ elements, lost), axis=2),
        axes * speed[:, None, None],
        axes * acceleration[:, None, None],
    )
    means = (term[: count * size].reshape(count, size, 3, -1).mean(axis=1) for term in terms)
    body, wheel, late = (np.diff(mean, axis=0) for mean in means)
    return MomentumChanges(body=body, wheel=wheel, lateness=late)


def fit_momentum(bodies: Sequence[Sequence[FreeFlight]]) -> tuple[WheelFit, list[MomentumFit]]:
    """Return the wheel's axis, and the inertia of each body, thrown any number of times, that keep the momentum."""
    changes = [(body, momentum_changes(flight)) for body, flights in enumerate(bodies) for flight in flights]
    owner = np.concatenate([np.full(3 * len(change.body), body) for body, change in changes])
    own = np.concatenate([change.body.reshape(-1, 9) for _, change in changes])
    columns = np.concatenate([own * (owner == body)[:, None] for body in range(len(bodies))], axis=1)
    wheel, late = (
        np.concatenate([getattr(change, name).reshape(-1, 3) for _, change in changes])
        for name in ("wheel", "lateness")
    )
    if len(columns) < columns.shape[1] + 3 + FEWEST_SURPLUS:
        names = ", ".join(flight.name for flights in bodies for flight in flights)
        raise DataError(
            f"{names}: {len(columns) // 3} changes of momentum for {columns.shape[1] + 3} unknowns, and "
            f"{(columns.shape[1] + 3 + FEWEST_SURPLUS) // 3} are needed; throw higher or more often, with a gyro below its end"
        )
    axis, unbounded = _wheel_axis(columns, wheel), np.full(3, -np.inf)
    low = np.concatenate((*len(bodies) * (np.append(np.repeat(unbounded, 2), np.zeros(3)),), unbounded))
    for _ in range(TILTS):
        across = np.linalg.svd(axis[None])[2][1:]
        matrix, target = np.concatenate((columns, wheel @ across.T, late @ axis[:, None]), axis=1), -wheel @ axis
        scale = np.sqrt((matrix * matrix).mean(axis=0))
        fit = lsq_linear(matrix / scale, target, (low, np.inf))
        params, residual = fit.x / scale, target - matrix @ (fit.x / scale)
        tilted = axis + params[-3:-1] @ across
        axis = tilted / np.linalg.norm(tilted)  # the wheel's inertia of 1 belongs to a unit axis
    free = fit.active_mask == 0
    covariance = np.zeros((scale.size, scale.size))
    covariance[np.ix_(free, free)] = hac_covariance(np.asarray(matrix[:, free], dtype=np.float64), residual)
    fits = []
    for body, flights in enumerate(bodies):
        part, rows = slice(9 * body, 9 * body + 6), owner == body
        share = float(np.sqrt(np.mean(residual[rows] ** 2) / np.mean(target[rows] ** 2)))
        more = {"imu_position": fit_imu_position(flights), "residual": share}
        fits.append(MomentumFit(inertia=matrix_of_elements(params[part]), covariance=covariance[part, part], **more))
    return WheelFit(axis=axis, lateness=float(params[-1])), fits


def _wheel_axis(columns: Array, wheel: Array) -> Array:
    """Return the unit axis, (3,), that balances the body's momentum best, with the sign that makes inertias positive."""
    inertial = columns[:, np.arange(columns.shape[1]) % 9 < 6]  # drag is no part of it
    basis = np.linalg.qr(inertial / np.sqrt((inertial * inertial).mean(axis=0)))[0]
    rest = wheel - basis @ (basis.T @ wheel)
    axis = np.linalg.svd(rest, full_matrices=False)[2][-1]
    inertia = matrix_of_elements(np.linalg.lstsq(inertial, -wheel @ axis, rcond=None)[0][:6])
    return axis if np.trace(inertia) > 0.0 else -axis


def matrix_of_elements(elements: Array) -> Array:
    """Return the symmetric matrix (3, 3) of elements (6,) in the order of ``PAIRS``."""
    matrix = np.empty((3, 3))
    for value, (i, j) in zip(elements, PAIRS, strict=True):
        matrix[i, j] = matrix[j, i] = value
    return matrix


def fit_imu_position(flights: Sequence[FreeFlight]) -> Array:
    """Return the position of the IMU from the centre of mass [m], (3,)."""
    matrices, forces = [], []
    for flight in flights:
        rate = sample_rate_of_times(flight.time)
        known = slice(None) if flight.saturated is None else ~flight.saturated
        matrices.append(acceleration_matrices(flight.time, flight.ang_vel)[known].reshape(-1, 3))
        forces.append(lowpass_filter(flight.specific_force, rate)[known].reshape(-1))
    return np.linalg.lstsq(np.concatenate(matrices), np.concatenate(forces), rcond=None)[0]


def steiner_term(mass: float, position: Array) -> Array:
    """Return the inertia of a point mass at a position, (3, 3)."""
    return mass * (position @ position * np.eye(3) - np.outer(position, position))
