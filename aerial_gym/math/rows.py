"""Row operations with bit-identical results at every batch size, and sums over short axes.

On a CPU, torch computes whole vectors of elements, and the remainder one by one. If the two have different formulas
(``atan2``, ``pow``, ``sigmoid``, ``hypot``), the last bit of a number depends on its place in a batch and on the split among
threads. A matrix product sums in an order that depends on the number of rows. Arithmetic, short sums, ``exp`` and ``sin`` do
not. Slices of three or four elements are added several times faster than an axis is summed.
Letters: E rows, K columns.
"""

from collections.abc import Callable, Sequence
from functools import reduce
from typing import TypeVar

import torch
from torch import Tensor
from torch.utils._python_dispatch import _get_current_dispatch_mode

WHOLE_ROWS = 64  # Rows that fill whole vectors at any width: a vector has 16 float32 with AVX-512, loops take 4

Result = TypeVar("Result", Tensor, tuple[Tensor, ...])
RowsFunction = Callable[..., tuple[Tensor, ...]]  # Function of tensors (E, ...) to tensors (E, ...)
MOST_TERMS = 8  # Largest number of terms of an unrolled product of rows on a GPU


def atan2(y: Tensor, x: Tensor) -> Tensor:
    """Return ``torch.atan2`` of strided elements, which torch always computes one by one."""
    y, x = torch.stack((y, x), dim=-1).unbind(-1)
    return torch.atan2(y, x)


def times(rows: Tensor, matrix: Tensor) -> Tensor:
    """Return ``rows @ matrix``, (E, N), of (E, K) and (K, N); on a CPU one product for each block of ``WHOLE_ROWS``.

    In a trace for a row kernel it is unrolled, because blocks mix rows.
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


def compute_if(
    condition: Tensor, function: RowsFunction, arguments: Sequence[Tensor], otherwise: Sequence[Tensor]
) -> tuple[Tensor, ...]:
    """Return ``function(*arguments)`` where a condition holds, and other values elsewhere.

    Torch computes all rows, a kernel those that need it.

    Args:
        condition: Whether to compute a row, bool (E, 1).
        function: Pure function; it reads tensors among its arguments only. It may have a method ``make_warp`` that returns
            its hand-written Warp function (see ``physics.fused.torch_trace``).
        arguments: Its arguments, float (E, ...).
        otherwise: The results where the condition does not hold, (E, n) each.
    """
    record = _call_recorder()
    if record is not None:
        return record(function, arguments, condition, otherwise)
    return tuple(torch.where(condition, *pair) for pair in zip(function(*arguments), otherwise, strict=True))


def apply_by_element(function: Callable[..., Tensor], *values: Tensor) -> Tensor:
    """Return ``function(*values)``, whose elements depend on the same element of the values only.

    A kernel calls it for each element, in place of a copy of its code.
    """
    record = _call_recorder()
    return function(*values) if record is None else record(function, values, apply_by_element=True)[0]


def choose(condition: Tensor, function: Callable[..., Tensor], other: Tensor, *values: Tensor) -> Tensor:
    """Return ``torch.where(condition, function(*values), other)`` for a function as in ``apply_by_element``.

    A kernel calls it only where the condition is true.
    """
    record = _call_recorder()
    if record is None:
        return torch.where(condition, function(*values), other)
    return record(function, values, condition, (other,), apply_by_element=True)[0]


def _call_recorder() -> Callable[..., tuple[Tensor, ...]] | None:
    """Return the function by which a running trace records a call; None without one."""
    return getattr(_get_current_dispatch_mode(), "call_recorder", None)


def make_batch_invariant(function: Callable[..., Result], num_rows: int, device: torch.device) -> Callable[..., Result]:
    """Return the function with bit-identical results of each row in every batch.

    On a CPU the last row is repeated up to a multiple of ``WHOLE_ROWS``; elsewhere the function is unchanged.

    Args:
        function: Function of tensors, most of them (E, ...), to tensors (E, ...); row i of a result depends on rows i only.
    """
    missing = -num_rows % WHOLE_ROWS
    if device.type != "cpu" or not missing:
        return function

    def pad_rows(tensor: Tensor) -> Tensor:
        if tensor.dim() == 0 or tensor.shape[0] != num_rows:
            return tensor
        return torch.cat((tensor, tensor[-1:].expand(missing, *tensor.shape[1:])))

    def whole(*tensors: Tensor) -> Result:
        result = function(*(pad_rows(tensor) for tensor in tensors))
        return result[:num_rows] if isinstance(result, Tensor) else tuple(part[:num_rows] for part in result)

    return whole


def dot(a: Tensor, b: Tensor) -> Tensor:
    """Return ``a . b`` over the last axis, (...), for (..., K) with a small K; leading shapes are broadcast."""
    return reduce(torch.add, (x * y for x, y in zip(a.unbind(-1), b.unbind(-1), strict=True)))


def unit_vector(a: Tensor) -> Tensor:
    """Return ``a / |a|``, (..., K), or zero for zero."""
    return a / dot(a, a).clamp_min(1e-30).sqrt().unsqueeze(-1)


def length_of_vectors(a: Tensor) -> Tensor:
    """Return ``|a|``, (..., 1), for (..., K), with zero gradient at zero."""
    square = (a * a).sum(-1, keepdim=True)
    moving = square > 0.0
    return torch.where(moving, square, torch.ones_like(square)).sqrt() * moving


def inverse_3x3(matrix: Tensor) -> Tensor:
    """Return the inverse of regular matrices, (..., 3, 3), as adjugate over determinant, without a blocking factorisation."""
    a, b, c = matrix.unbind(-2)
    columns = (torch.linalg.cross(b, c, dim=-1), torch.linalg.cross(c, a, dim=-1), torch.linalg.cross(a, b, dim=-1))
    determinant = dot(a, columns[0])
    return torch.stack(columns, dim=-1) / determinant[..., None, None]


def sum_slices(a: Tensor, dim: int) -> Tensor:
    """Return the sum over an axis with few elements."""
    return reduce(torch.add, a.unbind(dim))


def cross_product_matrix(vectors: Tensor) -> Tensor:
    """Return the matrices that map b to ``a x b``, (..., 3, 3), of vectors a (..., 3)."""
    x, y, z = vectors.unbind(-1)
    zero = torch.zeros_like(x)
    return torch.stack((zero, -z, y, z, zero, -x, -y, x, zero), dim=-1).unflatten(-1, (3, 3))
