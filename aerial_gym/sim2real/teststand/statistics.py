"""Least squares with intervals for heteroscedastic and autocorrelated residuals.

Letters: N rows, K parameters.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from scipy import optimize

from aerial_gym.sim2real.arrays import Array, Flags, Indices
from aerial_gym.sim2real.json_values import plain, select_fields
from aerial_gym.sim2real.statistics import Estimate, Rms, rms_with_interval, student_quantile

PARSIMONY = 0.02  # Largest relative excess of the held-out error for which a law with fewer parameters is chosen
FOLDS = 5  # Number of folds of a single flight


def estimates(values: Array, covariance: Array, freedom: int) -> list[Estimate]:
    """Return each value with ``value ± t std``, t the 97.5 % quantile of Student's distribution."""
    half_width = student_quantile(0.975, max(freedom, 1)) * np.sqrt(np.maximum(np.diag(covariance), 0.0))
    return [Estimate.from_half_width(*pair) for pair in zip(values, half_width, strict=True)]


def rms(values: Array) -> float:
    """Return the root mean square."""
    return float(np.sqrt(np.mean(np.square(values))))


def cross_validation_error(values: Array, group: Indices | None = None) -> Rms:
    """Return the RMS of held-out errors (N,) with a 95 % interval over groups of rows; None: independent rows."""
    labels = np.arange(values.size) if group is None else group
    return rms_with_interval(values[:, None], labels, seed=0)[0]


def fold_labels(counts: Sequence[int]) -> Indices:
    """Return the cross-validation fold of each row, (N,): its flight, given row counts, or one of FOLDS of a single flight."""
    if len(counts) == 1:
        return np.arange(counts[0]) * FOLDS // counts[0]
    return np.repeat(np.arange(len(counts)), counts)


def errors_on_left_out_folds(fold: Indices, errors: Callable[[Flags], Array]) -> Array:
    """Return the error of every row, (N,), from the fit without its fold (N,).

    ``errors`` takes the left-out rows, bool (N,), fits all others, and returns the errors of the left-out ones.
    """
    results = np.empty(fold.size)
    for label in np.unique(fold):
        out = fold == label
        results[out] = errors(out)
    return results


def smallest_good_candidate(errors: Mapping[str, float], terms: Mapping[str, int]) -> str:
    """Return the candidate with the fewest terms among those with nearly the least error; of equals the best."""
    least = min(errors.values())
    close = [name for name, error in errors.items() if error <= (1.0 + PARSIMONY) * least]
    return min(close, key=lambda name: (terms[name], errors[name]))


def leverage(regressors: Array) -> Array:
    """Return the leverage of each row, (N,): the diagonal of the hat matrix."""
    q, _ = np.linalg.qr(regressors / np.maximum(np.abs(regressors).max(axis=0), 1e-300))
    return (q * q).sum(axis=1)


LONGEST_MEMORY = 0.97  # Largest AR(1) coefficient for the prewhitening of scores (Andrews, Monahan 1992, section 3)


def hc3_covariance(regressors: Array, residual: Array) -> Array:
    """Return the least-squares covariance for independent, heteroscedastic residuals, (K, K).

    Source: MacKinnon, White (1985), Some heteroskedasticity-consistent covariance matrix estimators, HC3.
    """
    bread = np.linalg.inv(regressors.T @ regressors)
    weighted = regressors * (residual / np.maximum(1.0 - leverage(regressors), 1e-6))[:, None]
    return bread @ (weighted.T @ weighted) @ bread


def bartlett_bandwidth(residual: Array) -> int:
    """Return the Bartlett bandwidth in rows for residuals that follow an AR(1) process.

    Source: Andrews (1991), Heteroskedasticity and autocorrelation consistent covariance matrix estimation, eq. 6.2, 6.4.
    """
    scale = float(residual[:-1] @ residual[:-1])
    rho = float(np.clip(residual[1:] @ residual[:-1] / scale, 0.0, 0.99)) if scale > 0.0 else 0.0
    alpha = 4.0 * rho**2 / ((1.0 - rho) ** 2 * (1.0 + rho) ** 2)
    return int(np.ceil(1.1447 * (alpha * residual.size) ** (1.0 / 3.0)))


