"""Information about every column that one flight gives: weighted sums of the residual and its derivatives.

Letters: T rows, C channels, K columns, N tolerances.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from aerial_gym.errors import DataError
from aerial_gym.sim2real.arrays import Array, Indices
from aerial_gym.sim2real.flight_evidence.columns import candidate_points, continuous_places
from aerial_gym.sim2real.identify.candidates.testable import finding_on_untestable_effect
from aerial_gym.sim2real.identify.least_squares.box_minimum import minimise_in_bounds
from aerial_gym.sim2real.identify.least_squares.derivative_sums import (
    SparseDerivatives,
    drop_zero_channels,
    moments_by_channel,
)
from aerial_gym.sim2real.identify.least_squares.derivatives import effect_jacobian, tolerance_jacobian
from aerial_gym.sim2real.identify.least_squares.gauss_newton import FARTHEST_DEVIATION, WEAK_PRIOR
from aerial_gym.sim2real.identify.least_squares.moments import Moments, inverse_variance_weights
from aerial_gym.sim2real.predict.model_params import params_from_robot
from aerial_gym.sim2real.predict.predictor import Predictor

WEIGHINGS = 3  # Fits with weights from the last residual, as in the first stage of ``choose_effects``


@dataclass(frozen=True, kw_only=True)
class FlightSums:
    """Sums of one flight over all rows and channels, weighted by its noise."""

    product: Array  # ``sum w J J^T``, (K, K)
    gradient: Array  # ``sum w J r``, (K,)
    square: float  # ``sum w r^2``
    rows: int

    def __add__(self, other: "FlightSums") -> "FlightSums":
        return FlightSums(
            product=self.product + other.product,
            gradient=self.gradient + other.gradient,
            square=self.square + other.square,
            rows=self.rows + other.rows,
        )


def sums_of_flights(predictor: Predictor, bounds: tuple[Array, Array]) -> list[FlightSums]:
    """Return the sums of each flight about the declared robot, with the tolerances of the predictor.

    ``bounds``: lowest and highest steps of the effects' columns.
    """
    residuals = predictor.residuals(params_from_robot(predictor.robot))
    flights = zip(residuals, *_derivatives_of_flights(predictor), strict=True)
    return [_sums_with_weights(*flight, bounds) for flight in flights]


def _derivatives_of_flights(predictor: Predictor) -> tuple[list[list[SparseDerivatives]], list[Array]]:
    """Return the derivatives of each flight by the effects, zero for one that it cannot show, and by the N tolerances."""
    robot, declared, flights = predictor.robot, params_from_robot(predictor.robot), predictor.flights
    parts, untestable = [list[SparseDerivatives]() for _ in flights], dict[str, list[bool]]()
    for name, params in candidate_points(robot):
        if name not in untestable:
            untestable[name] = [finding_on_untestable_effect(name, robot, [flight]) is not None for flight in flights]
        places = continuous_places(name)
        if all(untestable[name]):
            columns = [np.zeros((len(time), 1, len(places))) for time in predictor.times]
        else:
            columns = effect_jacobian(predictor, params, (name,), predictor.predict(params))
            columns = [part[:, :, places] for part in columns]
        for own, part, hidden in zip(parts, columns, untestable[name], strict=True):
            hidden = hidden or not np.isfinite(part).all()  # a load may swing over the top
            own += drop_zero_channels([np.zeros_like(part) if hidden else part])
    return parts, tolerance_jacobian(predictor, declared, np.float32)


def _sums_with_weights(
    residual: Array, effects: Sequence[SparseDerivatives], tolerances: Array, bounds: tuple[Array, Array]
) -> FlightSums:
    """Return the sums of one flight, with all columns in the order of the derivatives."""
    if not (np.isfinite(residual).all() and np.isfinite(tolerances).all()):
        raise DataError("the prediction for it is not finite; check its rotor data")
    moments = moments_by_channel([residual], [[*effects, tolerances]])
    weight = _noise_weights(residual, effects, tolerances, moments, bounds)
    return FlightSums(
        product=np.einsum("c,ckl->kl", weight, moments.product[0]),
        gradient=weight @ moments.gradient[0],
        square=float(weight @ moments.square[0]),
        rows=len(residual),
    )


def _noise_weights(
    residual: Array, effects: Sequence[SparseDerivatives], tolerances: Array, moments: Moments,
    bounds: tuple[Array, Array],
) -> Array:  # fmt: skip
    """Return the weight of a row of each channel, (C,), from the residual with every effect and tolerance fitted.

    The fit takes degrees of freedom from the noise: those of each channel are the trace of its part of the smoother matrix.
    """
    count = tolerances.shape[2]
    width = moments.gradient.shape[2]
    precision = np.append(np.full(width - count, WEAK_PRIOR**-2), np.ones(count))
    low, high = (
        np.append(bound, np.full(count, sign * FARTHEST_DEVIATION)) for bound, sign in zip(bounds, (-1, 1), strict=True)
    )
    weights = inverse_variance_weights([residual])
    weight = weights.weight
    for _ in range(WEIGHINGS):
        inner = np.einsum("c,ckl->kl", weight, moments.product[0]) + np.diag(precision)
        step = minimise_in_bounds(inner, weight @ moments.gradient[0], low, high)
        weights = inverse_variance_weights([_residual_after_step(residual, effects, tolerances, step)])
        used = weight * np.einsum("ckl,lk->c", moments.product[0], np.linalg.inv(inner))
        independent = weights.effective * len(residual)
        weight = weights.weight * np.maximum(1.0 - used / independent, 1.0 / independent)
    return weight


def _residual_after_step(
    residual: Array, effects: Sequence[SparseDerivatives], tolerances: Array, step: Array
) -> Array:
    """Return the residual (T, C) after a step (K,) along its derivatives."""
    left, place = residual - np.tensordot(tolerances, step[-tolerances.shape[2] :], axes=1), 0
    for part in effects:
        left[:, list(part.channels)] -= np.tensordot(part.values, step[place : place + part.width], axes=1)
        place += part.width
    return left


def with_common_tolerances(sums: FlightSums, own: Array, common: Array) -> FlightSums:
    """Return sums whose tolerances have common standard deviations (N,), without those that are 0.

    What a flight's ``own`` standard deviations (N,) exceed them by is an error of this flight alone, and integrated out.
    """
    width = len(sums.gradient)
    ratio = np.divide(common, own, out=np.zeros(own.size), where=own > 0.0)  # 0: of each log
    share = np.append(np.ones(width - own.size), ratio)
    excess = np.flatnonzero(share < 1.0)
    across = sums.product[excess]
    inner = np.diag(1.0 / (1.0 - share[excess] ** 2)) + across[:, excess]
    solved = np.linalg.solve(inner, np.column_stack((across, sums.gradient[excess])))
    product, gradient = sums.product - across.T @ solved[:, :-1], sums.gradient - across.T @ solved[:, -1]
    kept: Indices = np.flatnonzero(share)
    return FlightSums(
        product=np.outer(share[kept], share[kept]) * product[np.ix_(kept, kept)],
        gradient=share[kept] * gradient[kept],
        square=sums.square - float(sums.gradient[excess] @ solved[:, -1]),
        rows=sums.rows,
    )
