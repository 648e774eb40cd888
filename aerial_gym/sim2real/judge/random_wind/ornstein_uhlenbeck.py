"""An Ornstein-Uhlenbeck process with white noise, fitted to series of wind, and tests against other processes.

The fit has maximum likelihood. Its covariance is that of the low-passed process plus white noise along each axis, about an
unknown mean of each flight and axis. All axes share one process, or the vertical axis has its own intensity and correlation
time, as wind near the ground; it has where that is significantly more probable.
Letters: F flights, T rows, S series (one axis of one flight), P features.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from itertools import combinations
from math import log

import numpy as np
from scipy import optimize
from scipy.linalg import block_diag

from aerial_gym.sim2real.arrays import Array
from aerial_gym.sim2real.logs.signals import lowpass_gain
from aerial_gym.sim2real.statistics import chi_square_tail, normal_tail

LAGS = 20  # Number of lags in the autocorrelation test of the innovations
LINES = 300  # Number of frequencies in the integral over the power that the low-pass removes
NUDGE = 1e-6  # Difference step of the logarithms of parameters
CORR_TIMES = (0.05, 100.0)  # Bounds of the fitted correlation time [s]
VERTICAL = (
    0.05,
    20.0,
)  # Bounds of intensity and correlation time of the vertical axis, relative to those of the horizontal
SIGNIFICANCE = 0.001  # Largest p-value of one process for all axes at which the vertical has its own


Whitening = Callable[[Array, int], Array]  # Function of columns (T, any) of a flight, and of an axis


@dataclass(frozen=True, kw_only=True)
class WindSeries:
    """The wind that would cause the residual, at time steps at which the noise is white."""

    wind: list[Array]  # Wind of each flight [m/s], world, (T, 3)
    features: dict[str, list[Array]]  # Quantities that gusts do not depend on, by name, of each flight, (T, P)
    offsets: list[Array] = field(default_factory=list)
    """Wind that an offset of the force along each body axis would seem, of each flight, (T, 3, 3); empty without offsets."""

    step: float  # Time between rows [s]
    bandwidth: float  # Bandwidth of the comparison [Hz]

    def select(self, flights: Sequence[int]) -> "WindSeries":
        """Return the series of some flights."""
        features = {name: [parts[k] for k in flights] for name, parts in self.features.items()}
        offsets = [self.offsets[k] for k in flights] if self.offsets else []
        return replace(self, wind=[self.wind[k] for k in flights], offsets=offsets, features=features)


def covariance_of_filtered_process(corr_time: float, bandwidth: float, lags: Array) -> Array:
    """Return the covariance of a low-passed Ornstein-Uhlenbeck process of unit variance at some lags [s].

    It is ``exp(-t / T) - int 4 T (1 - H²) cos(2 pi f t) / (1 + (2 pi f T)²) df``, with H the gain of the low-pass.
    Source: Uhlenbeck, Ornstein (1930), On the theory of the Brownian motion, with the theorem of Wiener and Khinchin.
    """
    last = 10.0
    frequency = (np.arange(LINES) + 0.5) * (last * bandwidth / LINES)
    density = 4.0 * corr_time / (1.0 + (2.0 * np.pi * frequency * corr_time) ** 2)
    taken = density * (1.0 - lowpass_gain(frequency, bandwidth) ** 2) * (last * bandwidth / LINES)
    near = lags * bandwidth <= 10.0  # the integral is 0 beyond; the sum over lines repeats after 30
    covariance = np.exp(-lags / corr_time)
    covariance[near] -= np.cos(2.0 * np.pi * np.outer(lags[near], frequency)) @ taken
    covariance[lags == 0.0] -= 1.0 - 2.0 / np.pi * np.arctan(2.0 * np.pi * last * bandwidth * corr_time)
    return covariance


@dataclass(frozen=True, kw_only=True)
class ProcessFit:
    """A fitted process with noise."""

    std: float
    corr_time: float
    noise: Array  # White noise of each axis [m/s], (3,)
    likelihood: float  # Restricted log likelihood, with the means of the series integrated out
    vertical: tuple[float, ...] = ()  # Relative std and correlation time of the vertical axis; empty if it has no own

    gain: float = 0.0
    """Log likelihood that a vertical axis of its own gains, less half the logarithm of the rows for each of its parameters.

    Source: Schwarz (1978), Estimating the dimension of a model, Annals of Statistics 6.
    """

    def process(self, std: float) -> "Process":
        """Return the process with another standard deviation."""
        return (std, self.corr_time, self.noise, *([self.vertical] if self.vertical else []))


Process = (
    tuple  # Standard deviation, correlation time [s], noise of each axis (3,), and perhaps ``ProcessFit.vertical``
)


def log_likelihoods(series: WindSeries, processes: Sequence[Process], *, axes: Sequence[int] = (0, 1, 2)) -> Array:
    """Return the restricted log likelihood of all series along some axes under each of some processes."""
    rows = np.array([len(wind) for wind in series.wind])
    values = np.zeros((len(axes), rows.max(), len(rows) + 1))
    values[..., -1] = 1.0  # of the mean
    for flight, wind in enumerate(series.wind):
        values[:, : len(wind), flight] = wind.T[list(axes)]
    covariance = np.stack(
        [axis_covariances(series, *process)[list(axes)] for process in processes]
    )  # (processes, axes, T)
    white, variance = whiten_rows(covariance, values)
    white, one = white[..., :-1], white[..., -1:]
    inside = np.arange(len(values[0]))[:, None] < rows
    mean, weight = ((one * part * inside).sum(axis=2) for part in (white, one))
    left = (white**2 * inside).sum(axis=2) - mean**2 / weight + np.log(weight)
    return -0.5 * (left + (np.log(variance)[..., None] * inside).sum(axis=2)).sum(axis=(1, 2))


def axis_covariances(
    series: WindSeries, std: float, corr_time: float, noise: Array, vertical: Sequence[float] = ()
) -> Array:
    """Return the covariance of process and noise along each axis at every lag, (3, T)."""
    lags = series.step * np.arange(max(len(wind) for wind in series.wind))
    results = np.tile(std**2 * covariance_of_filtered_process(corr_time, series.bandwidth, lags), (3, 1))
    if vertical:
        size, time = vertical
        results[2] = (size * std) ** 2 * covariance_of_filtered_process(time * corr_time, series.bandwidth, lags)
    results[:, 0] += noise**2
    return results


def whiten_rows(covariance: Array, values: Array) -> tuple[Array, Array]:
    """Return the one-step prediction errors divided by their std, (..., T, K), and their variances, (..., T).

    Args:
        covariance: Covariance of stationary processes at each lag, (..., T).
        values: Columns (..., T, K) of such processes.

    Source:
        Durbin (1960), The fitting of time-series models, Review of the International Statistical Institute 28. The result
        equals whitening by a Cholesky factor of the covariance, in T steps of T numbers for all columns.
    """
    rows = covariance.shape[-1]
    error, variance = np.empty((*covariance.shape, values.shape[-1])), np.empty_like(covariance)
    error[..., 0, :], variance[..., 0] = values[..., 0, :], covariance[..., 0]
    later = np.zeros((*covariance.shape[:-1], 0))  # coefficients of the rows before, the earliest first
    for row in range(1, rows):
        short = covariance[..., row] - (later * covariance[..., 1:row]).sum(axis=-1)
        partial = (short / variance[..., row - 1])[..., None]
        later = np.concatenate((partial, later - partial * later[..., ::-1]), axis=-1)
        error[..., row, :] = values[..., row, :] - (later[..., None, :] @ values[..., :row, :])[..., 0, :]
        variance[..., row] = variance[..., row - 1] * (1.0 - partial[..., 0] ** 2)
    return error / np.sqrt(variance)[..., None], variance


def fit_process(series: WindSeries) -> ProcessFit:
    """Return the process of maximum likelihood, with the noise of each axis, and with its own vertical axis if significant."""
    jump = np.sqrt(np.mean([np.mean(np.diff(wind, axis=0) ** 2, axis=0) for wind in series.wind], axis=0) / 2.0)
    size = np.sqrt(np.mean([wind.var(axis=0).mean() for wind in series.wind]))
    low = [1e-3 * size, CORR_TIMES[0], *(0.03 * jump)]
    high = [30.0 * size, CORR_TIMES[1], *(3.0 * jump)]
    common = _fit_in_bounds(series, np.array([size, 1.0, *(0.5 * jump)]), low, high)
    ends = [[*bound, end, end] for bound, end in zip((low, high), VERTICAL, strict=True)]
    free = _fit_in_bounds(series, np.array([common.std, common.corr_time, *common.noise, 1.0, 1.0]), *ends)
    gain = free.likelihood - common.likelihood
    cost = log(sum(map(len, series.wind)))  # two parameters
    return replace(free if chi_square_tail(2.0 * gain, 2) < SIGNIFICANCE else common, gain=gain - cost)


def _fit_in_bounds(series: WindSeries, start: Array, low: Sequence[float], high: Sequence[float]) -> ProcessFit:
    """Return the process of maximum likelihood, from std, correlation time, noise and perhaps the vertical axis."""

    def cost_and_slope(values: Array) -> tuple[float, Array]:
        costs = _negative_log_likelihoods(series, [values, *(values + NUDGE * np.eye(values.size))])
        return float(costs[0]), (costs[1:] - costs[0]) / NUDGE

    bounds, options = list(zip(np.log(low), np.log(high), strict=True)), {"ftol": 1e-8}
    first = np.clip(np.log(start), np.log(low), np.log(high))
    results = optimize.minimize(cost_and_slope, first, jac=True, method="L-BFGS-B", bounds=bounds, options=options)
    std, corr_time, noise, *vertical = _process_of_logarithms(results.x)
    more = {"vertical": vertical[0]} if vertical else {}
    return ProcessFit(std=std, corr_time=corr_time, noise=noise, likelihood=-float(results.fun), **more)


def _process_of_logarithms(values: Array) -> Process:
    std, corr_time, *rest = np.exp(values).tolist()
    return std, corr_time, np.array(rest[:3]), *([tuple(rest[3:])] if rest[3:] else [])


def _negative_log_likelihoods(series: WindSeries, points: Sequence[Array]) -> Array:
    """Return the negative log likelihood at logarithms of std, correlation time, noise and perhaps the vertical axis."""
    return -log_likelihoods(series, [_process_of_logarithms(one) for one in points])


def std_of_logarithms(series: WindSeries, fit: ProcessFit) -> tuple[float, ...]:
    """Return the standard deviations of the logarithms of std, corr_time and ``vertical``, by the likelihood's curvature."""
    centre = np.log(np.array([fit.std, fit.corr_time, *fit.noise, *fit.vertical]))
    step, size = 0.02 * np.eye(centre.size), centre.size
    pairs = list(combinations(range(size), 2))
    away = [*(step[i] for i in range(size)), *(step[i] + step[j] for i, j in pairs)]
    here, *costs = _negative_log_likelihoods(
        series, [centre, *(centre + one for one in away), *(centre - one for one in away)]
    )
    both = np.add(*np.split(np.array(costs), 2)) - 2.0 * here
    curvature = np.diag(both[:size]) / 0.02**2
    for (i, j), mixed in zip(pairs, both[size:], strict=True):
        curvature[i, j] = curvature[j, i] = (mixed - both[i] - both[j]) / (2.0 * 0.02**2)
    variance = np.diag(np.linalg.pinv(curvature, hermitian=True))[[0, 1, *range(5, size)]]
    return tuple(np.sqrt(np.maximum(variance, 0.0)).tolist())