def hac_covariance(regressors: Array, residual: Array) -> Array:
    """Return the least-squares covariance for autocorrelated residuals, (K, K).

    Scores are prewhitened by AR(1), summed with a Bartlett window, and recoloured.

    Source:
        Andrews, Monahan (1992), An improved heteroskedasticity and autocorrelation consistent covariance matrix estimator;
        Newey, West (1987) for the window; residuals over one minus leverage as in HC3, since a few rows at a step
        carry most of the information.
    """
    scores = regressors * (residual / np.maximum(1.0 - leverage(regressors), 1e-6))[:, None]
    before, after = scores[:-1], scores[1:]
    power = np.maximum((before * before).sum(axis=0), 1e-300)
    memory = np.clip((after * before).sum(axis=0) / power, -LONGEST_MEMORY, LONGEST_MEMORY)
    white = np.concatenate((scores[:1], after - before * memory))
    meat = white.T @ white
    lags = min(bartlett_bandwidth(white @ (1.0 / np.maximum(white.std(axis=0), 1e-300))), residual.size - 1)
    for lag in range(1, lags + 1):
        product = white[lag:].T @ white[:-lag]
        meat += (1.0 - lag / (lags + 1.0)) * (product + product.T)
    meat = meat / np.outer(1.0 - memory, 1.0 - memory)
    bread = np.linalg.pinv(regressors.T @ regressors)
    return bread @ meat @ bread


@dataclass(frozen=True, kw_only=True)
class CurveFit:
    """Fit of a curve to rows in time order."""

    params: Array  # Parameters, (K,)
    residual: Array  # Measured minus fitted, (N,)
    covariance: Array  # Covariance of the parameters, (K, K)

    def estimates(self) -> list[Estimate]:
        """Return the parameters with 95 % intervals."""
        return estimates(self.params, self.covariance, self.residual.size - self.params.size)


def fit_curve(
    predict: Callable[[Array], Array], measured: Array, start: Array, low: Array, high: Array, kept: Flags | None = None
) -> CurveFit:
    """Return the parameters that minimise the squared residual of ``predict``.

    Args:
        predict: Curve (N,) of parameters (K,).
        start: Initial parameters (K,), inside the bounds.
        kept: Fitted rows, (N,); None: all. ``residual`` holds all rows.
    """
    rows = np.ones(measured.size, dtype=bool) if kept is None else kept
    scale = np.maximum(np.abs(start), 1e-3 * (high - low))
    results = optimize.least_squares(
        lambda z: (predict(z * scale) - measured)[rows],
        start / scale,
        bounds=(low / scale, high / scale),
        x_scale="jac",
    )
    params = results.x * scale
    residual = measured - predict(params)
    covariance = hac_covariance(np.asarray(results.jac) / scale, residual[rows])
    return CurveFit(params=params, residual=residual, covariance=covariance)


@dataclass(frozen=True, kw_only=True)
class LawFit:
    """Fit of one candidate law, with its errors on rows that the fit has not seen."""

    name: str
    params: dict[str, Estimate]
    residual: Array = field(repr=False)  # Measured minus fitted, (N,)
    held_out: Array = field(repr=False)  # Measured minus predicted, from fits without that fold, (N,)
    fold: Indices | None = field(default=None, repr=False)  # Fold of each row, (N,); None: each row is one

    @property
    def fit_rms(self) -> float:
        """Return the RMS residual of the fit."""
        return rms(self.residual)

    @property
    def held_out_rms(self) -> float:
        """Return the RMS held-out error."""
        return rms(self.held_out)

    @cached_property
    def error(self) -> Rms:
        """Return the RMS held-out error with its interval over folds."""
        return cross_validation_error(self.held_out, self.fold)

    def as_mapping(self) -> dict[str, object]:
        """Return the values for JSON."""
        return {**select_fields(self, "name", "fit_rms"), "held_out": plain(self.error), "params": plain(self.params)}


def fit_law(
    name: str, labels: Sequence[str], predict: Callable[[Array], Array], measured: Array,
    bounds: tuple[Array, Array, Array], fold: Indices,
) -> LawFit:  # fmt: skip
    """Return a law fitted to all rows; fits without a fold start near that one.

    ``bounds``: start, lowest and highest parameters, (K,) each. ``fold``: fold of each row, (N,).
    """
    start, low, high = bounds
    whole = fit_curve(predict, measured, start, low, high)
    near = np.clip(whole.params, low + 1e-6 * (high - low), high - 1e-6 * (high - low))
    held_out = errors_on_left_out_folds(
        fold, lambda out: fit_curve(predict, measured, near, low, high, ~out).residual[out]
    )
    params = dict(zip(labels, whole.estimates(), strict=True))
    return LawFit(name=name, params=params, residual=whole.residual, held_out=held_out, fold=fold)
