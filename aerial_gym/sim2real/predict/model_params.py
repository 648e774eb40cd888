"""Parameters of a model: effects, deviations within the tolerances and a learned residual.

Letters: E rows, P parameters, N tolerances.
"""

from dataclasses import dataclass, field, replace

import numpy as np
import torch

from aerial_gym.config.robot import RobotCfg
from aerial_gym.physics import EFFECTS
from aerial_gym.physics.effects import LearnedResidual
from aerial_gym.physics.model import EffectParams
from aerial_gym.sim2real.arrays import Array


@dataclass(frozen=True, kw_only=True)
class ModelParams:
    """Parameters of a model's effects and its deviations within the tolerances."""

    effects: dict[str, Array] = field(default_factory=dict)  # Parameters (P,) of the effects in the model by name
    deviation: Array | None = None  # Deviations in standard deviations, (N,); None: exactly as declared
    learned: LearnedResidual | None = None  # Learned residual beyond the effects; None without one

    def with_effect(self, name: str, params: Array) -> "ModelParams":
        """Return the parameters with one effect added or replaced."""
        return replace(self, effects={**self.effects, name: params})


def params_from_robot(robot: RobotCfg) -> ModelParams:
    """Return the declared model as a rigid vehicle, without random effects."""
    kept = {name: values for name, values in robot.effects.items() if EFFECTS.get(name).is_in_prediction}
    return ModelParams(
        effects={name: np.array(EFFECTS.get(name).parse_params(values)) for name, values in kept.items()},
        learned=None if robot.learned_residual is None else LearnedResidual(robot.learned_residual),
    )


def expand_effects(params: ModelParams, rows: int) -> list[EffectParams]:
    """Return the effects of a model with their parameters repeated in every row, (E, P)."""
    effects: list[EffectParams] = [
        (EFFECTS.get(name), torch.from_numpy(np.asarray(values, dtype=float)).expand(rows, -1))
        for name, values in params.effects.items()
    ]
    if params.learned is not None:
        effects.append((params.learned, torch.ones(rows, 1, dtype=torch.float64)))
    return effects


def params_key(params: ModelParams) -> tuple[object, ...]:
    """Return a hashable key of a model's effects, in order, and its deviations."""
    effects = [(name, np.asarray(values, dtype=float).tobytes()) for name, values in params.effects.items()]
    return (None if params.deviation is None else params.deviation.tobytes(), *effects)
