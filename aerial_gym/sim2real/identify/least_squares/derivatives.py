"""Parameter vectors of effects, and derivatives of predictions by them: finite differences, storage and secant updates.

Letters: C channels, P parameters of effects, N tolerances.
"""

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from aerial_gym.config.robot import RobotCfg
from aerial_gym.physics import EFFECTS
from aerial_gym.sim2real.arrays import Array
from aerial_gym.sim2real.predict.model_params import ModelParams
from aerial_gym.sim2real.predict.predictor import Predictor
from aerial_gym.sim2real.predict.tolerances import is_tolerance_of_logs


def is_continuous_parameter(effect: str, place: int) -> bool:
    """Return whether a parameter is continuous and can be fitted, unlike a rotor number or a convention."""
    return EFFECTS.get(effect).parameters[place].kind == "number"


def parameter_scales(effects: Sequence[str]) -> Array:
    """Return the scales of the effects' parameters as a vector."""
    return np.array([parameter.scale for name in effects for parameter in EFFECTS.get(name).parameters])


def parameter_row(params: ModelParams, effects: Sequence[str]) -> Array:
    """Return the parameters of some effects as a vector."""
    return np.concatenate([params.effects[name] for name in effects]) if effects else np.zeros(0)


def parameter_bounds(robot: RobotCfg, effects: Sequence[str]) -> tuple[Array, Array]:
    """Return the lower and upper bounds of the effects' parameters as vectors."""
    pairs = [pair for name in effects for pair in EFFECTS.get(name).bounds(robot)]
    return np.array([low for low, _ in pairs]), np.array([high for _, high in pairs])


def replace_params(robot: RobotCfg, params: ModelParams, effects: Sequence[str], values: Array) -> ModelParams:
    """Return the model with new parameters, clipped to their bounds."""
    clipped, start = np.clip(values, *parameter_bounds(robot, effects)), 0
    for name in effects:
        width = len(EFFECTS.get(name).parameters)
        params = params.with_effect(name, clipped[start : start + width])
        start += width
    return params


Derivatives = Sequence[NDArray[np.floating]]  # Derivatives by some parameters, per scale, of each flight, (rows, C, P)
STEP = 1e-3  # Finite-difference step in units of a scale or tolerance


def zero_columns(like: Array, parameters: int, dtype: type[np.floating] = np.float64) -> NDArray[Any]:
    """Return zeros (rows, C, P) for a prediction (rows, C), contiguous along rows for fast columns."""
    return np.zeros((parameters, *like.T.shape), dtype=dtype).T


def effect_jacobian(
    predictor: Predictor, params: ModelParams, effects: Sequence[str], base: list[Array], *,
    beside: list[Array] | None = None,
) -> list[Array]:  # fmt: skip
    """Return derivatives by the effects' parameters, per scale, (rows, C, P) each, then the columns ``beside`` (rows, C, N)."""
    here, scale = parameter_row(params, effects), parameter_scales(effects)
    highest = parameter_bounds(predictor.robot, effects)[1]
    owners = [(name, place) for name in effects for place in range(len(EFFECTS.get(name).parameters))]
    width, behind = len(owners), [np.empty((*b.shape, 0)) for b in base] if beside is None else beside
    matrices = [zero_columns(b, width + more.shape[2]) for b, more in zip(base, behind, strict=True)]
    for columns, more in zip(matrices, behind, strict=True):
        columns[:, :, width:] = more
    for k, owner in enumerate(owners):
        if not is_continuous_parameter(*owner):
            continue
        step = STEP * scale[k] if here[k] + STEP * scale[k] <= highest[k] else -STEP * scale[k]
        there = here.copy()
        there[k] += step
        moved = predictor.predict(replace_params(predictor.robot, params, effects, there))
        for column, m, b in zip(matrices, moved, base, strict=True):
            column[:, :, k] = (m - b) * (scale[k] / step)
    return matrices


def tolerance_jacobian(
    predictor: Predictor, params: ModelParams, dtype: type[np.floating] = np.float64
) -> list[NDArray[Any]]:
    """Return the derivatives of the prediction by the deviations, (rows, C, N) each, in the given precision.

    At half of the model's deviations they give the total change up to third-order terms, with interactions.
    """
    half = np.zeros(predictor.num_tolerances) if params.deviation is None else 0.5 * params.deviation
    base = predictor.predict(replace(params, deviation=half if half.any() else None))
    matrices = [zero_columns(b, predictor.num_tolerances, dtype) for b in base]
    for k in range(predictor.num_tolerances):
        deviation = half + STEP * np.eye(predictor.num_tolerances)[k]
        moved = predictor.predict(replace(params, deviation=deviation))
        for column, m, b in zip(matrices, moved, base, strict=True):
            column[:, :, k] = (m - b) / STEP
    predictor.clear_caches()
    return matrices


def rms_caused_by_tolerances(tolerance: Derivatives, num_rotors: int) -> Array:
    """Return the RMS residual in each channel, (C,), from the vehicle alone, by derivatives (rows, C, N) of all tolerances."""
    vehicle = np.logical_not(is_tolerance_of_logs(num_rotors))
    return np.sqrt(np.concatenate([(part[:, :, vehicle] ** 2).sum(axis=2) for part in tolerance]).mean(axis=0))


def linear_change(columns: NDArray[np.floating], step: Array) -> Array:
    """Return the linear change of a flight's prediction (rows, C) for derivatives (rows, C, P) and a step (P,)."""
    return np.tensordot(step, columns.T, axes=1).T


def correct_derivatives(columns: Sequence[Array], step: Array, change: Sequence[Array]) -> None:
    """Apply Broyden's update: change derivatives (rows, C, k) least to give ``change`` (rows, C) over a ``step`` (k).

    Source: Broyden (1965), A class of methods for solving nonlinear simultaneous equations, Mathematics of Computation 19.
    """
    if not np.any(step):
        return
    along = step / (step @ step)
    for own, moved in zip(columns, change, strict=True):
        missed = moved - linear_change(own, step)
        for k in np.flatnonzero(along):
            own[:, :, k] += along[k] * missed
