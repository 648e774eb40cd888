"""Rows that do not depend on how many there are.

On a CPU torch works on vectors of some elements at a time, and on what is left over at the end one by one with other formulas:
``sin`` of the same number can differ in its last bit by where it stands in a batch. In batches of whole vectors it does not.
Letters: E rows.
"""

from collections.abc import Callable
from typing import TypeVar

import torch
from torch import Tensor

WHOLE_ROWS = 64
"""Rows of a batch that are whole vectors whatever the width of a row: a vector has 16 float32 with AVX-512, loops take 4."""

Result = TypeVar("Result", Tensor, tuple[Tensor, ...])


def on_whole_vectors(function: Callable[..., Result], num_rows: int, device: torch.device) -> Callable[..., Result]:
    """Return a function of tensors that gives each row the same result in every batch, bit for bit.

    On a CPU, where ``num_rows`` is not a multiple of ``WHOLE_ROWS``, the last row is repeated until it is; elsewhere it is
    the function itself.

    Args:
        function: Of tensors, most of them (E, ...), to tensors (E, ...); row i of what it returns follows from rows i alone.
        num_rows: E.
        device: Where the tensors are.
    """
    missing = -num_rows % WHOLE_ROWS
    if device.type != "cpu" or not missing:
        return function

    def padded(tensor: Tensor) -> Tensor:
        if tensor.dim() == 0 or tensor.shape[0] != num_rows:
            return tensor
        return torch.cat((tensor, tensor[-1:].expand(missing, *tensor.shape[1:])))

    def whole(*tensors: Tensor) -> Result:
        result = function(*(padded(tensor) for tensor in tensors))
        return result[:num_rows] if isinstance(result, Tensor) else tuple(part[:num_rows] for part in result)

    return whole
