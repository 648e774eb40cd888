"""Resets one step after the end of an episode, beside the same task that resets in the step of the end."""

import pytest
import torch

from aerial_gym.errors import CapabilityError
from aerial_gym.task import Task, task_registry
from tests.refusals import assert_refused

STEPS = 4


@pytest.fixture
def tasks() -> tuple[Task, Task]:
    """The same task, reset in the step of an end and one step later; row 1 ends in the second step."""
    made = [task_registry.make_task("position_setpoint_task", num_envs=3, device="cpu", seed=4) for _ in range(2)]
    made[1].delay_resets()
    for task in made:
        task.reset()
        age = task.cfg.episode_len_steps - 2
        task.env.gtd["sim_steps"][:] = torch.tensor([0, age, 0], dtype=torch.int32)
    return made[0], made[1]


def fly(task: Task, steps: int = STEPS) -> list[tuple[torch.Tensor, ...]]:
    """Return observation, reward, terminated, truncated and episode of every step, copied."""
    action, flown = torch.full((3, 4), 0.1), []
    for _ in range(steps):
        observation, reward, terminated, truncated, _ = task.step(action)
        told = (observation["observations"], reward, terminated, truncated, task.env.gtd["episodes"])
        flown.append(tuple(value.clone() for value in told))
    return flown


def test_the_step_after_an_end_is_the_start_of_the_same_next_episode(tasks: tuple[Task, Task]) -> None:
    now, late = (fly(task) for task in tasks)
    for before, after in zip(now, late, strict=True):  # rows that do not end are untouched
        for one, other in zip(before, after, strict=True):
            assert torch.equal(one[[0, 2]], other[[0, 2]])
    assert [bool(step[3][1]) for step in late] == [False, True, False, False]
    assert [int(step[4][1]) for step in late] == [0, 0, 1, 1]
    assert torch.equal(late[2][0][1], now[1][0][1])  # the first observation of the next episode
    assert torch.equal(late[3][0][1], now[2][0][1])  # and the step after it
    assert (float(late[2][1][1]), float(late[1][1][1])) == (0.0, float(now[1][1][1]))


def test_the_last_observation_is_that_of_the_end(tasks: tuple[Task, Task]) -> None:
    for _ in range(2):
        observation, *_, info = tasks[1].step(torch.full((3, 4), 0.1))
    assert torch.equal(observation["observations"][1], info["final_observation"][1])


def test_a_step_between_episodes_is_in_no_tally(tasks: tuple[Task, Task]) -> None:
    """Row 1 has crashed: in the step between it is still out of bounds, and would end once more."""
    for task in tasks:
        task.env.gtd["robot_position"][1] = torch.tensor([9.0, 0.0, 0.0])
    for task, steps in zip(tasks, (STEPS - 1, STEPS), strict=True):
        crashes = [bool(step[2][1]) for step in fly(task, steps)]
        assert crashes == [True, *[False] * (steps - 1)]
    assert tasks[0].episode_means() == tasks[1].episode_means()
    assert torch.equal(tasks[0].episode_return[1], tasks[1].episode_return[1])


def test_a_reset_of_all_leaves_none_waiting(tasks: tuple[Task, Task]) -> None:
    late = tasks[1]
    fly(late, 2)
    assert late.values.own["waiting"].tolist() == [False, True, False]
    late.reset()
    assert not late.values.own["waiting"].any()
    assert late.env.gtd["episodes"].tolist() == [1, 1, 1]
    assert "task.waiting" in late.state_tensors()


def test_gradients_are_refused() -> None:
    task = task_registry.make_task("smooth_position_setpoint_task", num_envs=1, device="cpu", differentiable=True)
    assert_refused(CapabilityError, "delay_resets: call it before the first reset", task.delay_resets)
