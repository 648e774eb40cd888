"""A recurrent policy learns what only a memory can know, across the seams of segments and not across those of episodes."""

from dataclasses import replace
from typing import ClassVar

import pytest
import torch
from torch import Tensor

from aerial_gym.rl_training.learning.ppo import Ppo
from aerial_gym.rl_training.policies.load import make_network
from tests.unit.rl_training.learning.test_ppo import settings

ENVS, LENGTH = 64, 5


class Recall:
    """Each episode shows -0.8 or 0.8 once, then nothing; an action costs the square of its distance to what was shown."""

    num_envs, num_actions, device = ENVS, 1, torch.device("cpu")
    observation_shapes: ClassVar = {"observations": (1,)}

    def __init__(self) -> None:
        self.generator = torch.Generator().manual_seed(0)
        self.age = torch.arange(ENVS) % LENGTH
        self.shown = self._draw()

    def _draw(self) -> Tensor:
        return 0.8 * (2.0 * torch.randint(0, 2, (ENVS,), generator=self.generator) - 1.0)

    def _observe(self) -> dict[str, Tensor]:
        return {"observations": torch.where(self.age == 0, self.shown, 0.0).unsqueeze(-1)}

    def reset(self) -> tuple[dict[str, Tensor], dict[str, Tensor]]:
        return self._observe(), {}

    def stagger(self) -> None:
        """The ages are staggered from the start."""

    def step(self, actions: Tensor) -> tuple[dict[str, Tensor], Tensor, Tensor, Tensor, dict[str, Tensor]]:
        reward = -((actions[:, 0] - self.shown) ** 2)
        self.age = self.age + 1
        ended = self.age == LENGTH
        info = {"final_observation": torch.zeros(ENVS, 1), "episode_return": reward, "episode_length": self.age}
        self.age = torch.where(ended, 0, self.age)
        self.shown = torch.where(ended, self._draw(), self.shown)
        return self._observe(), reward, ended, torch.zeros_like(ended), info


def late_cost(memory: int) -> float:
    """Return the mean cost of an action after 60 iterations, exploration included."""
    cfg = settings(ENVS, memory=memory, horizon=8, num_minibatches=2, hidden_layers=(16,), initial_std=0.3)
    cfg = replace(cfg, ppo=replace(cfg.ppo, num_epochs=4, discount=0.9, max_learning_rate=5e-3, min_std=0.01))
    task = Recall()
    learner = Ppo(cfg, task, make_network(cfg, task))
    learner.begin()
    for _ in range(60):
        learner.iterate()
    with torch.no_grad():
        return float(-learner._fly().reward.mean())


@pytest.mark.slow
def test_a_memory_learns_what_was_shown_before_and_without_one_it_cannot_be_known() -> None:
    """Without a memory the best action is what is seen, 0.8 off in four steps of five: 0.64 * 4 / 5 = 0.512."""
    assert late_cost(16) < 0.1
    assert late_cost(0) > 0.5