def p_value_of_noise(series: WindSeries, fit: ProcessFit) -> float:
    """Return the p-value of the process against white noise alone along each axis, by the likelihood ratio."""
    rows = sum(len(wind) - 1 for wind in series.wind)
    squares = np.sum([((wind - wind.mean(axis=0)) ** 2).sum(axis=0) for wind in series.wind], axis=0)
    alone = float(log_likelihoods(series, [(0.0, 1.0, np.sqrt(squares / rows))])[0])
    return chi_square_tail(2.0 * (fit.likelihood - alone), 2 + len(fit.vertical))


def p_values_of_rivals(series: WindSeries, fit: ProcessFit) -> dict[str, float]:
    """Return a p-value for each other process: the probability that gusts resemble it as closely by chance."""
    innovations, whiten = compute_innovations(series, fit)
    return {
        "memory": p_value_of_autocorrelation(innovations),
        "line": p_value_of_spectral_line(innovations),
        "shape": p_value_of_kurtosis(innovations),
        "axes": p_value_of_unequal_std(series, fit, "axes"),
        "flights": p_value_of_unequal_std(series, fit, "flights"),
        **p_values_of_features(series, innovations, whiten),
    }


def compute_innovations(series: WindSeries, fit: ProcessFit) -> tuple[list[Array], Whitening]:
    """Return the whitened wind of each flight without its mean, (T, 3), and a function that whitens columns alike."""
    covariance = axis_covariances(series, *fit.process(fit.std))

    def subtract_mean(values: Array, axis: int) -> Array:
        white, _ = whiten_rows(covariance[axis, : len(values)], np.column_stack((values, np.ones(len(values)))))
        white, mean = white[:, :-1], white[:, -1]
        return white - np.outer(mean, mean @ white) / (mean @ mean)

    innovations = [
        np.column_stack([subtract_mean(wind[:, axis : axis + 1], axis) for axis in range(3)]) for wind in series.wind
    ]
    return innovations, subtract_mean


