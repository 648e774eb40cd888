"""A policy that sees bytes of images beside a vector learns what only the image says."""

from typing import ClassVar

import pytest
import torch
from torch import Tensor

from aerial_gym.rl_training.evaluation import evaluate
from aerial_gym.rl_training.policies.load import check_fits, policy_from_payload
from aerial_gym.rl_training.trainers.ppo import PpoTrainer
from tests.unit.rl_training.learning.test_memory import GuessTask, late_cost
from tests.unit.rl_training.learning.test_ppo import settings
from tests.unit.task.hover import camera_task


class ColumnTask(GuessTask):
    """A bright column stands left or right in the image, beside a vector that says nothing."""

    num_envs, length, truncated = 32, 4, True
    observation_shapes: ClassVar = {"observations": (2,), "depth": (1, 8, 12)}

    def observe(self) -> dict[str, Tensor]:
        image = torch.zeros(32, 1, 8, 12, dtype=torch.uint8)
        image[torch.arange(32), 0, :, 2 + 7 * (self.drawn > 0.0)] = 255
        return {"observations": torch.zeros(32, 2), "depth": image}


@pytest.mark.slow
def test_an_image_tells_what_a_vector_does_not() -> None:
    """Without it the best action is 0, which costs 0.64; the final image is that of the step before, as the task gives none."""
    assert late_cost(ColumnTask(), 40, policy_keys=("observations", "depth")) < 0.1
    assert late_cost(ColumnTask(), 40, policy_keys=("observations",)) > 0.6


def test_a_task_with_a_camera_is_trained_with_a_memory_and_a_critic_that_sees_better() -> None:
    keys = {"policy_keys": ("observations", "depth"), "critic_keys": ("observations", "exact")}
    cfg = settings(8, memory=6, horizon=4, num_minibatches=2, num_epochs=1, hidden_layers=(8,), **keys)
    with camera_task(8, capture=False) as task:
        training = PpoTrainer().make_training(cfg, task)
        for _ in range(2):
            training.advance()
        state = training.state()
        policy = policy_from_payload(state, cfg, where="test")
        check_fits(policy, task, cfg.task)
        assert set(policy.shapes) == {"observations", "depth"}
        assert evaluate(policy, task).num_starts == 8
        again = PpoTrainer().make_training(cfg, task)
        again.load(state)
        assert again.env_steps == training.env_steps == 2 * 4 * 8
