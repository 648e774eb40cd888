"""Masked update of rows from other rows.

Letters: E rows.
"""

from collections.abc import Callable, Sequence

import torch
from torch import Tensor

from aerial_gym.interop.rows.function import KernelInput, RowFunction, RowWork
from aerial_gym.interop.rows.row_trace import UntraceableError


class RowUpdate:
    """Update of target tensors from source tensors by a row function, in one launch on masked rows only.

    An untraceable function runs as plain torch on all rows and is written by the mask: correct, but slower.
    """

    def __init__(
        self,
        function: Callable[..., tuple[Tensor, ...]],
        sources: Sequence[Tensor],
        targets: Sequence[Tensor],
        *,
        mask: Tensor,
        made: KernelInput,
        beside: RowWork,
        plain: Callable[..., tuple[Tensor, ...]] | None = None,
    ) -> None:
        """Record the launch for fixed tensors.

        Args:
            sources: Inputs of the function, (E, ...).
            targets: Memory for its results, (E, ...).
            mask: Rows to write, bool, (E,); read at every call.
            made: Computation of the first source, which comes first in each masked row and is written.
            beside: Further work on each masked row; neither reads the other's results.
            plain: The same function for untraceable cases; it may read tensors from elsewhere.
        """
        self._function, self._sources, self._targets = plain or function, list(sources), list(targets)
        self._written = [sources[0], *targets]
        self._mask = mask
        self._rows: RowFunction | None = None
        self.why_slow = ""
        """Why it runs as plain torch; empty where it is one launch."""
        try:
            self._rows = RowFunction(
                lambda *given: (given[0], *function(*given)), sources, masked=True, made=made, beside=beside
            )
        except UntraceableError as error:
            self.why_slow = str(error)
            self._alone = RowFunction(lambda source: source, sources[:1], masked=True, made=made, beside=beside)

    def __call__(self) -> None:
        """Launch the update of masked rows on torch's current stream."""
        if self._rows is not None:
            self._rows(*self._sources, out=self._written, mask=self._mask)
            return
        self._alone(self._sources[0], out=self._sources[:1], mask=self._mask)
        with torch.no_grad():
            for target, rows in zip(self._targets, self._function(*self._sources), strict=True):
                target.copy_(torch.where(self._mask.view(-1, *[1] * (target.ndim - 1)), rows, target))

    def mark_written(self) -> None:
        """Mark the targets as modified for torch, so that a backward pass through old values raises an error."""
        for target in self._targets:
            target.add_(0.0)
