"""An Ornstein-Uhlenbeck process with white noise, fitted to series of wind, and what such series must not look like.

By maximum likelihood: the covariance of the process below the band of the comparison, plus white noise along each axis, about
an unknown mean of each flight and axis. Letters: F flights, T rows, S series (one axis of one flight), P features.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy import optimize, stats
from scipy.linalg import cholesky, solve_triangular, toeplitz

from aerial_gym.sim2real.logs.signals import lowpass_gain

Array = NDArray[np.float64]

LAGS = 20
"""Innovations are held against each other over so many samples."""

LINES = 300
"""Frequencies of the integral over what a low-pass takes away."""

CORR_TIMES = (0.05, 100.0)
"""Correlation times that are tried [s]."""


@dataclass(frozen=True, kw_only=True)
class Series:
    """The wind that would make the residual, at steps long enough for the noise to be white."""

    wind: list[Array]
    """Of each flight [m/s], world, (T, 3)."""

    features: dict[str, list[Array]]
    """What gusts do not depend on, by name, of each flight, (T, P)."""

    step: float
    """Between rows [s]."""

    bandwidth: float
    """[Hz]."""


def process_covariance(corr_time: float, bandwidth: float, lags: Array) -> Array:
    """Return the covariance of a low-passed Ornstein-Uhlenbeck process of unit variance at some lags [s].

    ``exp(-t / T)`` less what the low-pass of gain H takes away, ``int 4 T (1 - H²) cos(2 pi f t) / (1 + (2 pi f T)²) df``.
    Source: Uhlenbeck, Ornstein (1930), On the theory of the Brownian motion, with the theorem of Wiener and Khinchin.
    """
    last = 10.0
    frequency = (np.arange(LINES) + 0.5) * (last * bandwidth / LINES)
    density = 4.0 * corr_time / (1.0 + (2.0 * np.pi * frequency * corr_time) ** 2)
    taken = density * (1.0 - lowpass_gain(frequency, bandwidth) ** 2) * (last * bandwidth / LINES)
    near = lags * bandwidth <= 10.0  # further on nothing is taken, and the sum over lines would come again after 30
    covariance = np.exp(-lags / corr_time)
    covariance[near] -= np.cos(2.0 * np.pi * np.outer(lags[near], frequency)) @ taken
    covariance[lags == 0.0] -= 1.0 - 2.0 / np.pi * np.arctan(2.0 * np.pi * last * bandwidth * corr_time)
    return covariance


@dataclass(frozen=True, kw_only=True)
class ProcessFit:
    """A fitted process with noise."""

    std: float
    corr_time: float
    noise: Array
    """White noise of each axis [m/s], (3,)."""

    likelihood: float
    """Its logarithm, of the series without their means."""


def log_likelihood(
    series: Series, std: float, corr_time: float, noise: Array, *, axes: Sequence[int] = (0, 1, 2)
) -> float:
    """Return the restricted log likelihood of all series along some axes."""
    total, roots = 0.0, Roots(series, corr_time)
    for wind in series.wind:
        for axis in axes:
            root = roots.of(len(wind), std, float(noise[axis]))
            white = solve_triangular(root, np.column_stack((wind[:, axis], np.ones(len(wind)))), lower=True)
            weight = white[:, 1] @ white[:, 1]
            left = white[:, 0] @ white[:, 0] - (white[:, 1] @ white[:, 0]) ** 2 / weight
            total -= 0.5 * left + float(np.log(np.diag(root)).sum()) + 0.5 * float(np.log(weight))
    return float(total)


class Roots:
    """Lower Cholesky factors of the covariance of process and noise, each made once."""

    def __init__(self, series: Series, corr_time: float) -> None:
        rows = max(len(wind) for wind in series.wind)
        self._shape = process_covariance(corr_time, series.bandwidth, series.step * np.arange(rows))
        self._made: dict[tuple[int, float, float], Array] = {}

    def of(self, rows: int, std: float, noise: float) -> Array:
        """Return the factor for so many rows, (T, T)."""
        key = (rows, std, noise)
        if key not in self._made:
            first = std**2 * self._shape[:rows]
            first[0] += noise**2
            self._made[key] = cholesky(toeplitz(first), lower=True)
        return self._made[key]


def fit_process(series: Series) -> ProcessFit:
    """Return the process of maximum likelihood, one for all axes and flights, with the noise of each axis."""
    jump = np.sqrt(np.mean([np.mean(np.diff(wind, axis=0) ** 2, axis=0) for wind in series.wind], axis=0) / 2.0)
    size = np.sqrt(np.mean([wind.var(axis=0).mean() for wind in series.wind]))
    low = np.log(np.array([1e-3 * size, CORR_TIMES[0], *(0.03 * jump)]))
    high = np.log(np.array([30.0 * size, CORR_TIMES[1], *(3.0 * jump)]))

    def cost(values: Array) -> float:
        std, corr_time, *noise = np.exp(values)
        return -log_likelihood(series, std, corr_time, np.array(noise))

    start = np.log(np.array([size, 1.0, *(0.5 * jump)]))
    bounds = list(zip(low, high, strict=True))
    found = optimize.minimize(cost, start, method="L-BFGS-B", bounds=bounds, options={"ftol": 1e-8}).x
    std, corr_time, *noise = np.exp(found)
    return ProcessFit(std=float(std), corr_time=float(corr_time), noise=np.array(noise), likelihood=-cost(found))


def log_spread(series: Series, fit: ProcessFit) -> tuple[float, float]:
    """Return the standard deviation of log std and log corr_time, from the curvature of the likelihood."""
    centre = np.log(np.array([fit.std, fit.corr_time, *fit.noise]))

    def cost(values: Array) -> float:
        std, corr_time, *noise = np.exp(values)
        return -log_likelihood(series, std, corr_time, np.array(noise))

    step, size = 0.02 * np.eye(centre.size), centre.size
    curvature = np.empty((size, size))
    here, single = cost(centre), [(cost(centre + step[i]), cost(centre - step[i])) for i in range(size)]
    for i in range(size):
        curvature[i, i] = (single[i][0] + single[i][1] - 2.0 * here) / 0.02**2
        for j in range(i):
            both = cost(centre + step[i] + step[j]) + cost(centre - step[i] - step[j])
            mixed = both - sum(single[i]) - sum(single[j]) + 2.0 * here
            curvature[i, j] = curvature[j, i] = mixed / (2.0 * 0.02**2)
    variance = np.diag(np.linalg.pinv(curvature, hermitian=True))[:2]
    return float(np.sqrt(max(variance[0], 0.0))), float(np.sqrt(max(variance[1], 0.0)))


def p_value_of_noise(series: Series, fit: ProcessFit) -> float:
    """Return the probability that white noise along each axis alone has such a likelihood ratio."""
    rows = sum(len(wind) - 1 for wind in series.wind)
    squares = np.sum([((wind - wind.mean(axis=0)) ** 2).sum(axis=0) for wind in series.wind], axis=0)
    alone = log_likelihood(series, 0.0, 1.0, np.sqrt(squares / rows))
    return float(stats.chi2.sf(2.0 * (fit.likelihood - alone), 2))


def p_values_of_rivals(series: Series, fit: ProcessFit) -> dict[str, float]:
    """Return what the wind must not be, and the probability that gusts by chance look at least as much like it."""
    innovations, whiten = whitened(series, fit)
    return {
        "remembers otherwise than by one correlation time": p_value_of_memory(innovations),
        "has a line at one frequency": p_value_of_line(innovations),
        "is not distributed as a random wind": p_value_of_shape(innovations),
        "differs between the axes": p_value_of_unequal(series, fit, "axes"),
        "differs between the flights": p_value_of_unequal(series, fit, "flights"),
        **{f"follows {name}": p_value_of_following(whiten(x), innovations) for name, x in series.features.items()},
    }


def whitened(series: Series, fit: ProcessFit) -> tuple[list[Array], Callable[[list[Array]], list[list[Array]]]]:
    """Return the innovations of each flight, (T, 3), without the mean, and what makes features comparable to them."""
    roots = Roots(series, fit.corr_time)

    def centred(values: Array, flight: int, axis: int) -> Array:
        rows = len(series.wind[flight])
        root = roots.of(rows, fit.std, float(fit.noise[axis]))
        white, mean = (solve_triangular(root, part, lower=True) for part in (values, np.ones(rows)))
        return white - np.outer(mean, mean @ white) / (mean @ mean)

    def whiten(features: list[Array]) -> list[list[Array]]:
        return [[centred(x, flight, axis) for axis in range(3)] for flight, x in enumerate(features)]

    innovations = [
        np.column_stack([centred(wind[:, axis : axis + 1], flight, axis) for axis in range(3)])
        for flight, wind in enumerate(series.wind)
    ]
    return innovations, whiten


def p_value_of_memory(innovations: Sequence[Array]) -> float:
    """Return the p-value of such a mean autocorrelation of all series: each one's is that of noise without its mean.

    What all have in common counts: single series of a hundred rows stray by more than a chi² says.
    Source: Ljung, Box (1978), On a measure of lack of fit, eq. 1.3, for the mean; Moran (1948), Biometrika 35, for its centre.
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
    return float(stats.chi2.sf((total**2 / variance).sum(), LAGS - 2))


