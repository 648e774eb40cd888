"""A pure torch function of rows with its gradient: one launch forward and one backward, in place of torch's many.

The backward pass is traced like the forward pass, with torch's own formulas. It recomputes their intermediates in registers.
Letters: E rows.
"""

from collections.abc import Callable, Sequence
from typing import Any

import torch
from torch import Tensor

from aerial_gym.interop.rows.function import RowFunction


class DifferentiableRows:
    """A torch function applied to every row in one Warp kernel, with its gradient in another."""

    def __init__(
        self,
        function: Callable[..., tuple[Tensor, ...]],
        inputs: Sequence[Tensor],
        *,
        lifts: bool = False,
        has_gradient: Callable[[int], bool] = lambda _: True,
    ) -> None:
        """Trace the function and its gradient with respect to all float inputs.

        A result that a loss ignores has a gradient of 0; if its derivatives are not finite, the product is NaN.

        Args:
            function: Pure function from tensors to tensors of E rows, traced once.
            inputs: Example inputs of the right shapes and types, (E, ...) or shared by all rows; shared ones have no gradient.
            lifts: Whether the function may read tensors (E, ...) from elsewhere, which must keep their memory; they have no
                gradient.
            has_gradient: Whether the result of an index has a gradient; called after one call of the function.

        Raises:
            UntraceableError: If the function or its gradient cannot be computed row by row; the text states the reason.
        """
        rows = next(tensor.shape[0] for tensor in inputs if tensor.ndim)
        wanted = [i for i, tensor in enumerate(inputs) if tensor.is_floating_point() and tensor.shape[:1] == (rows,)]
        self._forward = RowFunction(function, inputs, lifts=lifts, fresh=True)
        self.outputs = self._forward.outputs
        pulled = [i for i, (_, dtype) in enumerate(self.outputs) if dtype.is_floating_point and has_gradient(i)]
        seeds = [inputs[0].new_empty(rows, *self.outputs[i][0], dtype=self.outputs[i][1]) for i in pulled]
        self._back = RowFunction(
            _pullback(function, len(inputs), wanted, pulled), [*inputs, *seeds], lifts=lifts, fresh=True
        )
        self._num_inputs, self._wanted, self._pulled = len(inputs), wanted, pulled

    def __call__(self, *inputs: Tensor) -> tuple[Tensor, ...]:
        """Launch on torch's current stream, and return the differentiable results without waiting."""
        return _Rows.apply(self, *inputs)


def _pullback(
    function: Callable[..., tuple[Tensor, ...]], num_inputs: int, wanted: Sequence[int], pulled: Sequence[int]
) -> Callable[..., tuple[Tensor, ...]]:
    """Return the function from inputs and gradients of some results to gradients of some inputs."""

    def back(*given: Tensor) -> tuple[Tensor, ...]:
        with torch.enable_grad():
            inputs = list(given[:num_inputs])
            for i in wanted:
                inputs[i] = inputs[i].detach().requires_grad_()
            results = function(*inputs)
            pairs = [
                (results[i], seed)
                for i, seed in zip(pulled, given[num_inputs:], strict=True)
                if results[i].requires_grad
            ]
            ends, seeds = zip(*pairs, strict=True)
            input_grads = torch.autograd.grad(ends, [inputs[i] for i in wanted], seeds, allow_unused=True)
        none = [torch.zeros_like(given[i]) for i in wanted]
        return tuple(zero if grad is None else grad for grad, zero in zip(input_grads, none, strict=True))

    return back


class _Rows(torch.autograd.Function):
    @staticmethod
    def forward(ctx: Any, rows: DifferentiableRows, *inputs: Tensor) -> tuple[Tensor, ...]:
        results = rows._forward(*(tensor.contiguous() for tensor in inputs))
        ctx.rows = rows
        ctx.save_for_backward(
            *inputs, *rows._back.lifted
        )  # torch refuses the backward pass if these were written since
        ctx.mark_non_differentiable(*(result for i, result in enumerate(results) if i not in rows._pulled))
        return results

    @staticmethod
    def backward(ctx: Any, *grads: Tensor) -> tuple[Tensor | None, ...]:  # pyright: ignore[reportIncompatibleMethodOverride]
        rows = ctx.rows
        inputs = ctx.saved_tensors[: rows._num_inputs]
        given = [tensor.contiguous() for tensor in (*inputs, *(grads[i] for i in rows._pulled))]
        input_grads = dict(zip(rows._wanted, rows._back(*given), strict=True))
        return (None, *(input_grads.get(i) for i in range(len(inputs))))
