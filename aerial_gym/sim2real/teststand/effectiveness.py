"""Effectiveness of rotors by least squares over flights.

Effectiveness is the angular acceleration and specific force of a rotor per unit of its input: the squared speed, or without
measured speeds the command on the firmware's thrust curve. Both sides are smoothed to ``BAND_HZ``, above which frame and
sensors vibrate, less their mean over ``MEAN_S``. Slower torques of the air would bias the result towards 0, since the flight's
own controller answers them with the rotors. Jitter of the stamps and noise of the inputs weaken the result too. So each
interval includes the results with half and with twice that time, with half the band, and of the reverse regression.

Rotors of one flight move together. So the sign of each rotor is taken from all inputs at once, but the size about an axis from
the sum of the inputs with these signs. Letters: T rows, R rotors.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.ndimage import binary_erosion, gaussian_filter1d

from aerial_gym.config.sim import STANDARD_GRAVITY
from aerial_gym.errors import DataError
from aerial_gym.sim2real.arrays import Array, Flags, Indices
from aerial_gym.sim2real.logs.on_ground import CARRIED
from aerial_gym.sim2real.logs.recording import FlightLog, sample_rate
from aerial_gym.sim2real.statistics import Estimate, student_quantile

BAND_HZ = 20.0  # Highest frequency of the regression
BAND_STD_S = float(np.sqrt(np.log(2.0)) / (2.0 * np.pi * BAND_HZ))  # Standard deviation of the smoothing window [s]
ROWS_HZ = 250.0  # Rate of the rows of the regression, some ten times its band
MEAN_S = 0.1  # Standard deviation of the Gaussian window whose mean is left out [s]; loops of attitude are slower
EDGE_S = 0.6  # Rows this near to the start or end of a flight's powered part are left out: the reach of the longest window [s]
SLOWEST = 0.1  # A rotor below this share of the largest speed or command does not carry the vehicle
MOST_TURNING = 0.5  # Largest share of turning in the rows that show the thrust [m/s²]
PARTS, FEWEST_FLIGHTS = 8, 4  # Parts that are left out in turn for intervals; each flight is one if there are so many
MODES = 4  # Patterns in which the rotors of a vehicle move: all together, roll, pitch and yaw
EVEN = 0.3  # Least relative effectiveness of the rotors of an X frame; about an axis of a + frame two have none
LEVER = 0.05  # Largest distance of the accelerometer from the centre of mass, where turning adds to its reading [m]
LEAST_SHARE = 0.33  # Least share of the felt force that rotors give in flight; air gives two thirds in a dive at most


@dataclass(frozen=True, kw_only=True)
class FlightRows:
    """Rows of one flight at ``ROWS_HZ``, smoothed to ``BAND_HZ``."""

    inputs: Array  # Input of each rotor, (T, R)
    swings: Array  # Rate of change of the speeds [rad/s²], (T, R); 0 without measured speeds
    products: Array  # Products of body rates y z, z x, x y [rad²/s²], (T, 3)
    motion: Array  # Angular acceleration [rad/s²] and specific force along z [m/s²], (T, 4)
    turning: Array  # Largest share of turning in the accelerometer's reading [m/s²], (T,)
    powered: Flags  # Rows in which the rotors carry the vehicle, (T,)
    flies: Flags  # The same away from take-off and landing, (T,)
    rate: float  # [Hz]
    force: float  # Mean norm of the specific force in these rows [m/s²]

    @property
    def seconds(self) -> float:
        """Time in the air [s]."""
        return float(self.flies.sum() / self.rate)

    def rows_in_air_less_mean(self, name: str, window: float, smoothing: float = 0.0) -> Array:
        """Return the rows in the air of a field, less their mean over a window [s], behind a further smoothing window [s]."""
        values = getattr(self, name)
        values = gaussian_filter1d(values, self.rate * smoothing, axis=0) if smoothing else values
        return (values - gaussian_filter1d(values, self.rate * window, axis=0, truncate=3.0))[self.flies]


@dataclass(frozen=True, kw_only=True)
class Effectiveness:
    """Motion per unit of input: roll, pitch and yaw acceleration, and specific force along z."""

    weights: Array  # Of each rotor about roll, pitch and yaw, relative to the largest of each axis, (3, R)
    known: Flags  # Axes whose size and sign the flights show, (3,)
    measured: Flags  # Axes whose weights are those of the flights, not of the log, (3,)
    sizes: tuple[Estimate, ...]  # Of the rotor with the largest weight about each axis; specific force of one rotor


def rows_of_flight(log: FlightLog, thrust_input: Callable[[FlightLog], Array]) -> FlightRows:
    """Return the filtered rows of a flight in which all rotors turn and the log has gyro and accelerometer."""
    if log.ang_vel is None or log.specific_force is None:
        raise DataError(
            f"{log.path}: needs a gyro, and an accelerometer or a velocity; log them, or map their columns (--mapping)"
        )
    rate, rates = sample_rate(log), log.ang_vel
    step = max(1, int(rate / ROWS_HZ))

    def smooth(values: Array) -> Array:
        return gaussian_filter1d(values, rate * BAND_STD_S, axis=0)[::step]

    def derivative(values: Array) -> Array:
        return np.gradient(values, axis=0) * rate

    inputs = thrust_input(log)
    speeds = np.zeros_like(inputs) if log.rotor_speed is None else log.rotor_speed
    felt, slow_rates = np.linalg.norm(smooth(log.specific_force), axis=1), smooth(rates)
    parts = {
        "inputs": smooth(inputs),
        "swings": smooth(derivative(speeds)),
        "products": smooth(np.stack([rates[:, j] * rates[:, k] for j, k in ((1, 2), (2, 0), (0, 1))], axis=1)),
        "motion": smooth(np.concatenate((derivative(rates), log.specific_force[:, 2:]), axis=1)),
    }
    powered = rows_under_power(parts["inputs"])
    if powered.any():
        total = parts["inputs"].sum(axis=1)
        lift = (felt * total)[powered].sum() / (total * total)[powered].sum()
        powered &= ~is_held_by_hands_or_ground(felt, lift * total, slow_rates)
    flies = without_edges(powered, rate / step)
    return FlightRows(
        **parts, turning=largest_turning_force(slow_rates), powered=powered, flies=flies, rate=rate / step,
        force=float(felt[flies].mean()) if flies.any() else 0.0,
    )  # fmt: skip


def rows_under_power(inputs: Array) -> Flags:
    """Return the rows in which all rotors turn, (T,)."""
    return (inputs > SLOWEST**2 * np.quantile(inputs, 0.99)).all(axis=1)


def without_edges(rows: Flags, rate: float) -> Flags:
    """Return the rows that are further than ``EDGE_S`` from other rows, (T,)."""
    return np.asarray(binary_erosion(rows, np.ones(2 * round(EDGE_S * rate) + 1)), dtype=np.bool_)


def fit_effectiveness(flights: Sequence[FlightRows], logged: Array | None) -> Effectiveness:
    """Return weights and sizes of the effectiveness, with intervals by leaving out parts of the flights and other windows.

    ``logged``: weights of the rotors that the log states, (3, R). For four rotors the flights may contradict them.
    """
    kept = rows_without_each_part([int(flight.flies.sum()) for flight in flights])

    def columns(window: float, smoothing: float = 0.0) -> list[Array]:
        names = ("inputs", "swings", "products", "motion")
        return [np.concatenate([f.rows_in_air_less_mean(name, window, smoothing) for f in flights]) for name in names]

    parts = columns(MEAN_S)
    inputs, swings, products, motion = parts

    def single_rotors(rows: Flags) -> Array:
        modes = np.linalg.svd(inputs[rows], full_matrices=False)[2][:MODES]  # more rotors move in four patterns at most
        table = np.concatenate((inputs[rows] @ modes.T, swings[rows] @ modes.T, products[rows]), axis=1)
        return (modes.T @ _least_squares(table, motion[rows, :3])[: len(modes)]).T

    whole, half = fit_with_jackknife_interval(single_rotors, kept)
    weights, clear, even = _weights_of_flight(whole, half)
    measured = clear
    if logged is not None:
        opposite = np.where(logged == 0.0, False, np.sign(weights) != np.sign(logged)).any(axis=1)
        measured = clear & even & opposite & (logged != 0.0).all(axis=1)
        weights = np.where(measured[:, None], weights, logged)

    def table_of_sums(parts: Sequence[Array]) -> Array:
        inputs, swings, products, _ = parts
        sums = inputs @ np.concatenate((weights, np.ones((1, inputs.shape[1])))).T
        return np.concatenate((sums, (swings @ weights[2])[:, None], products), axis=1)

    def sizes(parts: Sequence[Array]) -> Array:
        return np.diag(_least_squares(table_of_sums(parts), parts[-1])[:4])

    value, half = fit_with_jackknife_interval(lambda rows: sizes([part[rows] for part in parts]), kept)
    variants = [sizes(columns(factor * MEAN_S)) for factor in (0.5, 2.0)]
    variants.append(sizes(columns(MEAN_S, np.sqrt(3.0) * BAND_STD_S)))  # windows add by squares
    variants.append(_sizes_of_reverse_regression(table_of_sums(parts), motion, value))
    turned = np.append(np.sign(value[:3]), 1.0)  # the log states the opposite sign
    ends = turned * np.stack((value - half, value + half, *variants))
    return Effectiveness(
        weights=np.asarray(weights * turned[:3, None], dtype=np.float64),
        known=np.abs(value[:3]) > half[:3] if logged is not None else clear,
        measured=measured | ((turned[:3] < 0.0) & (np.abs(value[:3]) > half[:3])),
        sizes=tuple(Estimate(value=v, low=min(e), high=max(e)) for v, e in zip(turned * value, ends.T, strict=True)),
    )


def _sizes_of_reverse_regression(table: Array, motion: Array, sizes: Array) -> Array:
    """Return the sizes by which motion (T, 4) explains the first columns of ``table``; infinite if it does not.

    Noise of the inputs biases the usual regression towards 0, and noise of the motion this one away from it.
    Source: Frisch (1934), Statistical confluence analysis by means of complete regression systems.
    """
    shares = np.empty_like(sizes)
    for k in range(sizes.size):
        columns = np.column_stack((motion[:, k], np.delete(table, k, axis=1)))
        shares[k] = _least_squares(columns, table[:, k : k + 1])[0, 0]
    return np.where(shares * sizes > 0.0, 1.0 / np.where(shares == 0.0, 1.0, shares), np.copysign(np.inf, sizes))


def _weights_of_flight(whole: Array, half: Array) -> tuple[Array, Flags, Flags]:
    """Return the weights of the rotors by their effectiveness (3, R) with its half widths, and clear and even axes, (3,).

    An axis is even if no rotor lies near it, as yaw is: then all rotors count as equal. Else each one has to be clear about
    roll or pitch.
    """
    clear, size = np.abs(whole) > half, np.abs(whole).max(axis=1, keepdims=True)
    four, places = whole.shape[1] == 4, bool(clear[:2].any(axis=0).all())
    least = np.array((EVEN, EVEN, 0.0))[:, None]
    even = (clear & (np.abs(whole) > least * size)).all(axis=1) & np.array((four, four, True))
    known = even | np.array((places, places, False))
    return np.where(even[:, None], np.sign(whole), whole / size), known, even


@dataclass(frozen=True, kw_only=True)
class ForcePerInput:
    """Specific force along z over the sum of the rotors' inputs."""

    mean: Estimate
    lowest: float  # Of ``PARTS`` parts of the flights
    highest: float


