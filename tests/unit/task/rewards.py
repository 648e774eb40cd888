"""The reward of given states, for tests."""

from collections.abc import Mapping

import torch
from torch import Tensor

from aerial_gym.task import Task
from aerial_gym.task.step.judge import EpisodeEnds


def term_reward(task: Task, values: Mapping[str, Tensor], *, crash: Tensor | None = None) -> Tensor:
    """Return the reward of a task's terms for given states, (E,), in the float type of the states."""
    no = torch.zeros(len(values["robot_position"]), dtype=torch.bool)
    ended = no if crash is None else crash
    ends = EpisodeEnds(crash=ended, success=no, terminated=ended, truncated=no, arrived=no, causes=[])
    return task._judge._reward_terms(values, ends)[1]