def p_value_of_line(innovations: Sequence[Array]) -> float:
    """Return the p-value of the highest line of the mean spectrum; of each line, twice the sum is chi² with 2 S degrees.

    Source: Fisher (1929), Tests of significance in harmonic analysis, for many series of known variance.
    """
    rows = min(len(part) for part in innovations)
    spectra = [np.abs(np.fft.rfft(part[:rows], axis=0)[1:-1]) ** 2 / (rows * part.var(axis=0)) for part in innovations]
    lines = np.concatenate(spectra, axis=1)
    highest = float(stats.chi2.sf(2.0 * lines.sum(axis=1).max(), 2 * lines.shape[1]))
    return float(-np.expm1(len(lines) * np.log1p(-min(highest, 1.0 - 1e-16))))


def p_value_of_shape(innovations: Sequence[Array]) -> float:
    """Return the p-value of such an excess kurtosis of normal numbers: of variance 24 / n."""
    both = np.concatenate([(part / part.std(axis=0)).ravel() for part in innovations])
    return float(2.0 * stats.norm.sf(abs(np.mean(both**4) - 3.0) / np.sqrt(24.0 / both.size)))


def p_value_of_unequal(series: Series, fit: ProcessFit, between: str) -> float:
    """Return the p-value of the likelihood ratio of a std for each axis, or for each flight, over one for all."""
    if between == "axes":
        parts = [(series, (axis,)) for axis in range(3)]
    else:
        parts = [(replace(series, wind=[wind]), (0, 1, 2)) for wind in series.wind]
    if len(parts) < 2:
        return 1.0
    centre, gained = float(np.log(fit.std)), 0.0
    for part, axes in parts:

        def cost(value: float, part: Series = part, axes: tuple[int, ...] = axes) -> float:
            return -log_likelihood(part, float(np.exp(value)), fit.corr_time, fit.noise, axes=axes)

        best = optimize.fminbound(cost, centre - 4.0, centre + 2.0, xtol=0.01)
        gained += cost(centre) - cost(float(np.asarray(best)))
    return float(stats.chi2.sf(2.0 * gained, len(parts) - 1))


def p_value_of_following(features: list[list[Array]], innovations: Sequence[Array]) -> float:
    """Return the p-value of what features explain: along each axis with the same coefficients in all flights."""
    explained, freedom = 0.0, 0
    for axis in range(3):
        x = np.concatenate([part[axis] for part in features])
        y = np.concatenate([part[:, axis] for part in innovations])
        x = x / np.maximum(np.linalg.norm(x, axis=0), 1e-300)
        left, values, _ = np.linalg.svd(x, full_matrices=False)
        kept = left[:, values > 1e-6]
        explained += float(((kept.T @ y) ** 2).sum()) / float(y.var())
        freedom += kept.shape[1]
    return float(stats.chi2.sf(explained, freedom))
