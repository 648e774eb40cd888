"""Rare work of a row function: torch computes it in all rows, a kernel only in the rows that need it.

Letters: E rows.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, Protocol

import torch
from torch import Tensor

RowsFunction = Callable[..., tuple[Tensor, ...]]
"""Function of tensors (E, ...) to tensors (E, ...)."""


class ConditionalRecorder(Protocol):
    """A trace that records conditional work."""

    def record_conditional(
        self, condition: Tensor, function: RowsFunction, arguments: Sequence[Tensor], otherwise: Sequence[Tensor]
    ) -> tuple[Tensor, ...]:
        """Return the placeholders of the results."""
        ...


recorders: list[ConditionalRecorder] = []
"""The running traces that record conditional work, the innermost last."""


@dataclass(frozen=True)
class ConditionalCall:
    """A function of a trace that a kernel calls only where a condition holds."""

    function: RowsFunction
    shapes: tuple[tuple[int, ...], ...]  # Row shapes of its arguments
    constants: dict[tuple[int, int], float]  # Known numbers of the arguments, by position and entry
    results: tuple[tuple[int, ...], ...]  # Row shapes of its results


def compute_if(
    condition: Tensor, function: RowsFunction, arguments: Sequence[Tensor], otherwise: Sequence[Tensor]
) -> tuple[Tensor, ...]:
    """Return ``function(*arguments)`` where a condition holds, and other values elsewhere.

    Args:
        condition: Whether to compute a row, bool (E, 1).
        function: Pure function; it reads tensors among its arguments only. It may have a method ``make_warp`` that returns
            its hand-written Warp function (see ``physics.fused.torch_trace``).
        arguments: Its arguments, float (E, ...).
        otherwise: The results where the condition does not hold, (E, n) each.
    """
    if recorders:
        return recorders[-1].record_conditional(condition, function, arguments, otherwise)
    results = function(*arguments)
    return tuple(torch.where(condition, made, other) for made, other in zip(results, otherwise, strict=True))


def hand_written(function: RowsFunction) -> Any:
    """Return the method that makes a function's hand-written Warp version; None for a function to trace."""
    return getattr(function, "make_warp", None)
