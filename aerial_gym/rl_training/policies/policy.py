"""Policies: observations to actions, with a memory that is reset by mask, and the normal distribution of actions.

Letters: E environments, U entries of an action, F features, M numbers of memory.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from math import log, pi
from typing import Protocol

import torch
from torch import Tensor, nn

from aerial_gym.rl_training.policies.body import NetworkBody, NetworkBodyCfg


class Pilot(Protocol):
    """Interface of policies for evaluation and play."""

    def __call__(self, observation: Mapping[str, Tensor]) -> Tensor:
        """Return actions (E, U) in -1 to 1 for observations of E environments, by key."""
        ...

    def reset(self, mask: Tensor | None = None) -> None:
        """Clear the memory of the environments in ``mask``, bool (E,), or of all."""
        ...


class Policy(nn.Module):
    """A body, a linear head for the mean action, and a deviation for exploration; called, it flies the mean action.

    It needs no trainer installed, and is an ordinary ``torch.nn.Module`` with a pure function ``step``, which is exported.
    """

    def __init__(
        self, cfg: NetworkBodyCfg, num_actions: int, *, initial_std: float = 1.0, head_variance: float = 1.0
    ) -> None:
        """Make the network; the head's first weights have the variance ``head_variance / F``, its biases are 0."""
        super().__init__()
        self.body, self.num_actions = NetworkBody(cfg), num_actions
        self.head = nn.Linear(self.body.num_features, num_actions)
        nn.init.normal_(self.head.weight, std=(head_variance / self.body.num_features) ** 0.5)
        nn.init.zeros_(self.head.bias)
        self.log_std = nn.Parameter(torch.full((num_actions,), log(initial_std)))
        self._memory: Tensor | None = None

    @property
    def shapes(self) -> Mapping[str, tuple[int, ...]]:
        """Shapes of its inputs for one environment, by observation key."""
        return self.body.cfg.shapes

    def empty_memory(self, num_envs: int) -> Tensor:
        """Return the initial memory (E, M); M is 0 without a memory."""
        return self.head.weight.new_zeros(num_envs, self.body.memory_size)

    def step(self, observation: Mapping[str, Tensor], memory: Tensor) -> tuple[Tensor, Tensor]:
        """Return the mean action (E, U), not clamped, and the memory (E, M) after it."""
        features, memory = self.body(self.body.network_inputs(observation), memory)
        return self.head(features), memory

    def explore(self, observation: Mapping[str, Tensor], memory: Tensor, begins: Tensor) -> tuple[Tensor, Tensor]:
        """Return action and memory as ``step``, with an empty memory where an episode begins, bool (E,)."""
        return self.step(observation, memory * (~begins).unsqueeze(-1) if self.body.memory_size else memory)

    @torch.no_grad()
    def forward(self, observation: Mapping[str, Tensor]) -> Tensor:
        """Return the mean action (E, U), clamped to -1 to 1, and update the memory."""
        num_envs = len(next(iter(observation.values())))
        if not self.body.memory_size:
            return self.step(observation, self.empty_memory(num_envs))[0].clamp(-1.0, 1.0)
        if self._memory is None or len(self._memory) != num_envs:
            self._memory = self.empty_memory(num_envs)
        mean, self._memory = self.step(observation, self._memory)
        return mean.clamp(-1.0, 1.0)

    def reset(self, mask: Tensor | None = None) -> None:
        """Clear the memory of the environments in ``mask``, bool (E,), or of all."""
        if mask is None or self._memory is None:
            self._memory = None
        else:
            self._memory = self._memory.masked_fill(mask.unsqueeze(-1), 0.0)


@dataclass(frozen=True)
class Gaussian:
    """``N(mean, exp(log_std)²)`` of every entry."""

    mean: Tensor  # (..., U)
    log_std: Tensor  # (U,)

    def sample(self, noise: Tensor) -> Tensor:
        """Return actions (..., U) made of standard normal noise."""
        return torch.addcmul(self.mean, noise, self.log_std.exp())

    def log_prob(self, action: Tensor) -> Tensor:
        """Return the log density of actions (..., U), (...)."""
        normal = (action - self.mean) * (-self.log_std).exp()
        return -0.5 * (normal * normal).sum(-1) - (self.log_std.sum() + 0.5 * log(2.0 * pi) * self.log_std.shape[0])

    def entropy(self) -> Tensor:
        """Return the differential entropy [nat], ()."""
        return self.log_std.sum() + 0.5 * (1.0 + log(2.0 * pi)) * self.log_std.shape[0]

    def divergence(self, mean: Tensor, log_std: Tensor) -> Tensor:
        """Return ``KL(N(mean, exp(log_std)²) || self)`` [nat], (...)."""
        change = self.log_std - log_std
        apart = (mean - self.mean) * (-self.log_std).exp()
        return (change + 0.5 * ((-2.0 * change).exp() + apart * apart) - 0.5).sum(-1)
