"""Whatever a task remembers or draws is the same alone and among many, and goes on from a saved state, bit for bit."""

from collections.abc import Callable

import pytest
import torch
from torch import Tensor

from aerial_gym.task import Task
from tests.unit.task.hover import camera_task, rich


def fly(task: Task, first: int = 0, *, steps: int = 9) -> list[dict[str, Tensor]]:
    results, number = [], torch.arange(first, first + task.num_envs)
    for step in range(steps):
        task.env.gtd["sim_steps"].masked_fill_((number + step) % 4 == 0, task.cfg.episode_len_steps)
        actions = 0.3 * torch.sin(number.float().unsqueeze(-1) + step + torch.arange(4.0))
        observation, reward, terminated, truncated, info = task.step(actions)
        row = {"reward": reward, "terminated": terminated, "truncated": truncated} | info
        row |= {f"observed {name}": value for name, value in observation.items()}
        row |= {"command": task.env.gtd["robot_actions"], "target": task.target_position}
        results.append({name: value.clone() for name, value in row.items()})
    return results


def assert_same(result: list[dict[str, Tensor]], expected: list[dict[str, Tensor]], rows: slice) -> None:
    for a, b in zip(result, expected, strict=True):
        assert a.keys() == b.keys()
        assert not [name for name in a if not torch.equal(a[name], b[name][rows])]


MAKERS = pytest.mark.parametrize("maker", [rich, camera_task])


@MAKERS
def test_a_saved_state_goes_on_the_same_in_another_task(maker: Callable[..., Task]) -> None:
    task, other = maker(5, seed=1), maker(5, seed=2)
    task.reset()
    fly(task)
    state = task.save_state()
    expected = fly(task)
    other.reset()
    fly(other, steps=2)
    other.load_state(state)
    assert_same(fly(other), expected, slice(None))


@MAKERS
def test_a_reset_forgets_what_came_earlier(maker: Callable[..., Task]) -> None:
    task = maker(3, seed=1)
    task.reset(seed=1)
    expected = fly(task)
    task.reset(seed=1)
    assert_same(fly(task), expected, slice(None))
