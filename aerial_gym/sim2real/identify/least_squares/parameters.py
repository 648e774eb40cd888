"""Parameter vectors of effects: which entries are numbers, scales, bounds and replacement in a model."""

from collections.abc import Sequence

import numpy as np

from aerial_gym.config.robot import RobotCfg
from aerial_gym.physics import EFFECTS
from aerial_gym.sim2real.arrays import Array
from aerial_gym.sim2real.predict.model_params import ModelParams


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
