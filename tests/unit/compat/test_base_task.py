"""The base class of tasks that scripts write."""

import random

import numpy as np
import pytest
import torch

from aerial_gym.compat import BaseTask


class TaskConfig:
    def __init__(self, seed: int | None) -> None:
        self.seed = seed


def test_a_seed_reaches_what_scripts_use() -> None:
    def draws(seed: int) -> tuple[float, float, float]:
        BaseTask(TaskConfig(seed))
        return random.random(), float(np.random.rand()), torch.rand(1).item()

    assert draws(3) == draws(3)
    assert draws(3) != draws(4)


@pytest.mark.parametrize("seed", [None, -1])
def test_no_seed_leaves_them_alone(seed: int | None) -> None:
    torch.manual_seed(9)
    BaseTask(TaskConfig(seed))
    first = torch.rand(1)
    torch.manual_seed(9)
    assert torch.equal(first, torch.rand(1))


@pytest.mark.parametrize("method", ["reset", "step", "reset_idx", "render"])
def test_what_a_task_must_define_is_named(method: str) -> None:
    task = BaseTask(TaskConfig(None))
    with pytest.raises(NotImplementedError, match=f"BaseTask.{method}: the task class must define it"):
        getattr(task, method)(*([] if method in ("reset", "render") else [0]))
    task.close()
