"""A model as numbers: effects with their parameters, deviations within the tolerances, what was learned.

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
    """Parameters of a model: effects with theirs, and deviations within the tolerances."""

    effects: dict[str, Array] = field(default_factory=dict)
    """Parameters by effect name, each (P,); an effect that is not here is not in the model."""

    deviation: Array | None = None
    """In standard deviations of the tolerances, (N,); None: exactly as declared."""

    learned: LearnedResidual | None = None
    """What flights have taught beyond the effects."""

    def with_effect(self, name: str, params: Array) -> "ModelParams":
        """Return the parameters with one effect added or replaced."""
        return replace(self, effects={**self.effects, name: params})


def declared_params(robot: RobotCfg) -> ModelParams:
    """Return the model that the robot file declares, taken as rigid, without what is random."""
    kept = {name: values for name, values in robot.effects.items() if EFFECTS.get(name).predicts}
    return ModelParams(
        effects={name: np.array(EFFECTS.get(name).params_from(values)) for name, values in kept.items()},
        learned=None if robot.learned_residual is None else LearnedResidual(robot.learned_residual),
    )


def effects_at(params: ModelParams, rows: int) -> list[EffectParams]:
    """Return the effects of a model with their parameters in every row, (E, P)."""
    found: list[EffectParams] = [
        (EFFECTS.get(name), torch.from_numpy(np.asarray(values, dtype=float)).expand(rows, -1))
        for name, values in params.effects.items()
    ]
    if params.learned is not None:
        found.append((params.learned, torch.ones(rows, 1, dtype=torch.float64)))
    return found


def key_of(params: ModelParams) -> tuple[object, ...]:
    """Return what tells effects and deviations of a model from those of others, their order included."""
    effects = [(name, np.asarray(values, dtype=float).tobytes()) for name, values in params.effects.items()]
    return (None if params.deviation is None else params.deviation.tobytes(), *effects)
