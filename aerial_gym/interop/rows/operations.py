"""Supported torch operations of row kernels, by the names of their ``aten`` overload packets.

A pointwise operation is a template of Warp code over its arguments, with torch's propagation of NaN.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import reduce
from itertools import accumulate
from math import inf
from typing import TYPE_CHECKING, Any

import torch
from torch import Tensor

if TYPE_CHECKING:
    from aerial_gym.interop.rows.row_trace import Trace

MOVES = frozenset([
    "alias", "cat", "clone", "constant_pad_nd", "contiguous", "detach", "diagonal", "expand", "flip", "index_select",
    "lift_fresh", "movedim", "permute", "repeat", "reshape", "roll", "select", "slice", "split", "split_with_sizes",
    "squeeze", "stack", "t", "transpose", "unbind", "unfold", "unsqueeze", "view", "_reshape_alias", "_unsafe_view",
])  # fmt: skip
"""Operations that only move elements."""

CODE = {
    "add": "{0} + {1}",
    "sub": "{0} - {1}",
    "mul": "{0} * {1}",
    "div": "{0} / {1}",
    "neg": "-{0}",
    "lt": "{0} < {1}",
    "le": "{0} <= {1}",
    "gt": "{0} > {1}",
    "ge": "{0} >= {1}",
    "eq": "{0} == {1}",
    "ne": "{0} != {1}",
    "and": "{0} and {1}",
    "or": "{0} or {1}",
    "not": "not {0}",
    "where": "wp.where({0}, {1}, {2})",
    "minimum": "wp.where({0} != {0}, {0}, wp.where({0} < {1}, {0}, {1}))",
    "maximum": "wp.where({0} != {0}, {0}, wp.where({0} > {1}, {0}, {1}))",
    "sign": "wp.where({0} == {0}, wp.where({0} > 0.0, 1.0, wp.where({0} < 0.0, -1.0, 0.0)), {0})",
    "isfinite": "wp.isfinite({0})",
    "isnan": "{0} != {0}",
    "reciprocal": "1.0 / {0}",
    "rsqrt": "1.0 / wp.sqrt({0})",
    "sigmoid": "1.0 / (1.0 + wp.exp(-{0}))",
    "pow": "wp.pow({0}, {1})",
    **{
        name: f"wp.{name}({{0}})"
        for name in ["abs", "sqrt", "exp", "log", "sin", "cos", "tan", "atan", "sinh", "cosh", "tanh"]
    },
    **{name: f"wp.{name}({{0}})" for name in ("floor", "ceil")},
    # Warp's own clamp the argument to -1..1 and turn NaN into a number
    **{name: f"wp.where(wp.abs({{0}}) <= 1.0, wp.{name}({{0}}), wp.nan)" for name in ("asin", "acos")},
    "round": "wp.rint({0})",
    "atan2": "wp.atan2({0}, {1})",
    "bit_and": "{0} & {1}",
    "bit_xor": "{0} ^ {1}",
    "shift_right": "{0} >> {1}",
    "remainder": "wp.where(wp.mod({0}, {1}) * {1} < 0.0, wp.mod({0}, {1}) + {1}, wp.mod({0}, {1}))",
}
"""Warp code of each scalar operation."""


def _cross_product(a: Tensor, b: Tensor, *, dim: int = -1) -> Tensor:
    (ax, ay, az), (bx, by, bz) = a.unbind(dim), b.unbind(dim)
    return torch.stack((ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx), dim=dim)


def _matrix_product(a: Tensor, b: Tensor) -> Tensor:
    left, right = (a if a.ndim > 1 else a.unsqueeze(0)), (b if b.ndim > 1 else b.unsqueeze(-1))
    product = (left.unsqueeze(-1) * right.unsqueeze(-3)).sum(-2)
    product = product if a.ndim > 1 else product.squeeze(-2)
    return product if b.ndim > 1 else product.squeeze(-1)


def _diagonal_matrix(a: Tensor, offset: int = 0, dim1: int = -2, dim2: int = -1) -> Tensor:
    if (offset, dim1, dim2) != (0, -2, -1):
        raise ValueError("torch.diag_embed with offset or dimensions")
    return torch.where(torch.eye(a.shape[-1], dtype=torch.bool), a.unsqueeze(-1), 0.0)


def _cumulative_product(a: Tensor, dim: int) -> Tensor:
    return torch.stack(list(accumulate(a.unbind(dim), torch.mul)), dim=dim)


def _replace_non_finite(
    a: Tensor, nan: float | None = None, high: float | None = None, low: float | None = None
) -> Tensor:
    largest = torch.finfo(a.dtype).max
    a = torch.where(a.isnan(), nan or 0.0, a)
    return torch.where(
        a == inf, largest if high is None else high, torch.where(a == -inf, -largest if low is None else low, a)
    )


def _exponential_less_one(a: Tensor) -> Tensor:
    """Return ``exp(a) - 1``, accurate for small a."""
    half = torch.tanh(0.5 * a.clamp_max(1.0))
    return torch.where(a > 1.0, a.exp() - 1.0, 2.0 * half / (1.0 - half))


COMPOSED: dict[str, Callable[..., Tensor]] = {
    "linalg_cross": _cross_product,
    "expm1": _exponential_less_one,
    "mm": _matrix_product,
    "bmm": _matrix_product,
    "matmul": _matrix_product,  # in inference mode; torch's own decomposition imports sympy for 2 s
    "diag_embed": _diagonal_matrix,
    "cumprod": _cumulative_product,
    "nan_to_num": _replace_non_finite,
    "tanh_backward": lambda slope, result: slope * (1.0 - result * result),
    "sigmoid_backward": lambda slope, result: slope * (1.0 - result) * result,
    "threshold_backward": lambda slope, a, limit: torch.where(a <= limit, 0.0, slope),
}
"""Operations composed of others."""

INTO_ZEROS: dict[str, Callable[..., Tensor]] = {
    "select_backward": lambda zeros, dim, index: zeros.select(dim, index),
    "slice_backward": lambda zeros, dim, start, end, step: zeros[
        (slice(None),) * (dim % zeros.ndim) + (slice(start, end, step),)
    ],
}
"""Gradients of operations that move elements, as assignments into zeros."""

IN_PLACE: dict[str, Callable[..., Tensor]] = {"masked_fill_": torch.masked_fill, "logical_and_": torch.logical_and}
"""In-place operations of gradients, with their out-of-place equivalents."""

Arguments = Callable[[tuple[Any, ...], dict[str, Any]], tuple[Any, ...]]


@dataclass(frozen=True, kw_only=True)
class Pointwise:
    """Scalar form of an operation on tensors."""

    make: Callable[
        ["Trace", tuple[int, ...], torch.dtype], int
    ]  # Function from scalars of the arguments to that of the result
    arguments: Arguments = lambda args, kwargs: args  # Its tensor and number arguments, in order
    compares: bool = False  # Whether its arguments have a common type other than the result's
    inside: torch.dtype | None = None  # Type of the arguments, if other than the result's
    types: tuple[torch.dtype | None, ...] | None = None  # Type of each argument, None for its own
    known: frozenset[str] = frozenset()  # Names of supported keyword arguments, or of those without effect
    floats: bool = False  # Whether only for floating-point numbers


_OF_TRUTHS = {"mul": "and", "add": "or"}


def _operation_of_kind(kind: str) -> Callable[["Trace", tuple[int, ...], torch.dtype], int]:
    return lambda into, row, dtype: into.number(_OF_TRUTHS.get(kind, kind) if dtype == torch.bool else kind, row, dtype)


def _alpha_operation(kind: str) -> Pointwise:
    """``add`` and ``sub`` with their factor ``alpha``."""

    def arguments(args: tuple[Any, ...], kwargs: dict[str, Any]) -> tuple[Any, ...]:
        a, b, *rest = args
        return a, b, rest[0] if rest else kwargs.get("alpha", 1)

    def make(into: "Trace", row: tuple[int, ...], dtype: torch.dtype) -> int:
        a, b, alpha = row
        if into.scalars[alpha].args != (1,):
            b = into.number("mul", (b, alpha), dtype)
        return _operation_of_kind(kind)(into, (a, b), dtype)

    return Pointwise(make=make, arguments=arguments, known=frozenset({"alpha"}))


def _logical_or_bitwise(kind: str) -> Pointwise:
    """Return a logical operation on truths, or on the bits of integers."""
    return Pointwise(
        make=lambda into, row, dtype: into.number(kind if dtype == torch.bool else f"bit_{kind}", row, dtype)
    )


def _power(into: "Trace", row: tuple[int, ...], dtype: torch.dtype) -> int:
    base, exponent = row
    scalar = into.scalars[exponent]
    value = scalar.args[0] if scalar.kind == "constant" else None
    if value == 1:
        return base
    if value in (2, 3):
        square = into.number("mul", (base, base), dtype)
        return square if value == 2 else into.number("mul", (square, base), dtype)
    if value == 0.5:
        return into.number("sqrt", (base,), dtype)
    return into.number("pow", row, dtype)


def _clamp_arguments(args: tuple[Any, ...], kwargs: dict[str, Any]) -> tuple[Any, ...]:
    value, low, high = (*args, None, None)[:3]
    low, high = kwargs.get("min", low), kwargs.get("max", high)
    return value, -inf if low is None else low, inf if high is None else high


def _clamp_scalar(into: "Trace", row: tuple[int, ...], dtype: torch.dtype) -> int:
    value, low, high = row
    for kind, limit in (("maximum", low), ("minimum", high)):
        scalar = into.scalars[limit]
        if not (scalar.kind == "constant" and abs(scalar.args[0]) == inf):
            value = into.number(kind, (value, limit), dtype)
    return value


def _first_argument(into: "Trace", row: tuple[int, ...], dtype: torch.dtype) -> int:
    return row[0]


def _select_arguments(args: tuple[Any, ...], kwargs: dict[str, Any]) -> tuple[Any, ...]:
    if len(args) < 3:
        raise ValueError("torch.where needs three arguments")
    return args


def _select_scalar(into: "Trace", row: tuple[int, ...], dtype: torch.dtype) -> int:
    condition, yes, no = row
    return into.number("where", (condition, into.cast(yes, dtype), into.cast(no, dtype)), dtype)


_LIKE = frozenset({"dtype", "layout", "device", "pin_memory", "memory_format", "non_blocking"})
_ONE_FLOAT = "sqrt rsqrt reciprocal exp log sin cos tan asin acos atan sinh cosh tanh sigmoid sign floor ceil round"
_BOOL = torch.bool

POINTWISE: dict[str, Pointwise] = {
    **{name: Pointwise(make=_operation_of_kind(name), floats=True) for name in _ONE_FLOAT.split()},
    **{name: Pointwise(make=_operation_of_kind(name)) for name in ("neg", "abs", "mul", "minimum", "maximum")},
    **{name: Pointwise(make=_operation_of_kind(name), floats=True) for name in ("div", "atan2", "remainder")},
    **{name: Pointwise(make=_operation_of_kind(name), compares=True) for name in ("lt", "le", "gt", "ge", "eq", "ne")},
    **{f"logical_{name}": Pointwise(make=_operation_of_kind(name), inside=_BOOL) for name in ("and", "or", "not")},
    **{f"bitwise_{name}": Pointwise(make=_operation_of_kind(name), inside=_BOOL) for name in ("or", "not")},
    "bitwise_and": _logical_or_bitwise("and"),
    **dict.fromkeys(
        ("__rshift__", "bitwise_right_shift"),
        Pointwise(make=lambda into, row, dtype: into.number("shift_right", row, dtype)),
    ),
    "logical_xor": Pointwise(make=_operation_of_kind("ne"), inside=_BOOL),
    "bitwise_xor": Pointwise(
        make=lambda into, row, dtype: into.number("ne" if dtype == torch.bool else "bit_xor", row, dtype)
    ),
    "isnan": Pointwise(make=_operation_of_kind("isnan"), types=(None,)),
    "isfinite": Pointwise(make=_operation_of_kind("isfinite"), types=(None,)),
    "add": _alpha_operation("add"),
    "sub": _alpha_operation("sub"),
    "rsub": Pointwise(
        make=lambda into, row, dtype: into.number("sub", (row[1], row[0]), dtype),
        arguments=lambda args, kwargs: args[:2],
    ),
    "pow": Pointwise(make=_power),
    "square": Pointwise(make=lambda into, row, dtype: into.number("mul", (row[0], row[0]), dtype)),
    "clamp": Pointwise(make=_clamp_scalar, arguments=_clamp_arguments, known=frozenset({"min", "max"})),
    "clamp_min": Pointwise(make=_clamp_scalar, arguments=lambda args, kwargs: (*args[:2], inf)),
    "clamp_max": Pointwise(make=_clamp_scalar, arguments=lambda args, kwargs: (args[0], -inf, args[1])),
    "sgn": Pointwise(make=_operation_of_kind("sign"), floats=True),
    "relu": Pointwise(make=_clamp_scalar, arguments=lambda args, kwargs: (args[0], 0.0, inf)),
    "where": Pointwise(make=_select_scalar, arguments=_select_arguments, types=(_BOOL, None, None)),
    "masked_fill": Pointwise(
        make=_select_scalar, arguments=lambda args, kwargs: (args[1], args[2], args[0]), types=(_BOOL, None, None)
    ),
    "_to_copy": Pointwise(make=_first_argument, arguments=lambda args, kwargs: args[:1], known=_LIKE),
    "full_like": Pointwise(make=_first_argument, arguments=lambda args, kwargs: (args[1],), known=_LIKE),
    **{
        name: Pointwise(make=_first_argument, arguments=lambda args, kwargs, value=value: (value,), known=_LIKE)
        for name, value in (("zeros_like", 0.0), ("ones_like", 1.0), ("new_zeros", 0.0), ("new_ones", 1.0))
    },
}
"""Elementwise operations."""


@dataclass(frozen=True, kw_only=True)
class Reduction:
    """A reduction of several elements of a row to one."""

    make: Callable[["Trace", Sequence[int], torch.dtype, tuple[Any, ...], dict[str, Any]], int]
    """From the scalars to the one of the result."""

    dim_at: int = 1  # Position of the argument ``dim``

    def dims(self, args: tuple[Any, ...], kwargs: dict[str, Any], ndim: int) -> tuple[set[int], bool]:
        """Return the reduced dimensions, and whether they are kept with one entry."""
        at = self.dim_at
        dim = args[at] if len(args) > at else kwargs.get("dim")
        keep = args[at + 1] if len(args) > at + 1 else kwargs.get("keepdim", False)
        if dim is None or dim == []:
            return set(range(ndim)), bool(keep)
        return {d % ndim for d in ([dim] if isinstance(dim, int) else dim)}, bool(keep)


def _chain(kind: str) -> Reduction:
    def make(into: "Trace", row: Sequence[int], dtype: torch.dtype, args: Any, kwargs: Any) -> int:
        return reduce(lambda a, b: into.number(kind, (a, b), dtype), row)

    return Reduction(make=make)


def _mean(into: "Trace", row: Sequence[int], dtype: torch.dtype, args: Any, kwargs: Any) -> int:
    total = reduce(lambda a, b: into.number("add", (a, b), dtype), row)
    return into.number("div", (total, into.number("constant", (float(len(row)),), dtype)), dtype)


def _norm(into: "Trace", row: Sequence[int], dtype: torch.dtype, args: Any, kwargs: Any) -> int:
    order = args[1] if len(args) > 1 else kwargs.get("ord", 2)
    if order == 2:
        squares = (into.number("mul", (a, a), dtype) for a in row)
        return into.number("sqrt", (reduce(lambda a, b: into.number("add", (a, b), dtype), squares),), dtype)
    sizes = (into.number("abs", (a,), dtype) for a in row)
    kinds = {1: "add", inf: "maximum"}
    if order not in kinds:
        raise ValueError(f"norm of order {order}")
    return reduce(lambda a, b: into.number(kinds[order], (a, b), dtype), sizes)


REDUCTIONS: dict[str, Reduction] = {
    "sum": _chain("add"),
    "prod": _chain("mul"),
    "amin": _chain("minimum"),
    "amax": _chain("maximum"),
    "any": _chain("or"),
    "all": _chain("and"),
    "mean": Reduction(make=_mean),
    "linalg_vector_norm": Reduction(make=_norm, dim_at=2),
}
"""Reductions over the entries of a row."""
