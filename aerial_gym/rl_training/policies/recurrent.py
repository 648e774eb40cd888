"""A gated recurrent unit along a sequence in which episodes begin.

On a GPU products and sums that need not wait for one another are done at once, and all steps of a small unit are one launch.
Letters: T steps, E environments, F features, M numbers of memory.
"""

from importlib import import_module
from importlib.util import find_spec
from typing import Any

import torch
from torch import Tensor, nn
from torch.nn.functional import linear

SIZES = (16, 32, 64)  # Numbers of memory for which the weights stay in registers
TILE, WARPS = 16, 4  # Environments of a block, the least that Triton multiplies, and its warps


def unroll_memory(cell: nn.GRUCell, features: Tensor, memory: Tensor, begins: Tensor) -> Tensor:
    """Return the hidden states (T, E, M) of a unit for features (T, E, F), from a memory (E, M) before them. The memory is
    emptied at the steps where an episode ``begins``, bool (T, E)."""
    if features.is_cuda:
        entering = linear(features, cell.weight_ih, cell.bias_ih)
        small = cell.hidden_size in SIZES and features.dtype == torch.float32
        how = _FusedUnroll if small and find_spec("triton") is not None else _Unroll
        return how.apply(entering, memory, begins, cell.weight_hh, cell.bias_hh)  # pyright: ignore[reportReturnType]
    keep = (~begins).to(features.dtype).unsqueeze(-1)
    after = []
    for step, kept in zip(features, keep, strict=True):
        memory = cell(step, memory * kept)
        after.append(memory)
    return torch.stack(after)


class _Unroll(torch.autograd.Function):
    """The time steps: torch's kernel of the unit, except for the product of weights and memory."""

    @staticmethod
    def forward(ctx: Any, entering: Tensor, memory: Tensor, begins: Tensor, weight: Tensor, bias: Tensor) -> Tensor:
        keep = (~begins).to(entering.dtype).unsqueeze(-1)
        before, after, gates = [], [], []
        for step, kept in zip(entering, keep, strict=True):
            before.append(memory * kept)
            held = torch.addmm(bias, before[-1], weight.t())
            memory, gate = torch.ops.aten._thnn_fused_gru_cell(step, held, before[-1])
            after.append(memory)
            gates.append(gate)
        ctx.save_for_backward(keep, weight, torch.stack(before), *gates)
        return torch.stack(after)

    @staticmethod
    def backward(ctx: Any, *grad_outputs: Tensor) -> tuple[Tensor, ...]:
        (gradient,), (keep, weight, before, *gates) = grad_outputs, ctx.saved_tensors
        later, entering, held = torch.zeros_like(gradient[0]), [], []
        for step, kept, gate in zip(reversed(gradient), reversed(keep), reversed(gates), strict=True):
            of_entering, of_held, of_memory, *_ = torch.ops.aten._thnn_fused_gru_cell_backward(
                step + later, gate, False
            )
            later = torch.addmm(of_memory, of_held, weight) * kept
            entering.append(of_entering)
            held.append(of_held)
        return torch.stack(entering[::-1]), later, None, *_weight_gradients(torch.stack(held[::-1]), before)  # pyright: ignore[reportReturnType]


def _triton_kernels() -> Any:
    """Return the module of kernels, which needs the package triton: it comes with torch for CUDA."""
    return import_module("aerial_gym.rl_training.policies.recurrent_kernels")


class _FusedUnroll(torch.autograd.Function):
    """The steps in a kernel of their own."""

    @staticmethod
    def forward(ctx: Any, entering: Tensor, memory: Tensor, begins: Tensor, weight: Tensor, bias: Tensor) -> Tensor:
        steps, envs, size = *begins.shape, memory.shape[1]
        keeps = any(ctx.needs_input_grad)
        after = memory.new_empty(steps, envs, size)
        before, gates = torch.empty_like(after), memory.new_empty(steps, envs, 4 * size) if keeps else after
        begins, weight = begins.contiguous(), weight.contiguous()
        _triton_kernels().forward[(-(-envs // TILE),)](
            entering.contiguous(), memory.contiguous(), begins, weight, bias, steps, envs,
            after, before, gates, size=size, tile=TILE, keeps=keeps, precision="tf32x3", num_warps=WARPS,
        )  # fmt: skip
        ctx.save_for_backward(begins, weight, before, gates)
        return after

    @staticmethod
    def backward(ctx: Any, *grad_outputs: Tensor) -> tuple[Tensor, ...]:
        (gradient,), (begins, weight, before, gates) = grad_outputs, ctx.saved_tensors
        steps, envs, size = before.shape
        entering, held = (before.new_empty(steps, envs, 3 * size) for _ in range(2))
        memory = before.new_empty(envs, size)
        precision = "tf32" if torch.backends.cuda.matmul.allow_tf32 else "tf32x3"
        _triton_kernels().backward[(-(-envs // TILE),)](
            gradient.contiguous(), begins, weight, before, gates, steps, envs,
            entering, held, memory, size=size, tile=TILE, precision=precision, num_warps=WARPS,
        )  # fmt: skip
        return entering, memory, None, *_weight_gradients(held, before)  # pyright: ignore[reportReturnType]


def _weight_gradients(held: Tensor, before: Tensor) -> tuple[Tensor, Tensor]:
    """Return the gradients of weights (3 M, M) and bias (3 M,) from those of their products and the states before."""
    flat = held.flatten(0, 1)
    return flat.t() @ before.flatten(0, 1), flat.sum(0)
