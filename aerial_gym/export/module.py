"""A policy with all that stands between measurements and commands, as one torch module.

Letters: B rows, O entries of an observation, V of an action, U of a command, M numbers of memory.
"""

from collections.abc import Callable
from typing import Any

import torch
from torch import Tensor, nn

from aerial_gym.export.layout import Layout
from aerial_gym.rl_training.policies.normalizer import RunningNormalizer
from aerial_gym.rl_training.policies.policy import Policy
from aerial_gym.task import ACTIONS
from aerial_gym.task.terms.term import checked


def transform_of(layout: Layout) -> tuple[Callable[..., Tensor], dict[str, Any]]:
    """Return the transform from action to command, and its numbers."""
    value = ACTIONS.get(layout.transform).value
    return value, checked(value, layout.params, f"action {layout.transform}")


class FlownPolicy(nn.Module):
    """Scale, normaliser, network, limits and transform."""

    scale: Tensor

    def __init__(self, policy: Policy, layout: Layout) -> None:
        """Take a policy and its layout."""
        super().__init__()
        self.policy, self._layout = policy, layout
        self._transform, self._params = transform_of(layout)
        self._widths = [shape[0] for shape in policy.shapes.values()]
        scale = [torch.full((seen.count,), seen.scale) for seen in layout.observation]
        self.register_buffer("scale", torch.cat(scale))

    def forward(self, observation: Tensor, memory: Tensor | None = None) -> tuple[Tensor, ...]:
        """Return command (B, U) and action (B, V) of observations (B, O); with a memory (B, M) also what it is afterwards."""
        parts = (observation * self.scale).split(self._widths, dim=-1)
        given = dict(zip(self.policy.shapes, parts, strict=True))
        before = observation[:, :0] if memory is None else memory
        mean, after = self.policy.step(given, before)
        action = mean.clamp(-1.0, 1.0)
        command = self._transform(action, **self._params)
        return (command, action) if memory is None else (command, action, after)

    def normalized(self) -> tuple[Tensor, Tensor, float | None]:
        """Return mean and deviation that the scaled observation is normalised by, (O,), and the limit of what comes out.

        Without a normaliser they are 0, 1 and None.
        """
        mean, std, limit, normalizers = [], [], None, dict(self.policy.body.normalizers.items())
        for key, shape in self.policy.shapes.items():
            normalizer = normalizers.get(key)
            if isinstance(normalizer, RunningNormalizer):
                limit = normalizer.limit
                mean.append(normalizer.mean)
                std.append(normalizer.std)
            else:
                mean.append(torch.zeros(shape))
                std.append(torch.ones(shape))
        return torch.cat(mean), torch.cat(std), limit

    def example(self, rows: int = 2) -> tuple[Tensor, ...]:
        """Return inputs of the right shapes."""
        seen = torch.zeros(rows, len(self.scale))
        return (seen, torch.zeros(rows, self._layout.memory)) if self._layout.memory else (seen,)

    @property
    def names(self) -> tuple[list[str], list[str]]:
        """Return the names of what goes in and of what comes out."""
        inputs, outputs = ["observation", "memory"], ["command", "action", "memory_after"]
        return (inputs, outputs) if self._layout.memory else (inputs[:1], outputs[:2])
