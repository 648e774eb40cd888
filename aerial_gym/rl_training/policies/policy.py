"""Interface and implementation of policies: observations to actions, with a memory that is reset by mask.

Letters: E environments, U entries of an action, F features, M numbers of memory.
"""

from collections.abc import Mapping
from math import log
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
