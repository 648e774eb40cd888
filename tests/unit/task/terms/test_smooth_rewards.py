"""Rewards for learners by gradients: their numbers in closed form, and a slope wherever a robot comes to."""

from math import sqrt

import pytest
import torch

from aerial_gym import task_registry
from aerial_gym.task import REWARDS
from tests.unit.task.hover import build_task
from tests.unit.task.rewards import term_reward

F64 = torch.float64


def test_their_numbers_in_closed_form() -> None:
    """A robot at (3, 4, 0) from its target: 5 m; with 12 m of rounding 13. Squares of (1, 2, 2) are 9."""
    zero, there = torch.zeros(1, 3, dtype=F64), torch.tensor([[3.0, 4.0, 0.0]], dtype=F64)
    fast = torch.tensor([[1.0, 2.0, 2.0]], dtype=F64)

    def value(name: str, *read: torch.Tensor, **params: float) -> float:
        return float(REWARDS.get(name).value(*read, **params))

    assert value("distance_rounded", zero, there, offset=8.0, scale=2.0, width=12.0) == pytest.approx(-2.5)
    assert value("distance_rounded", zero, zero, offset=8.0, scale=1.0, width=0.5) == pytest.approx(7.5)
    assert value("speed_cost", fast, weight=0.1) == pytest.approx(-0.9)
    assert value("turning_cost", fast, weight=2.0) == pytest.approx(-18.0)
    assert value("velocity_error_cost", fast, 2.0 * fast, weight=1.0) == pytest.approx(-9.0)


@pytest.mark.parametrize("name", ["position_setpoint_task", "tracking_task"])
def test_a_smooth_task_draws_to_its_target_from_everywhere(name: str) -> None:
    """By 0.8 to 1 for a metre from 0.3 to 8 m, and by nothing that jumps at the target; the task itself by 0.1 beyond 3 m."""
    slopes = {}
    for task_name in (name, f"smooth_{name}"):
        task = build_task(task_registry.get(task_name), 1, gradients=F64)
        task.reset()
        reads = dict(task._judge.rows._reads)
        for distance in (0.0, 0.3, 3.0, 7.9):
            position = torch.tensor([[distance / sqrt(2.0), 0.0, distance / sqrt(2.0)]], dtype=F64, requires_grad=True)
            zeros = ("robot_linvel", "robot_body_angvel", "target_position", "target_velocity")
            now = {"robot_position": position} | dict.fromkeys(zeros, torch.zeros(1, 3, dtype=F64))
            now |= {"robot_orientation": torch.tensor([[0.0, 0.0, 0.0, 1.0]], dtype=F64)}
            reward = term_reward(task, reads | now)
            slopes[task_name, distance] = float(torch.autograd.grad(reward.sum(), position)[0].norm())
    assert slopes[f"smooth_{name}", 0.0] == 0.0
    assert all(0.8 < slopes[f"smooth_{name}", distance] <= 1.0 for distance in (0.3, 3.0, 7.9))
    assert all(slopes[name, distance] < 0.1 for distance in (3.0, 7.9))
