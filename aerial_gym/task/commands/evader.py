"""An evader that flees from all vehicles of its environment: the target of a pursuit.

Frames: world of each environment, z up. Letters: E environments, V vehicles of each, B = E V rows.
"""

from collections.abc import Mapping
from math import exp

import torch
from torch import Tensor

from aerial_gym.env_manager import EnvManager
from aerial_gym.errors import ConfigError
from aerial_gym.task.commands.command import COMMANDS, TARGET, Command
from aerial_gym.task.commands.points import make_goals
from aerial_gym.task.values import Values
from aerial_gym.task.vehicles.names import ALL

LEAST_DISTANCE = 0.1  # Distance below which repulsion no longer grows [m]
ACTION, IS_LEARNED = "evader_action", "evader_is_learned"  # Buffers with which a policy takes the place of the rule


@COMMANDS.register_class("evader")
class Evader(Command):
    """A point that flies away from vehicles and walls, the same for all vehicles of an environment.

    Its direction is that of ``sum of (e - p) / |e - p|³ + sum of n / d²``, with its place e, the places p of the vehicles, and
    the distances d and inward normals n of the six faces of the bounds. It follows with a first-order lag, and stays
    ``margin`` inside the bounds. Where ``evader_is_learned`` is true, a policy gives the wanted velocity (``evader_action``)
    in place of this rule, with the same largest speed and lag.

    Source:
        de Souza, Newbury, Cosgun, Castillo, Vidolov, Kulic (2021), Decentralized multi-agent pursuit using deep reinforcement
        learning, IEEE Robotics and Automation Letters 6(3); there in a plane, and with weights.
    """

    reads = (
        TARGET, "target_velocity", "evader_start", f"{ALL}robot_position", "env_bounds_min", "env_bounds_max", ACTION,
        IS_LEARNED,
    )  # fmt: skip

    def __init__(self, values: Values, env: EnvManager, *, speed: float, lag_s: float, margin: float) -> None:
        """Take its speed [m/s], time constant [s] and least distance from the bounds [m], all > 0."""
        super().__init__(values, env)
        if not (speed > 0.0 and lag_s > 0.0 and margin > 0.0):
            raise ConfigError(f"command evader: speed = {speed!r}, lag_s = {lag_s!r}, margin = {margin!r}: must be > 0")
        if env.vehicles is None or not env.cfg.reset_together:
            raise ConfigError(
                "command evader: needs several vehicles that end together. Give num_vehicles and reset_together"
            )
        self._speed, self._margin, self._dt, self._share = speed, margin, env.dt, 1.0 - exp(-env.dt / lag_s)
        self._target(moving=True)
        values.declare(
            ACTION, (3,), frame="world", meaning="velocity that a learned evader wants, in shares of its speed"
        )
        values.declare(IS_LEARNED, dtype=torch.bool, meaning="whether a policy moves the evader, in place of its rule")
        start = values.declare("evader_start", (3,), unit="m", frame="world", meaning="where the evader begins")
        self._starts = make_goals(
            start, env, (0.6, 0.2, 0.3), (0.8, 0.8, 0.7), self.name, random=env.rows.random.shared
        )

    def draw(self, mask: Tensor) -> None:
        """Draw where the evader begins."""
        self._starts.draw(mask)

    def next_values(self, values: Mapping[str, Tensor]) -> dict[str, Tensor]:
        """Return place and velocity of the evader in the next step."""
        place, low, high = values[TARGET], values["env_bounds_min"], values["env_bounds_max"]
        push = torch.zeros_like(place)
        for position in values[f"{ALL}robot_position"].unbind(1):
            away = place - position
            push = push + away / away.norm(dim=-1, keepdim=True).clamp_min(LEAST_DISTANCE) ** 3
        for face, inward in ((low, 1.0), (high, -1.0)):
            distance = (inward * (place - face)).clamp_min(LEAST_DISTANCE)
            push = push + inward / (distance * distance)
        rule = push / push.norm(dim=-1, keepdim=True).clamp_min(LEAST_DISTANCE)
        action = values[ACTION] / values[ACTION].norm(dim=-1, keepdim=True).clamp_min(1.0)
        wanted = self._speed * torch.where(values[IS_LEARNED].unsqueeze(-1), action, rule)
        velocity = values["target_velocity"] + self._share * (wanted - values["target_velocity"])
        moved = torch.minimum(torch.maximum(place + self._dt * velocity, low + self._margin), high - self._margin)
        begun = values["begun"].unsqueeze(-1)
        return {
            TARGET: torch.where(begun, values["evader_start"], moved),
            "target_velocity": torch.where(begun, 0.0, (moved - place) / self._dt),
        }
