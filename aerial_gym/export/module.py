"""A policy from measurements to commands as one torch module: scaling, normaliser, network, limits and transform.

Letters: B rows, O entries of an observation, C x H x W an image, V entries of an action, U of a command, M numbers of memory.
"""

from collections.abc import Callable
from typing import Any

import torch
from torch import Tensor, nn

from aerial_gym.export.finite import finite_rows, nan_unless
from aerial_gym.export.layout import Layout
from aerial_gym.rl_training.policies.normalizer import RunningNormalizer
from aerial_gym.rl_training.policies.policy import Policy
from aerial_gym.task import ACTIONS
from aerial_gym.task.images import TYPES
from aerial_gym.task.terms.term import check_params


def action_transform(layout: Layout) -> tuple[Callable[..., Tensor], dict[str, Any]]:
    """Return the transform from action to command, and its numbers."""
    value = ACTIONS.get(layout.transform).value
    return value, check_params(value, layout.params, f"action {layout.transform}")


class DeployablePolicy(nn.Module):
    """Scale, normaliser, network, limits and transform."""

    scale: Tensor

    def __init__(self, policy: Policy, layout: Layout) -> None:
        """Take a policy and its layout."""
        super().__init__()
        self.policy, self._layout = policy, layout
        self._transform, self._params = action_transform(layout)
        self._vectors = {key: shape[0] for key, shape in policy.shapes.items() if len(shape) == 1}
        self._images = [image.key for image in layout.images]
        scale = [torch.full((seen.count,), seen.scale) for seen in layout.observation]
        self.register_buffer("scale", torch.cat(scale))

    def forward(self, observation: Tensor, *more: Tensor) -> tuple[Tensor, ...]:
        """Return command (B, U) and action (B, V) of observations (B, O), and the next memory (B, M) if there is one.

        A row is NaN throughout if a number that goes in, or the action before its limits, is NaN or infinite.

        Args:
            observation: Vectors in their own units, (B, O).
            more: The images of the layout, (B, C, H, W) each, and the memory (B, M) if there is one.
        """
        parts = (observation * self.scale).split(list(self._vectors.values()), dim=-1)
        given = dict(zip(self._vectors, parts, strict=True)) | dict(zip(self._images, more, strict=False))
        memory = more[len(self._images)] if self._layout.memory else None
        mean, after = self.policy.step(given, observation[:, :0] if memory is None else memory)
        action = mean.clamp(-1.0, 1.0)
        outputs = (self._transform(action, **self._params), action, *(() if memory is None else (after,)))
        finite = finite_rows(observation, *more, mean)
        return tuple(nan_unless(finite, output) for output in outputs)

    def normalization(self) -> tuple[Tensor, Tensor, float | None]:
        """Return mean and standard deviation of the normaliser for scaled vectors, (O,), and its output limit.

        Without a normaliser they are 0, 1 and None.
        """
        pairs, limit, normalizers = [], None, dict(self.policy.body.normalizers.items())
        for key, width in self._vectors.items():
            normalizer = normalizers.get(key)
            if isinstance(normalizer, RunningNormalizer):
                limit = normalizer.limit
                pairs.append((normalizer.mean, normalizer.std))
            else:
                pairs.append((torch.zeros(width), torch.ones(width)))
        mean, std = map(torch.cat, zip(*pairs, strict=True))
        return mean, std, limit

    def example_inputs(self, rows: int = 2) -> tuple[Tensor, ...]:
        """Return inputs of the right shapes."""
        given = [torch.zeros(rows, len(self.scale))]
        given += [torch.zeros(rows, *each.shape, dtype=TYPES[each.dtype][0]) for each in self._layout.images]
        return (*given, torch.zeros(rows, self._layout.memory)) if self._layout.memory else tuple(given)

    @property
    def input_and_output_names(self) -> tuple[list[str], list[str]]:
        """Return the names of inputs and outputs."""
        inputs, outputs = ["observation", *self._images, "memory"], ["command", "action", "memory_after"]
        return (inputs, outputs) if self._layout.memory else (inputs[:-1], outputs[:2])

    @property
    def output_names(self) -> list[str]:
        """Name of each output entry, in order."""
        made = self._layout
        counted = [("action", made.num_actions), ("memory", made.memory)]
        return [*made.command, *(f"{name} {i}" for name, count in counted for i in range(count))]
