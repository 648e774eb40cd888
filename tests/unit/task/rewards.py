"""The reward of given states, for tests."""

from collections.abc import Mapping

import torch
from torch import Tensor

from aerial_gym.task import Task
from aerial_gym.task.step.judge import Ends


def reward_of(task: Task, values: Mapping[str, Tensor], *, crash: Tensor | None = None) -> Tensor:
    """Return what the terms of a task make of states, (E,), in their own type of numbers."""
    rows = len(values["robot_position"])
    no = torch.zeros(rows, dtype=torch.bool)
    ended = no if crash is None else crash
    ends = Ends(crash=ended, success=no, terminated=ended, truncated=no, arrived=no, causes=[])
    return task._judge._reward(values, ends)[1]
