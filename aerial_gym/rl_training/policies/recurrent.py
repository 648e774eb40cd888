"""A gated recurrent unit along a sequence in which episodes begin.

On a GPU products and sums that need not wait for one another are done at once: what enters all steps before them, the
gradients of the weights behind them. Letters: T steps, E environments, F features, M numbers of memory.
"""

from typing import Any

import torch
from torch import Tensor, nn
from torch.nn.functional import linear


def along(cell: nn.GRUCell, features: Tensor, memory: Tensor, begins: Tensor) -> Tensor:
    """Return what is remembered after each step, (T, E, M).

    Args:
        cell: The unit.
        features: (T, E, F).
        memory: What was remembered before the sequence, (E, M).
        begins: Whether an episode begins with this step, bool, (T, E): the memory is then empty.
    """
    keep = (~begins).to(features.dtype).unsqueeze(-1)
    if features.is_cuda:
        entering = linear(features, cell.weight_ih, cell.bias_ih)
        return _Along.apply(entering, memory, keep, cell.weight_hh, cell.bias_hh)  # pyright: ignore[reportReturnType]
    after = []
    for step, kept in zip(features, keep, strict=True):
        memory = cell(step, memory * kept)
        after.append(memory)
    return torch.stack(after)


class _Along(torch.autograd.Function):
    """The steps, of which torch's kernel of the unit does all but the product of weights and memory."""

    @staticmethod
    def forward(ctx: Any, entering: Tensor, memory: Tensor, keep: Tensor, weight: Tensor, bias: Tensor) -> Tensor:
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
        of_held = torch.stack(held[::-1]).flatten(0, 1)
        return torch.stack(entering[::-1]), later, None, of_held.t() @ before.flatten(0, 1), of_held.sum(0)  # pyright: ignore[reportReturnType]
