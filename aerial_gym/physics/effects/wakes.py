"""Wakes of all other vehicles of an environment. Letters: E vehicles of one kind, P parameters of the law."""

from dataclasses import replace
from math import inf

import torch
from torch import Tensor

from aerial_gym.config.randomize import Randomize
from aerial_gym.config.robot import RobotCfg
from aerial_gym.physics.effects.air_motion import Downwash
from aerial_gym.physics.effects.base import ANY_ROTOR, Effect, Parameter
from aerial_gym.physics.effects.by_kind import EffectParams
from aerial_gym.physics.effects.catalog import EFFECTS
from aerial_gym.physics.effects.condition import Condition
from aerial_gym.physics.effects.kinds import WrenchEffect


class WakeSum(WrenchEffect):
    """Sum of a law of downwash over all other vehicles, which a pass before each launch computes and the launch holds.

    The last parameter is this sum. The simulator makes this effect from a law; robot files name the law.
    """

    rotors = ANY_ROTOR

    def __init__(self, wake: Downwash) -> None:
        """Take the law of the wake of one vehicle, whose name and parameters it keeps."""
        self.wake = wake
        for name in ("name", "summary", "excitation", "confused_with"):
            setattr(self, name, getattr(wake, name))
        present = Parameter("present", "N", 0.0, inf, 1.0, "downward force of all wakes in the present launch")
        self.parameters = (*wake.parameters, present)

    def wrench(self, condition: Condition, params: Tensor) -> Tensor:
        """Return force and torque (E, 6)."""
        force = -params[:, -1:] * condition.up
        return torch.cat((force, torch.zeros_like(force)), dim=-1)


def hold_wake(effect: Effect, params: Tensor) -> EffectParams:
    """Return a law of downwash with parameters (E, P) as a held sum without force; other effects are returned unchanged."""
    if not isinstance(effect, Downwash):
        return effect, params
    return WakeSum(effect), torch.cat((params, torch.zeros_like(params[:, :1])), dim=1)


def without_wakes(robot: RobotCfg, randomize: Randomize) -> tuple[RobotCfg, Randomize]:
    """Return the robot and its draws without laws of downwash: far from other vehicles there is none."""

    def acts(name: str) -> bool:
        return not isinstance(EFFECTS.get(name), Downwash)

    effects = {name: values for name, values in robot.effects.items() if acts(name)}
    drawn = {key: cfg for key, cfg in randomize.items() if not key.startswith("effects.") or acts(key.split(".")[1])}
    return robot if len(effects) == len(robot.effects) else replace(robot, effects=effects), drawn
