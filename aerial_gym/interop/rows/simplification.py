"""Simplification of scalar operations with constants, as if all other numbers were finite."""

import operator
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import torch

if TYPE_CHECKING:
    from aerial_gym.interop.rows.row_trace import Trace

EVALUATED: dict[str, Callable[..., Any]] = {
    "add": operator.add, "sub": operator.sub, "mul": operator.mul, "neg": operator.neg, "abs": abs, "minimum": min,
    "maximum": max, "lt": operator.lt, "le": operator.le, "gt": operator.gt, "ge": operator.ge, "eq": operator.eq,
    "ne": operator.ne, "and": operator.and_, "or": operator.or_, "not": operator.not_,
}  # fmt: skip
"""Operations that are computed where all arguments are constants."""


def simplify(trace: "Trace", kind: str, args: tuple[Any, ...], dtype: torch.dtype) -> int | None:
    """Return the number of an equal scalar that is simpler, or None without one."""
    if kind in ("input", "shared", "constant"):
        return None
    scalars = [trace.scalars[n] for n in args]
    values = [scalar.args[0] if scalar.kind == "constant" else None for scalar in scalars]
    if kind in EVALUATED and None not in values:
        result = torch.tensor(EVALUATED[kind](*values), dtype=dtype).item()
        return trace.number("constant", (result,), dtype)
    if kind == "where" and values[0] is not None:
        return args[1] if values[0] else args[2]
    if kind == "where" and args[1] == args[2]:
        return args[1]
    if kind == "where" and (argument := _argument_of_safe_root(trace, args)) is not None:
        zero = trace.number("constant", (0.0,), dtype)
        return trace.number("sqrt", (trace.number("maximum", (argument, zero), dtype),), dtype)
    if kind == "div" and dtype == torch.float32 and values[1] is None:
        return trace.number("mul", (args[0], trace.number("reciprocal", args[1:], dtype)), dtype)
    if kind == "reciprocal" and dtype == torch.float32 and scalars[0].kind == "sqrt":
        return trace.number("rsqrt", scalars[0].args, dtype)
    if kind in ("neg", "reciprocal") and scalars[0].kind == kind:
        return int(scalars[0].args[0])
    if kind == "sub" and args[0] == args[1]:
        return trace.number("constant", (torch.zeros((), dtype=dtype).item(),), dtype)
    return _neutral(trace, kind, args, values, dtype) if dtype.is_floating_point else None


def _argument_of_safe_root(trace: "Trace", args: tuple[Any, ...]) -> int | None:
    """Return x of ``where(x <= 0, 0, sqrt(where(x <= 0, 1, x)))``, torch's form of a root with a finite gradient at 0."""
    condition, yes, no = (trace.scalars[n] for n in args)
    if condition.kind != "le" or (yes.kind, yes.args) != ("constant", (0.0,)) or no.kind != "sqrt":
        return None
    inner, limit = trace.scalars[int(no.args[0])], trace.scalars[int(condition.args[1])]
    x = int(condition.args[0])
    fits = inner.kind == "where" and int(inner.args[0]) == args[0] and int(inner.args[2]) == x
    return x if fits and (limit.kind, limit.args) == ("constant", (0.0,)) else None


def _neutral(trace: "Trace", kind: str, args: tuple[Any, ...], values: list[Any], dtype: torch.dtype) -> int | None:
    """Return the result of a product or quotient with 0, 1 or -1, or of a sum with 0; None for others."""
    match kind, values:
        case ("mul", [0.0, _] | [_, 0.0]) | ("div", [0.0, _]):
            return trace.number("constant", (0.0,), dtype)
        case ("mul", [1.0, _]) | ("add", [0.0, _]):
            return args[1]
        case ("mul" | "div", [_, 1.0]) | ("add" | "sub", [_, 0.0]):
            return args[0]
        case ("mul", [-1.0, _]) | ("sub", [0.0, _]):
            return trace.number("neg", (args[1],), dtype)
        case ("mul" | "div", [_, -1.0]):
            return trace.number("neg", (args[0],), dtype)
    return None
