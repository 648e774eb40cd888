"""A policy that sees bytes of images beside a vector learns what only the image says."""

from dataclasses import replace
from typing import ClassVar

import pytest
import torch
from torch import Tensor

from aerial_gym.rl_training.evaluation import evaluate
from aerial_gym.rl_training.learning.ppo import Ppo
from aerial_gym.rl_training.policies.load import check_fits, make_network, policy_from_payload
from aerial_gym.rl_training.trainers.ppo import PpoTrainer
from tests.unit.rl_training.learning.test_ppo import settings
from tests.unit.task.hover import camera_task

ENVS, LENGTH = 32, 4


class ColumnTask:
    """A bright column stands left or right in the image; an action costs the square of its distance to -0.8 or 0.8."""

    num_envs, num_actions, device = ENVS, 1, torch.device("cpu")
    observation_shapes: ClassVar = {"observations": (2,), "depth": (1, 8, 12)}

    def __init__(self) -> None:
        self.generator, self.age = torch.Generator().manual_seed(0), torch.arange(ENVS) % LENGTH
        self.side = self._draw()

    def _draw(self) -> Tensor:
        return torch.randint(0, 2, (ENVS,), generator=self.generator)

    def _observe(self) -> dict[str, Tensor]:
        image = torch.zeros(ENVS, 1, 8, 12, dtype=torch.uint8)
        image[torch.arange(ENVS), 0, :, 2 + 7 * self.side] = 255
        return {"observations": torch.zeros(ENVS, 2), "depth": image}

    def reset(self) -> tuple[dict[str, Tensor], dict[str, Tensor]]:
        return self._observe(), {}

    def stagger(self) -> None:
        """The ages are staggered from the start."""

    def step(self, actions: Tensor) -> tuple[dict[str, Tensor], Tensor, Tensor, Tensor, dict[str, Tensor]]:
        reward = -((actions[:, 0] - 0.8 * (2.0 * self.side - 1.0)) ** 2)
        self.age = self.age + 1
        ended = self.age == LENGTH
        info = {"final_observation": torch.zeros(ENVS, 2), "episode_return": reward, "episode_length": self.age}
        self.age = torch.where(ended, 0, self.age)
        self.side = torch.where(ended, self._draw(), self.side)
        return self._observe(), reward, torch.zeros_like(ended), ended, info


def late_cost(keys: tuple[str, ...]) -> float:
    """Return the mean cost of an action after 40 iterations, exploration included."""
    cfg = settings(ENVS, policy_keys=keys, horizon=8, num_minibatches=2, hidden_layers=(16,), initial_std=0.3)
    cfg = replace(cfg, ppo=replace(cfg.ppo, num_epochs=4, discount=0.9, max_learning_rate=5e-3, min_std=0.01))
    task = ColumnTask()
    learner = Ppo(cfg, task, make_network(cfg, task))
    learner.begin()
    for _ in range(40):
        learner.iterate()
    with torch.no_grad():
        return float(-learner._fly().reward.mean())


@pytest.mark.slow
def test_an_image_tells_what_a_vector_does_not() -> None:
    """Without it the best action is 0, which costs 0.64; the final image is that of the step before, as the task gives none."""
    assert late_cost(("observations", "depth")) < 0.1
    assert late_cost(("observations",)) > 0.6


def test_a_task_with_a_camera_is_trained_with_a_memory_and_a_critic_that_sees_better() -> None:
    """The policy sees bytes of two images, the critic floats; the checkpoint flies without the critic."""
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
