"""Channel weights from the residual with all candidate effects fitted."""

from collections.abc import Callable, Sequence

import numpy as np

from aerial_gym.sim2real.arrays import Array
from aerial_gym.sim2real.identify.least_squares.derivative_sums import weighted_moments
from aerial_gym.sim2real.identify.least_squares.derivatives import Derivatives, correct_derivatives, directional_change
from aerial_gym.sim2real.identify.least_squares.gauss_newton import UNIT, best_step, fit_of_moments
from aerial_gym.sim2real.identify.least_squares.moments import Weighting, inverse_variance_weights
from aerial_gym.sim2real.identify.least_squares.parameters import parameter_row, parameter_scales, replace_params
from aerial_gym.sim2real.memory import give_back_memory
from aerial_gym.sim2real.predict.model_params import ModelParams
from aerial_gym.sim2real.predict.predictor import Predictor


def iterate_channel_weights(
    predictor: Predictor,
    start: ModelParams,
    effects: tuple[str, ...],
    own: Sequence[Array],
    linear: Sequence[Derivatives],
    *,
    beyond: Callable[[list[Array], Weighting], list[Array]] | None = None,
) -> Weighting:
    """Return the channel weights from the residual that no candidate effect explains.

    Effects, ``linear`` columns (rows, C, any) and tolerances are fitted three times, with weights from the last residual or
    ``beyond`` it. ``own``: derivatives by the effects, (rows, C, P), updated in place.
    """
    params = start
    predicted = predictor.predict(params)
    weights = inverse_variance_weights([m - p for m, p in zip(predictor.measured, predicted, strict=True)])
    ends = np.cumsum([0, *(part[0].shape[2] for part in linear)])[:-1]
    for _ in range(3):
        residuals = [m - p for m, p in zip(predictor.measured, predicted, strict=True)]
        flights = list(zip(own, *linear, strict=True))
        moments = weighted_moments(predictor.times, residuals, flights, weights.weight)
        give_back_memory()
        fit = fit_of_moments(predictor.robot, effects, params, moments)
        step, *steps = np.split(best_step(fit, UNIT, fit.free_all), fit.num_effect_params + ends)
        left = residuals
        for part, along in zip((own, *linear), (step, *steps), strict=True):
            left = [r - directional_change(columns, along) for r, columns in zip(left, part, strict=True)]
        if not all(np.isfinite(part).all() for part in left):
            break  # step beyond a pendulum's range: keep the previous weights
        weights = inverse_variance_weights(left if beyond is None else beyond(left, weights))
        here = parameter_row(params, effects)
        params = replace_params(predictor.robot, params, effects, here + parameter_scales(effects) * step)
        before, predicted = predicted, predictor.predict(params)
        correct_derivatives(own, step, [p - b for p, b in zip(predicted, before, strict=True)])
    return weights
