"""A point to which a hung load is to be carried. Frames: world of each environment, z up. Letters: E environments."""

from collections.abc import Mapping

import torch
from torch import Tensor

from aerial_gym.config.robot import Vec3
from aerial_gym.env_manager import EnvManager
from aerial_gym.errors import ConfigError
from aerial_gym.task.commands.command import COMMANDS, TARGET, Command
from aerial_gym.task.commands.points import goals_within
from aerial_gym.task.values import Values

LOAD_PARAMS = "effect_slung_payload"
"""Key of the GTD: mass, length and damping of the load."""


@COMMANDS.generator("load_point")
class LoadPoint(Command):
    """``load_target``, drawn uniformly at every reset, for the load; the robot's target is a link's length above it."""

    goal = True

    def __init__(self, values: Values, env: EnvManager, *, low: Vec3, high: Vec3) -> None:
        """Take the lowest and the highest point for the load as shares of the bounds, 0 <= low <= high <= 1."""
        super().__init__(values, env)
        if LOAD_PARAMS not in env.gtd:
            raise ConfigError("command load_point: nothing hangs on the robot. Give it the effect slung_payload")
        load = values.declare("load_target", (3,), unit="m", frame="world", meaning="where to carry the load")
        self._goals = goals_within(load, env, low, high, self.name)
        self._target()
        self.reads = ("load_target", LOAD_PARAMS)

    def at(self, values: Mapping[str, Tensor]) -> dict[str, Tensor]:
        """Return where the robot is when the load hangs at rest at its target."""
        x, y, z = values["load_target"].unbind(-1)
        return {TARGET: torch.stack((x, y, z + values[LOAD_PARAMS][:, 1]), dim=-1)}

    def after(self, values: Mapping[str, Tensor]) -> dict[str, Tensor]:
        """Return the same: where an episode has just begun, the target and the link are others."""
        return self.at(values)

    def draw(self, mask: Tensor) -> None:
        """Draw new points."""
        self._goals.draw(mask)
