"""Parameters of effects in a row: which of them are numbers, their scales, their bounds, and a model with others."""

from collections.abc import Sequence

import numpy as np

from aerial_gym.config.robot import RobotCfg
from aerial_gym.physics import EFFECTS
from aerial_gym.sim2real.arrays import Array
from aerial_gym.sim2real.predict.model_params import ModelParams


def is_number(effect: str, place: int) -> bool:
    """Return whether a parameter is one that a fit may change: not the number of a rotor, nor a convention."""
    return EFFECTS.get(effect).parameters[place].kind == "number"


def scales(effects: Sequence[str]) -> Array:
    """Return the scale of each parameter of some effects."""
    return np.array([parameter.scale for name in effects for parameter in EFFECTS.get(name).parameters])


def params_of(params: ModelParams, effects: Sequence[str]) -> Array:
    """Return the parameters of some effects in a row."""
    return np.concatenate([params.effects[name] for name in effects]) if effects else np.zeros(0)


def bounds_of(robot: RobotCfg, effects: Sequence[str]) -> tuple[Array, Array]:
    """Return the lowest and highest possible values of the parameters of some effects in a row."""
    pairs = [pair for name in effects for pair in EFFECTS.get(name).bounds(robot)]
    return np.array([low for low, _ in pairs]), np.array([high for _, high in pairs])


def with_params(robot: RobotCfg, params: ModelParams, effects: Sequence[str], values: Array) -> ModelParams:
    """Return the parameters with other parameters, held within their bounds."""
    clipped, start = np.clip(values, *bounds_of(robot, effects)), 0
    for name in effects:
        width = len(EFFECTS.get(name).parameters)
        params = params.with_effect(name, clipped[start : start + width])
        start += width
    return params
