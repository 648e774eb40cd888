"""A policy behind a link that loses observation packets. Letters: E environments."""

from collections.abc import Mapping

import torch
from torch import Tensor

from aerial_gym.math.random import Purpose, Randomness, state_of_count, uniform_draw
from aerial_gym.rl_training.policies.policy import Pilot


class LossyPilot:
    """Flies a policy that sees the last observation that arrived, in steps whose packet is lost; the first one arrives."""

    def __init__(self, policy: Pilot, loss: Tensor, random: Randomness) -> None:
        """Take the policy, the probability of a loss (E,), and the counters of the task."""
        self._policy, self._loss, self._random = policy, loss, random
        self._seen: dict[str, Tensor] = {}
        self._step = 0

    def __call__(self, observation: Mapping[str, Tensor]) -> Tensor:
        """Return the actions for the observations that arrived."""
        draw = uniform_draw(state_of_count(self._random.stream(Purpose.PACKETS), self._step), dtype=self._loss.dtype)
        lost = (draw < self._loss) & (self._step > 0)
        for key, value in observation.items():
            rows = lost.view(-1, *[1] * (value.ndim - 1))
            self._seen[key] = torch.where(rows, self._seen.get(key, value), value)
        self._step += 1
        return self._policy(self._seen)

    def reset(self, mask: Tensor | None = None) -> None:
        """Clear the memory of the policy."""
        self._policy.reset(mask)
