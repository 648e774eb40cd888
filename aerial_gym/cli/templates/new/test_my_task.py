"""Test of ``my_task.yaml``: it builds, and random actions give finite observations and rewards."""

from pathlib import Path

import torch

from aerial_gym import task_registry

FILE = Path(__file__).with_name("my_task.yaml")


def test_random_actions_give_finite_numbers() -> None:
    task = task_registry.make_task(str(FILE), num_envs=8, device="cpu")
    observation, _ = task.reset()
    for _ in range(20):
        observation, reward, *_ = task.step(2.0 * torch.rand(8, 4) - 1.0)
        assert torch.isfinite(reward).all()
    assert torch.isfinite(observation["observations"]).all()
