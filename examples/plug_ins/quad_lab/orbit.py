"""A command: a target on a horizontal circle around the origin."""

from collections.abc import Mapping

import torch
from torch import Tensor

from aerial_gym.env_manager import EnvManager
from aerial_gym.task import Command
from aerial_gym.task.values import Values


class Orbit(Command):
    """A target that turns about the vertical through the origin, from +x at the begin of an episode."""

    name = "orbit"
    reads = ("sim_steps",)

    def __init__(
        self, values: Values, env: EnvManager, *, radius: float, period: float = 10.0, height: float = 1.0
    ) -> None:
        """Take radius [m], period [s] and height [m], and declare the target."""
        super().__init__(values, env)
        self._radius, self._rate, self._height = radius, 2.0 * torch.pi * env.dt / period, height
        self._target()

    def current_values(self, values: Mapping[str, Tensor]) -> dict[str, Tensor]:
        """Return the target at this instant."""
        angle = self._rate * values["sim_steps"]
        x, y = self._radius * torch.cos(angle), self._radius * torch.sin(angle)
        return {"target_position": torch.stack((x, y, torch.full_like(x, self._height)), dim=-1)}
