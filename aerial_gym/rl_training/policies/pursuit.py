"""A learned evader in flight: its actions in the buffers of a pursuit task.

Letters: E environments, V pursuers of each, B = E V rows, U entries of an action.
"""

from collections.abc import Mapping

import torch
from torch import Tensor

from aerial_gym.errors import ConfigError
from aerial_gym.rl_training.policies.policy import Pilot, Policy
from aerial_gym.task import Task
from aerial_gym.task.commands.evader import ACTION, IS_LEARNED


def set_evader(task: Task, action: Tensor, learned: Tensor | bool) -> None:
    """Set the evaders' actions, (E, U), and where they replace the rule, bool (E,) or one value."""
    shape = (-1, task.num_vehicles)
    task.values.own[ACTION].unflatten(0, shape).copy_(action.unsqueeze(1))
    flags = task.values.own[IS_LEARNED].unflatten(0, shape)
    flags.copy_(learned.unsqueeze(1) if isinstance(learned, Tensor) else torch.full_like(flags, learned))


class PursuitPilot:
    """Policy of pursuers that also moves the evader by a policy."""

    def __init__(self, pursuers: Pilot, evader: Policy, task: Task) -> None:
        """Take both policies and the task, which must be a pursuit."""
        if ACTION not in task.values.own or any(task.observation_shapes.get(k) != v for k, v in evader.shapes.items()):
            raise ConfigError("evader: the task has no evader with its observations. Fly the task of its training")
        self._pursuers, self._evader, self._task = pursuers, evader, task

    def __call__(self, observation: Mapping[str, Tensor]) -> Tensor:
        """Return the pursuers' actions (B, U), and set those of the evaders."""
        rows = {key: value[:: self._task.num_vehicles] for key, value in observation.items()}
        set_evader(self._task, self._evader(rows), learned=True)
        return self._pursuers(observation)

    def reset(self, mask: Tensor | None = None) -> None:
        """Clear the memory of the pursuers in ``mask``, bool (B,), or of all."""
        self._pursuers.reset(mask)
