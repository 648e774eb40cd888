"""Rewards that are sums of terms are those of the functions that came before them, as these were recorded.

``recorded/rewards.json``: 24 states and their rewards in float64, and 30 steps of 5 environments in float32 with a crash beyond
every limit, time-outs and resets, by the functions ``position_setpoint`` and ``navigation`` of version b0c03e3.
The flights were recorded anew by version 57f91bf, which agreed with those, with the right inertia of ``base_quadrotor``.
"""

import json
from pathlib import Path

import pytest
import torch

from aerial_gym import task_registry
from aerial_gym.task import Task
from tests.unit.task.navigation import make
from tests.unit.task.rewards import term_reward

RECORDED = json.loads((Path(__file__).parent / "recorded" / "rewards.json").read_text())
TASKS = ("position_setpoint_task", "navigation_task")


def build(name: str, **changes: object) -> Task:
    if name == "navigation_task":
        return make(5, seed=3, **changes)
    return task_registry.make_task(name, num_envs=5, device="cpu", seed=3)


@pytest.mark.parametrize("name", TASKS)
def test_the_sum_of_terms_is_the_recorded_reward(name: str) -> None:
    """Round-off of sums of some ten numbers of order one to a hundred in float64."""
    task = build(name)
    values = {key: torch.tensor(value, dtype=torch.float64) for key, value in RECORDED["state"].items()}
    values["difficulty"] = torch.tensor(RECORDED["difficulty"], dtype=torch.float64)
    result = term_reward(task, values, crash=torch.tensor(RECORDED["crashed"]))
    expected = torch.tensor(RECORDED["rewards"][name], dtype=torch.float64)
    torch.testing.assert_close(result, expected, rtol=1e-12, atol=1e-12)


@pytest.mark.parametrize("name", TASKS)
def test_a_flight_is_rewarded_and_ends_as_recorded(name: str) -> None:
    """What ends, ends in the same step; rewards and the last observation are the same but for float32 and 30 steps of flight.

    Another processor adds and multiplies in another order: 4e-5 of a reward was seen. The sums are held to 1e-12 above.
    """
    task = build(name, episode_len_steps=12) if name == "navigation_task" else build(name)
    recorded, generator = RECORDED["flights"][name], torch.Generator().manual_seed(1)
    task.reset()
    for step in range(30):
        if step % 7 == 6:
            task.env.gtd["sim_steps"][step % 5] = task.cfg.episode_len_steps
        actions = 2.0 * torch.rand(5, 4, generator=generator) - 1.0
        if step == 10:
            task.env.gtd["robot_position"][1] += 40.0
        obs, reward, terminated, truncated, info = task.step(actions)
        torch.testing.assert_close(reward, torch.tensor(recorded["reward"][step]), rtol=5e-4, atol=5e-4)
        assert (terminated.int() + 2 * truncated.int()).tolist() == recorded["ends"][step]
        torch.testing.assert_close(info["reward_terms"].sum(dim=-1), info["episode_return"], rtol=1e-5, atol=1e-4)
    torch.testing.assert_close(obs["observations"], torch.tensor(recorded["observation"]), rtol=5e-4, atol=5e-4)