def p_value_of_autocorrelation(innovations: Sequence[Array]) -> float:
    """Return the p-value of the autocorrelation over ``LAGS`` lags, summed over all series.

    The sum is tested, as the statistic of one series of a hundred rows exceeds a chi² too often.
    Source: Ljung, Box (1978), On a measure of lack of fit, eq. 1.3; for the mean under noise: Moran (1948), Biometrika 35.
    """
    lag = np.arange(1, LAGS + 1)
    total, variance = np.zeros(LAGS), np.zeros(LAGS)
    for part in innovations:
        rows = len(part)
        centre = -(rows - lag) / (rows * (rows - 1.0))
        for column in part.T:
            lagged = np.array([column[k:] @ column[:-k] for k in lag]) / (column @ column)
            total += rows * (lagged - centre)
            variance += rows * (rows - lag) / (rows + 2.0)
    return chi_square_tail((total**2 / variance).sum(), LAGS - 2)


def p_value_of_spectral_line(innovations: Sequence[Array]) -> float:
    """Return the p-value of the highest line of the summed spectrum; twice each sum is chi² with 2 S degrees of freedom.

    Source: Fisher (1929), Tests of significance in harmonic analysis, for many series of known variance.
    """
    rows = min(len(part) for part in innovations)
    spectra = [np.abs(np.fft.rfft(part[:rows], axis=0)[1:-1]) ** 2 / (rows * part.var(axis=0)) for part in innovations]
    lines = np.concatenate(spectra, axis=1)
    highest = chi_square_tail(2.0 * lines.sum(axis=1).max(), 2 * lines.shape[1])
    return float(-np.expm1(len(lines) * np.log1p(-min(highest, 1.0 - 1e-16))))


