"""Rows that do not depend on how many there are.

On a CPU torch works on vectors of some elements at a time, and on what is left over at the end one by one: where the two have
formulas of their own (``atan2``, ``pow``, ``sigmoid``, ``hypot``), a number may differ in its last bit by its place in a batch,
and by where threads cut a large one. A matrix product sums in an order that depends on the number of rows. Arithmetic, short
sums, ``exp``, ``sin`` and the like do not. Physics and control use what stands here; functions of others are given batches of
whole vectors.
Letters: E rows, K columns.
"""

from collections.abc import Callable
from functools import reduce
from typing import TypeVar

import torch
from torch import Tensor

WHOLE_ROWS = 64
"""Rows of a batch that are whole vectors whatever the width of a row: a vector has 16 float32 with AVX-512, loops take 4."""

Result = TypeVar("Result", Tensor, tuple[Tensor, ...])

MOST_TERMS = 8
"""Terms up to which a product of rows on a GPU is written out."""


def atan2(y: Tensor, x: Tensor) -> Tensor:
    """Return ``torch.atan2``, which takes elements one by one, wherever they stand, where they are not neighbours in memory."""
    y, x = torch.stack((y, x), dim=-1).unbind(-1)
    return torch.atan2(y, x)


def times(rows: Tensor, matrix: Tensor) -> Tensor:
    """Return ``rows @ matrix``, (E, N), of (E, K) and (K, N); on a CPU in blocks of ``WHOLE_ROWS``, one product for each.

    Where operations are watched, to be made into a kernel of rows, it is written out: blocks mix rows.
    """
    watched = torch._C._len_torch_dispatch_stack() > 0
    if rows.device.type == "cpu" and not watched:
        count = rows.shape[0]
        missing = -count % WHOLE_ROWS
        if missing:
            rows = torch.cat((rows, rows.new_zeros(missing, rows.shape[1])))
        blocks = rows.reshape(-1, WHOLE_ROWS, rows.shape[1])
        product = torch.bmm(blocks, matrix.expand(blocks.shape[0], *matrix.shape)).flatten(0, 1)
        return product[:count] if missing else product
    if watched or rows.shape[1] <= MOST_TERMS:
        return reduce(torch.add, (rows[:, k : k + 1] * matrix[k] for k in range(rows.shape[1])))
    return rows @ matrix


def on_whole_vectors(function: Callable[..., Result], num_rows: int, device: torch.device) -> Callable[..., Result]:
    """Return a function of tensors that gives each row the same result in every batch, bit for bit.

    On a CPU, where ``num_rows`` is not a multiple of ``WHOLE_ROWS``, the last row is repeated until it is; elsewhere it is
    the function itself.

    Args:
        function: Of tensors, most of them (E, ...), to tensors (E, ...); row i of what it returns follows from rows i alone.
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
