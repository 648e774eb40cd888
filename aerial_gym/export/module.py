"""A policy from measurements to commands as one torch module: scaling, normaliser, network, limits and transform.

ReLU, limits and dead weights can each turn NaN into an ordinary number. Files in torch and in C99 therefore test the numbers
themselves, and make no command from NaN or infinity.
Letters: B rows, O entries of an observation, C x H x W an image, V entries of an action, U of a command, M numbers of memory.
"""

from collections.abc import Callable
from math import nan
from pathlib import Path
from typing import Any

import torch
from torch import Tensor, nn

from aerial_gym.export.layout import Layout
from aerial_gym.extras import optional_import, require
from aerial_gym.rl_training.policies.body import RunningNormalizer
from aerial_gym.rl_training.policies.policy import Policy
from aerial_gym.task import ACTIONS
from aerial_gym.task.images import TYPES
from aerial_gym.task.terms.term import check_params


def finite_rows(*parts: Tensor) -> Tensor:
    """Return whether all numbers of a row are finite, bool (B, 1); ``parts`` are (B, ...), integers are finite."""
    floats = [part for part in parts if part.is_floating_point()]
    return torch.stack([part.float().flatten(1).isfinite().all(-1) for part in floats]).all(0).unsqueeze(-1)


def nan_where_not_finite(finite: Tensor, numbers: Tensor) -> Tensor:
    """Return numbers (B, N), NaN in the rows that are not ``finite``, (B, 1)."""
    return torch.where(finite, numbers, nan)


C_FINITE = """/* Reads the bits: with -ffast-math, comparisons and isnan() do not see NaN. */
static int is_finite(const float *numbers, int count) {
    union { float number; uint32_t bits; } each;
    for (int i = 0; i < count; ++i) {
        each.number = numbers[i];
        if ((each.bits & 0x7f800000u) == 0x7f800000u) return 0;
    }
    return 1;
}
static void set_nan(float *numbers, int count) {
    const union { uint32_t bits; float number; } made = { 0x7fc00000u };
    for (int i = 0; i < count; ++i) numbers[i] = made.number;
}
"""
"""Functions that a C file uses for this; they need ``stdint.h``."""


def action_transform(layout: Layout) -> tuple[Callable[..., Tensor], dict[str, Any]]:
    """Return the transform from action to command, and its numbers."""
    value = ACTIONS.get(layout.transform).value
    return value, check_params(value, layout.params, f"action {layout.transform}")


class DeployablePolicy(nn.Module):
    """Scale, normaliser, network, limits and transform."""

    scale: Tensor

    def __init__(self, policy: Policy, layout: Layout) -> None:
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
        return tuple(nan_where_not_finite(finite, output) for output in outputs)

    def normalization(self) -> tuple[Tensor, Tensor, float | None]:
        """Return mean and standard deviation of the normaliser for scaled vectors, (O,), and its output limit. Without a
        normaliser they are 0, 1 and None."""
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


def onnx_bytes(
    module: nn.Module, given: tuple[Tensor, ...], inputs: list[str], outputs: list[str], dynamic: tuple[Any, ...]
) -> bytes:
    """Return a module as ONNX with ``dynamic`` dimensions, by ``torch.export``."""
    require("ONNX", "onnx", "onnxscript")
    program = torch.onnx.export(
        module, given, input_names=inputs, output_names=outputs, dynamic_shapes=dynamic, dynamo=True, verbose=False
    )
    assert program is not None
    return program.model_proto.SerializeToString()


def onnx_session(file: Path) -> Any:
    """Return the session of an ONNX file on the CPU; raise ``MissingDependencyError`` without onnxruntime."""
    with optional_import("flying an ONNX file"):
        import onnxruntime
    return onnxruntime.InferenceSession(str(file), providers=["CPUExecutionProvider"])


def torchscript_bytes(module: nn.Module, given: tuple[Tensor, ...]) -> bytes:
    """Return a module as TorchScript, traced with inputs of the right shapes."""
    traced = torch.jit.trace(module, given)
    return traced.save_to_buffer()  # pyright: ignore[reportAttributeAccessIssue, reportFunctionMemberAccess]
