"""Rows that follow from other rows, written where a mask says so.

Letters: E rows.
"""

from collections.abc import Callable, Sequence

import torch
from torch import Tensor

from aerial_gym.interop.rows.function import Made, RowFunction, RowWork
from aerial_gym.interop.rows.tracing import UntraceableError


class MaskedRows:
    """Writes what a function makes of some tensors into others: one launch that touches the rows of the mask alone.

    What cannot be traced runs as plain torch, on all rows, and is written by the mask: as right, but dearer.
    """

    def __init__(
        self,
        function: Callable[..., tuple[Tensor, ...]],
        sources: Sequence[Tensor],
        targets: Sequence[Tensor],
        *,
        mask: Tensor,
        made: Made,
        beside: RowWork,
        plain: Callable[..., tuple[Tensor, ...]] | None = None,
    ) -> None:
        """Take fixed tensors.

        Args:
            sources: What it takes, (E, ...).
            targets: Where what it returns is written, (E, ...).
            mask: Rows to write, bool, (E,); read at every call.
            made: How the first of the sources is made, and written, in such a row before all.
            beside: What is done to such a row besides; neither reads what the other writes.
            plain: The same function, called where the other cannot be traced; it may read tensors from elsewhere.
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
        """Write the rows of the mask; launched on torch's current stream, not waited for."""
        if self._rows is not None:
            self._rows(*self._sources, out=self._written, mask=self._mask)
            return
        self._alone(self._sources[0], out=self._sources[:1], mask=self._mask)
        with torch.no_grad():
            for target, rows in zip(self._targets, self._function(*self._sources), strict=True):
                target.copy_(torch.where(self._mask.view(-1, *[1] * (target.ndim - 1)), rows, target))

    def mark_written(self) -> None:
        """Tell torch that a kernel wrote the rows: a graph that reads the old ones then refuses to go back."""
        for target in self._targets:
            target.add_(0.0)
