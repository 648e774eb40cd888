"""What training flights leave open on the test flights: the posterior predictive of a residual.

What training does not excite keeps its prior variance: a deviation within the tolerances, a parameter of a named effect, an
effect that has no name yet. ``r = J d + noise`` on the test flights, with d normal of the posterior covariance
``(sum w J J^T + P)^-1`` of the training flights.
Letters: C channels, K parameters (those of effects in units of their scale, then the tolerances in deviations).
"""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy import stats

from aerial_gym.physics import EFFECTS
from aerial_gym.sim2real.identify.least_squares.gauss_newton import (
    effect_jacobian,
    is_number,
    normal_equations,
    prior_precision,
    tolerance_jacobian,
)
from aerial_gym.sim2real.identify.selection.library import Library, build_library
from aerial_gym.sim2real.identify.selection.select import Selection, lacks
from aerial_gym.sim2real.predict.model_params import ModelParams
from aerial_gym.sim2real.predict.predictor import Predictor

Array = NDArray[np.float64]


def left_open(test: Predictor, params: ModelParams, selection: Selection) -> Array:
    """Return the largest mean square of each channel that tolerances and named effects may leave on test flights, (C,).

    Larger ones have the probability ``Criteria.significance``. Parameters of named effects that training does not show have a
    standard deviation of their scale.

    Args:
        test: Test flights.
        params: The final model.
        selection: With its linearisation on the training flights.
    """
    fit = selection.final.fit
    predicted = test.predict(params)
    tolerance = tolerance_jacobian(test, params, predicted)
    jacobian = np.concatenate(effect_jacobian(test, params, fit.effects, predicted, beside=tolerance))
    precision = prior_precision(fit)
    for place, owner in enumerate(fit.owners):
        if owner in fit.frozen:
            precision[place] = 1.0
    chosen = np.array(
        [place for place in range(precision.size) if place >= len(fit.owners) or is_number(*fit.owners[place])]
    )
    product, _ = normal_equations(fit, selection.weights.weight)
    covariance = np.linalg.inv((product + np.diag(precision))[np.ix_(chosen, chosen)])
    columns = jacobian[:, :, chosen]
    mean_product = np.einsum("rck,rcl->ckl", columns, columns) / columns.shape[0]
    return quantile_of_squares(mean_product, covariance, selection.criteria.significance)


def quantile_of_squares(product: Array, covariance: Array, significance: float) -> Array:
    """Return what ``d^T M d`` exceeds with a probability, for each M of ``product`` (C, K, K) and normal d, (C,).

    Source:
        Satterthwaite (1946), An approximate distribution of estimates of variance components, Biometrics Bulletin 2: as a
        multiple of chi-square with the same mean and variance, ``tr(M S)`` and ``2 tr((M S)²)``.
    """
    spread = product @ covariance
    mean = np.maximum(np.einsum("ckk->c", spread), 1e-300)
    freedom = mean**2 / np.maximum(np.einsum("ckl,clk->c", spread, spread), 1e-300)
    freedom = np.maximum(freedom, 1.0)
    return mean * stats.chi2.isf(significance, freedom) / freedom


def open_effects(
    train: Predictor,
    test: Predictor,
    models: tuple[ModelParams, ModelParams],
    selection: Selection,
    excess: Array,
) -> tuple[str, ...]:
    """Return the effects that would make what remains, as far as training flights show them; the likeliest first.

    Each is taken alone, beside the named ones and the tolerances, with a prior at its scale.

    Args:
        train: Training flights.
        test: Test flights.
        models: The declared and the final one.
        selection: With what is accepted.
        excess: Mean square above the noise floor of the channels in which something remains, 0 in the others, (C,).
    """
    declared, final = models
    names = [name for name in EFFECTS if not EFFECTS.get(name).random]
    skipped = [name for name in names if lacks(name, train.robot, train.flights, test.flights)]
    skipped += [*selection.surrogates]
    frozen = selection.final.fit.frozen
    seen, asked = (
        build_library(flights, declared, final, selection.accepted, frozen=frozen, skipped=skipped)
        for flights in (train, test)
    )
    return covering(seen, asked, selection.weights.weight, excess, selection.criteria.significance)


def covering(seen: Library, asked: Library, weight: Array, excess: Array, significance: float) -> tuple[str, ...]:
    """Return the effects whose posterior predictive holds an excess (C,) in every channel, the least stretched first.

    Args:
        seen: About the final model on the training flights.
        asked: The same on the test flights.
        weight: Of one row of each channel, (C,).
        excess: Mean square above the noise floor, 0 where nothing is asked, (C,).
        significance: Probability with which larger ones would be met.
    """
    product = np.einsum("c,bckl->kl", weight, seen.moments.product)
    mean_product = asked.moments.product.sum(axis=0) / asked.moments.count.sum()
    named = [candidate.columns for candidate in seen.candidates if candidate.named]
    beside = np.concatenate([*named, seen.tolerances]).astype(int)
    places = np.flatnonzero(excess > 0.0)
    stretched: dict[str, float] = {}
    for candidate in seen.candidates:
        if candidate.named or not candidate.columns.size:
            continue
        columns = np.concatenate((candidate.columns, beside))
        both = np.ix_(columns, columns)
        covariance = np.linalg.inv(product[both] + np.eye(columns.size))
        limit = quantile_of_squares(mean_product[places][:, columns[:, None], columns], covariance, significance)
        need = float((excess[places] / limit).max())
        stretched[candidate.name] = min(need, stretched.get(candidate.name, np.inf))
    return tuple(sorted((name for name, need in stretched.items() if need <= 1.0), key=lambda name: stretched[name]))


def names_of(channels: Sequence[str], chosen: NDArray[np.bool_]) -> tuple[str, ...]:
    """Return the names of some channels."""
    return tuple(name for name, some in zip(channels, chosen, strict=True) if some)
