"""Derivatives of predictions by parameters: how they are taken, kept, and mended along a step.

Letters: C channels, P parameters of effects, N tolerances.
"""

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from aerial_gym.physics import EFFECTS
from aerial_gym.sim2real.arrays import Array
from aerial_gym.sim2real.identify.least_squares.parameters import bounds_of, is_number, params_of, scales, with_params
from aerial_gym.sim2real.memory import give_back_memory
from aerial_gym.sim2real.predict.model_params import ModelParams
from aerial_gym.sim2real.predict.predictor import Predictor
from aerial_gym.sim2real.predict.tolerances import of_logs

Derivatives = Sequence[NDArray[np.floating]]
"""By some parameters, per scale, of each flight, (rows, C, P)."""

STEP = 1e-3
"""Difference step in units of a parameter's scale or of a tolerance."""


def column_by_column(like: Array, parameters: int, dtype: type[np.floating] = np.float64) -> NDArray[Any]:
    """Return zeros (rows, C, P) for a prediction (rows, C); neighbours in memory are rows, as they are written and read."""
    return np.zeros((parameters, *like.T.shape), dtype=dtype).T


def effect_jacobian(
    predictor: Predictor,
    params: ModelParams,
    effects: Sequence[str],
    base: list[Array],
    *,
    beside: list[Array] | None = None,
) -> list[Array]:
    """Return the derivative of the prediction by the effects' parameters, per scale, each (rows, C, P).

    Those in ``beside`` (rows, C, N) come behind them.
    """
    here, scale = params_of(params, effects), scales(effects)
    highest = bounds_of(predictor.robot, effects)[1]
    owners = [(name, place) for name in effects for place in range(len(EFFECTS.get(name).parameters))]
    width, behind = len(owners), [np.empty((*b.shape, 0)) for b in base] if beside is None else beside
    found = [column_by_column(b, width + more.shape[2]) for b, more in zip(base, behind, strict=True)]
    for columns, more in zip(found, behind, strict=True):
        columns[:, :, width:] = more
    for k, owner in enumerate(owners):
        if not is_number(*owner):
            continue
        step = STEP * scale[k] if here[k] + STEP * scale[k] <= highest[k] else -STEP * scale[k]
        there = here.copy()
        there[k] += step
        moved = predictor.predict(with_params(predictor.robot, params, effects, there))
        for column, m, b in zip(found, moved, base, strict=True):
            column[:, :, k] = (m - b) * (scale[k] / step)
    return found


def tolerance_jacobian(
    predictor: Predictor, params: ModelParams, dtype: type[np.floating] = np.float64
) -> list[NDArray[Any]]:
    """Return the derivative of the prediction by the deviations, each (rows, C, N); in single precision as of ``single``.

    Half way to those of the model: times them it is what they change together, but for terms of third order. Deviations act on
    each other: a sensor that is late is elsewhere than the motion says.
    """
    half = np.zeros(predictor.num_tolerances) if params.deviation is None else 0.5 * params.deviation
    base = predictor.predict(replace(params, deviation=half if half.any() else None))
    found = [column_by_column(b, predictor.num_tolerances, dtype) for b in base]
    for k in range(predictor.num_tolerances):
        deviation = half + STEP * np.eye(predictor.num_tolerances)[k]
        moved = predictor.predict(replace(params, deviation=deviation))
        for column, m, b in zip(found, moved, base, strict=True):
            column[:, :, k] = (m - b) / STEP
    give_back_memory()
    return found


def tolerated(tolerance: Derivatives, num_rotors: int) -> Array:
    """Return the residual (rms) that the tolerances of the vehicle, and not those of its log, cause in each channel, (C,).

    ``tolerance`` are the derivatives by all of them, (rows, C, N) of each flight.
    """
    vehicle = np.logical_not(of_logs(num_rotors))
    return np.sqrt(np.concatenate([(part[:, :, vehicle] ** 2).sum(axis=2) for part in tolerance]).mean(axis=0))


def change_along(columns: NDArray[np.floating], step: Array) -> Array:
    """Return what derivatives of a flight (rows, C, P) say of a step (P,), (rows, C)."""
    return np.tensordot(step, columns.T, axes=1).T


def exact_along(columns: Sequence[Array], step: Array, change: Sequence[Array]) -> None:
    """Change derivatives (rows, C, k) in place, as little as gives exactly the ``change`` (rows, C) over a ``step`` (k).

    A lag of 0 and one of 0.06 s differ by much more or less than what the derivative at 0.06 s says.

    Source:
        Broyden (1965), A class of methods for solving nonlinear simultaneous equations, Mathematics of Computation 19.
    """
    if not np.any(step):
        return
    along = step / (step @ step)
    for own, moved in zip(columns, change, strict=True):
        missed = moved - change_along(own, step)
        for k in np.flatnonzero(along):
            own[:, :, k] += along[k] * missed


def single(columns: Derivatives) -> Derivatives:
    """Return derivatives in single precision, in which they are kept: differences of predictions know no more digits."""
    return [part.astype(np.float32) for part in columns]