def mean_force_per_input(flights: Sequence[FlightRows]) -> ForcePerInput:
    """Return the specific force along z over the sum of the rotors' inputs in the mean of the flights.

    Rows near take-off and landing, and those in which turning moves the accelerometer's reading by more than ``MOST_TURNING``,
    only widen the interval, unless all do.
    """
    calm = [flight.flies & (flight.turning < MOST_TURNING) for flight in flights]
    whole, pairs = _force_and_input(flights, [flight.powered for flight in flights]), _force_and_input(flights, calm)
    pairs = pairs if any(map(len, pairs)) else whole
    table = np.concatenate(pairs)

    def ratio(chosen: Flags | Indices) -> Array:
        return _ratio_of_means(table[chosen])

    value, half = fit_with_jackknife_interval(ratio, rows_without_each_part([len(pair) for pair in pairs]))
    ends = np.concatenate((value - half, value + half, _ratio_of_means(np.concatenate(whole))))
    ratios = [float(ratio(np.asarray(chunk))[0]) for chunk in np.array_split(np.arange(len(table)), PARTS)]
    mean = Estimate(value=float(value[0]), low=float(ends.min()), high=float(ends.max()))
    return ForcePerInput(mean=mean, lowest=min(ratios), highest=max(ratios))


def _force_and_input(flights: Sequence[FlightRows], rows: Sequence[Flags]) -> list[Array]:
    """Return force along z and sum of the inputs in some rows of each flight, each (rows, 2)."""
    return [np.stack((f.motion[:, 3], f.inputs.sum(axis=1)), axis=1)[r] for f, r in zip(flights, rows, strict=True)]


