"""Uncertainty of fitted parameters with coloured residuals, few flights and declared tolerances.

Letters: B blocks, F flights, C channels, K parameters, P free parameters, N tolerances.
"""

from dataclasses import dataclass, replace

import numpy as np
from scipy.special import log_ndtr, ndtri_exp

from aerial_gym.sim2real.arrays import Array, Flags, Indices
from aerial_gym.sim2real.identify.least_squares.gauss_newton import (
    ModelFit,
    least_squares_step_in_bounds,
    normal_equations_without_prior,
    prior_precision,
)
from aerial_gym.sim2real.statistics import FEWEST_FLIGHTS, half_width_of_scatter, normal_quantile

NORMAL_95 = normal_quantile(0.975)


@dataclass(frozen=True, kw_only=True)
class Uncertainty:
    """Uncertainty of the P fitted parameters, in units of scale or tolerance."""

    columns: Indices  # Indices of the P parameters among all K, (P,)
    step: Array  # Step from the linearisation to the optimum, (K,)
    plain: Array  # Covariance for white residuals, (P, P); it reveals unobservable parameters
    blocks: Array  # Covariance from the scatter of time blocks, (P, P)
    flights: Array | None  # Covariance from the scatter of whole flights, (P, P); None with fewer than three
    tolerance: Array  # Covariance from the uncertainty of the deviations within the tolerances, (P, P)
    num_blocks: int  # Number B of blocks
    num_flights: int  # Number F of flights
    between_sets: Array | None = None  # Variance from unproven effects that may act beside these, (P,); None: none

    @property
    def half_width(self) -> Array:
        """Return half the 95 % interval, (P,), from scatter with its t quantile, tolerances, and unproven effects.

        Scatter is that of blocks, or of flights if larger.
        """
        whole = None if self.flights is None else np.diag(self.flights)
        scatter = half_width_of_scatter(np.diag(self.blocks), self.num_blocks, whole, self.num_flights)
        unknown = np.diag(self.tolerance) + (0.0 if self.between_sets is None else self.between_sets)
        return np.hypot(scatter, NORMAL_95 * np.sqrt(unknown))

    @property
    def std(self) -> Array:
        """Return half the 95 % interval over 1.96, (P,), valid for small samples as well."""
        return self.half_width / NORMAL_95

    @property
    def correlation(self) -> Array:
        """Return the correlations from the scatter of blocks and the tolerances, (P, P)."""
        together = self.blocks + self.tolerance
        deviation = np.sqrt(np.diag(together))
        return np.clip(together / np.outer(deviation, deviation), -1.0, 1.0)


def is_identifiable(covariance: Array) -> Flags:
    """Return the parameters (P,) with a standard deviation of at most one scale in a covariance (P, P) with weak priors."""
    return np.diag(covariance) <= 1.0


def uncertainty(fit: ModelFit, weight: Array) -> Uncertainty:
    """Return the uncertainty of the fitted effects, jointly with deviations within the tolerances.

    ``A = sum w J J^T + P`` with the inverse prior variance P, and ``s = sum w J r`` of a block or flight. The sandwich
    ``A^-1 (sum s s^T) A^-1`` is the covariance from noise, ``A^-1 P A^-1`` that from the unknown deviations. Source: Liang,
    Zeger (1986), Longitudinal data analysis using generalized linear models, section 2 (sandwich over clusters); Hoerl,
    Kennard (1970), Ridge regression, section 4: variance and squared bias, here its mean over the prior.

    A parameter at a bound has the interval of a normal distribution truncated there, narrower than without the bound by a
    factor f. The others keep their scatter at a fixed parameter, and move with f times its own.
    """
    free, columns = fit.indices_of_fitted_params, fit.indices_of_fitted_effect_params
    product, _ = normal_equations_without_prior(fit, weight)
    inverse = np.linalg.inv(product[np.ix_(free, free)] + np.diag(prior_precision(fit)[free]))
    step, bread = least_squares_step_in_bounds(fit, weight, free), inverse[: columns.size]
    spread = _spread_of_scores(fit, step, bread, _block_scores(fit, weight, step) @ bread.T)
    held = np.flatnonzero(np.isclose(step, fit.low)[columns] | np.isclose(step, fit.high)[columns])
    if not held.size:
        return spread
    low, high = fit.low.copy(), fit.high.copy()
    low[columns[held]], high[columns[held]] = -np.inf, np.inf
    loose = least_squares_step_in_bounds(replace(fit, low=low, high=high), weight, free)
    scores = _block_scores(fit, weight, loose)
    std = _spread_of_scores(fit, loose, bread, scores @ bread.T).std[held]
    beyond = np.abs(loose - step)[columns[held]] / std
    along = bread[:, held] @ np.linalg.inv(bread[np.ix_(held, held)])
    moving = (along * (_half_width_at_bound(beyond) / NORMAL_95)) @ bread[held]
    fixed = bread - along @ bread[held]
    influences = _block_scores(fit, weight, step) @ fixed.T + scores @ moving.T
    return replace(_spread_of_scores(fit, step, fixed + moving, influences), plain=spread.plain)


def _half_width_at_bound(beyond: Array) -> Array:
    """Return the distance from a bound that holds 95 % of a standard normal variable cut off ``beyond`` below its mode."""
    return -beyond - ndtri_exp(np.log(0.05) + log_ndtr(-beyond))


def _block_scores(fit: ModelFit, weight: Array, step: Array) -> Array:
    """Return ``sum w J r`` of the free parameters in each block after a step, (B, free)."""
    change = np.einsum("bckl,l->bck", fit.moments.product, step)
    return np.einsum("c,bck->bk", weight, fit.moments.gradient - change)[:, fit.indices_of_fitted_params]


def _spread_of_scores(fit: ModelFit, step: Array, bread: Array, scores: Array) -> Uncertainty:
    """Return the uncertainty of the parameters by their change per score, ``bread`` (P, free), and per block (B, P)."""
    free, (count, own) = fit.indices_of_fitted_params, scores.shape
    by_flight = np.stack([scores[fit.moments.flight == f].sum(axis=0) for f in np.unique(fit.moments.flight)])
    flights = len(by_flight)
    return Uncertainty(
        columns=fit.indices_of_fitted_effect_params,
        step=step,
        plain=bread[:, :own],
        blocks=scores.T @ scores * (count / max(count - 1, 1)),
        flights=None if flights < FEWEST_FLIGHTS else by_flight.T @ by_flight * (flights / (flights - 1)),
        tolerance=(bread * prior_precision(fit)[free]) @ bread.T,
        num_blocks=count,
        num_flights=flights,
    )