def p_value_of_kurtosis(innovations: Sequence[Array]) -> float:
    """Return the p-value of the excess kurtosis, which has the variance 24 / n for n normal numbers."""
    both = np.concatenate([(part / part.std(axis=0)).ravel() for part in innovations])
    return 2.0 * normal_tail(abs(np.mean(both**4) - 3.0) / np.sqrt(24.0 / both.size))


def p_value_of_unequal_std(series: WindSeries, fit: ProcessFit, between: str) -> float:
    """Return the p-value of the likelihood ratio of a separate std for each axis, or each flight, over a common one.

    A vertical axis of its own is not among the axes.
    """
    if between == "axes":
        parts = [(series, (axis,)) for axis in range(2 if fit.vertical else 3)]
    else:
        parts = [(replace(series, wind=[wind]), (0, 1, 2)) for wind in series.wind]
    if len(parts) < 2:
        return 1.0
    centre, gained = float(np.log(fit.std)), 0.0
    for part, axes in parts:

        def cost(value: float, part: WindSeries = part, axes: tuple[int, ...] = axes) -> float:
            return -float(log_likelihoods(part, [fit.process(float(np.exp(value)))], axes=axes)[0])

        best = optimize.fminbound(cost, centre - 4.0, centre + 2.0, xtol=0.01)
        gained += cost(centre) - cost(float(np.asarray(best)))
    return chi_square_tail(2.0 * gained, len(parts) - 1)


def p_values_of_features(series: WindSeries, innovations: Sequence[Array], whiten: Whitening) -> dict[str, float]:
    """Return the p-value of the variance that each group of features explains beside the offsets of each flight.

    Coefficients differ between axes, but not between flights. An offset of the force, such as a warming accelerometer, is
    constant in body axes, so that in world axes it follows the attitude.
    """
    std = np.sqrt(np.mean(np.concatenate(innovations) ** 2, axis=0))
    axes = range(std.size)
    offsets = [
        np.linalg.qr(np.concatenate([whiten(own[:, axis], axis) / std[axis] for axis in axes]))[0]
        for own in series.offsets or [np.zeros((len(part), 3, 0)) for part in innovations]
    ]

    def without_offsets(columns: Array, basis: Array) -> Array:
        return columns - basis @ (basis.T @ columns)

    y = np.concatenate([without_offsets((e / std).T.ravel(), q) for e, q in zip(innovations, offsets, strict=True)])
    results = {}
    for name, features in series.features.items():
        parts = [np.asarray(block_diag(*(whiten(own, axis) / std[axis] for axis in axes))) for own in features]
        x = np.concatenate([without_offsets(part, q) for part, q in zip(parts, offsets, strict=True)])
        left, values, _ = np.linalg.svd(x / np.maximum(np.linalg.norm(x, axis=0), 1e-300), full_matrices=False)
        kept = left[:, values > 1e-6]
        results[name] = chi_square_tail(float(((kept.T @ y) ** 2).sum()), kept.shape[1])
    return results