def _ratio_of_means(table: Array) -> Array:
    force, total = table.mean(axis=0)
    return np.atleast_1d(force / max(total, 1e-300))


def rows_without_each_part(sizes: Sequence[int]) -> list[Flags]:
    """Return the rows that remain without each flight, or without each of ``PARTS`` parts of fewer flights."""
    part = np.repeat(np.arange(len(sizes)), sizes)
    part = part if len(sizes) >= PARTS else np.arange(part.size) * PARTS // part.size
    return [part != k for k in np.unique(part)]


def _least_squares(columns: Array, targets: Array) -> Array:
    scale = np.maximum(np.sqrt((columns * columns).mean(axis=0)), 1e-300)
    return np.linalg.lstsq(columns / scale, targets, rcond=None)[0] / scale[:, None]


def fit_with_jackknife_interval(fit: Callable[[Flags], Array], kept: Sequence[Flags]) -> tuple[Array, Array]:
    """Return the fit to all rows, and the half width of its 95 % interval from fits that leave out one part each."""
    whole = fit(np.ones(kept[0].size, dtype=bool))
    return whole, jackknife_half_width([fit(rows) for rows in kept])


def jackknife_half_width(fits: Sequence[Array]) -> Array:
    """Return the half width of the 95 % interval of a fit from fits that leave out one part each."""
    parts, count = np.stack(fits), len(fits)
    deviation = np.sqrt((count - 1) / count * ((parts - parts.mean(axis=0)) ** 2).sum(axis=0))
    return float(student_quantile(0.975, count - 1)) * deviation


def is_held_by_hands_or_ground(felt: Array, lift: Array, ang_vel: Array | None) -> Flags:
    """Return the rows in which hands or ground carry a vehicle, (T,).

    Args:
        felt: Norm of the specific force [m/s²], (T,).
        lift: Specific force of the rotors [m/s²], (T,).
        ang_vel: Angular velocity [rad/s], body, (T, 3).
    """
    turning = 0.0 if ang_vel is None else largest_turning_force(ang_vel)
    return (felt - turning > CARRIED * STANDARD_GRAVITY) & (lift < LEAST_SHARE * felt)


def largest_turning_force(ang_vel: Array) -> Array:
    """Return the specific force that turning can add to an accelerometer's reading, ``LEVER w²`` [m/s²], (T,)."""
    return LEVER * (ang_vel * ang_vel).sum(axis=1)
