"""Source code of a ``wp.func`` of a trace: straight-line arithmetic of one row, for any kernel to call.

Arithmetic is that of physics kernels: quotients and roots have one instruction on a GPU, and limits drop NaN like Warp's own.
"""

from collections.abc import Callable, Sequence

import torch

from aerial_gym.interop.rows.operations import CODE
from aerial_gym.interop.rows.row_trace import Scalar, Trace
from aerial_gym.interop.rows.source import constant_code, dependencies, operation_code

QUICK = {
    "div": "{0} * reciprocal({1})",
    "reciprocal": "reciprocal({0})",
    "sqrt": "root({0})",
    "rsqrt": "inverse_root({0})",
    "minimum": "wp.min({0}, {1})",
    "maximum": "wp.max({0}, {1})",
    "asin": "wp.asin({0})",
    "acos": "wp.acos({0})",
}
"""Code of operations on float32 that differs from that of row kernels. It calls functions of these names."""


def body_lines(trace: Trace, needed: Sequence[int], read: Callable[[int, int], str]) -> list[str]:
    """Return the lines that compute the scalars ``needed``, named ``v0``, ``v1``, ... by their numbers.

    Args:
        read: Function from position and entry of an input to its code.
    """
    return [line for n in needed for line in _lines(trace, n, read)]


def _lines(trace: Trace, n: int, read: Callable[[int, int], str]) -> list[str]:
    scalar = trace.scalars[n]
    kind, _, body = scalar.kind.partition(" ")
    names = [f"v{a}" for a in scalar.args]
    if kind == "call":
        return [f"    v{n} = body_{body}({', '.join(names)})"]
    if kind == "choose":
        condition, other, *values = names
        return [f"    v{n} = {other}", f"    if {condition}:", f"        v{n} = body_{body}({', '.join(values)})"]
    return [f"    v{n} = {_code(trace, scalar, read)}"]


def function_lines(trace: Trace, read: Callable[[int, int], str], returns: Sequence[str]) -> list[str]:
    """Return the body of the function: all scalars of the outputs and the return statement.

    Args:
        read: Function from position and entry of an input to its code.
        returns: Constructor of each output, or empty for a single number.
    """
    results = [
        f"{made}({', '.join(f'v{n}' for n in numbers)})" if made else f"v{numbers[0]}"
        for (numbers, _, _), made in zip(trace.outputs, returns, strict=True)
    ]
    ends = [n for numbers, _, _ in trace.outputs for n in numbers]
    return [*body_lines(trace, dependencies(trace, ends), read), f"    return {', '.join(results)}"]


def _code(trace: Trace, scalar: Scalar, read: Callable[[int, int], str]) -> str:
    if scalar.kind in ("input", "shared"):
        return read(int(scalar.args[0]), int(scalar.args[1]))
    if scalar.dtype != torch.float32 or scalar.kind not in QUICK:
        return operation_code(scalar)
    if scalar.kind in ("div", "reciprocal"):
        return _quotient(trace, scalar)
    return QUICK[scalar.kind].format(*(f"v{n}" for n in scalar.args))


def _quotient(trace: Trace, scalar: Scalar) -> str:
    """Return the code of a quotient: a product with a constant, an inverse root or a reciprocal."""
    *above, below = (int(n) for n in scalar.args)
    divisor = trace.scalars[below]
    if divisor.kind == "constant":
        inverse = constant_code(torch.tensor(1.0 / divisor.args[0], dtype=scalar.dtype).item(), scalar.dtype)
    else:
        inverse = f"inverse_root(v{divisor.args[0]})" if divisor.kind == "sqrt" else f"reciprocal(v{below})"
    is_one = not above or (trace.scalars[above[0]].kind, trace.scalars[above[0]].args) == ("constant", (1.0,))
    return inverse if is_one else f"v{above[0]} * {inverse}"


assert QUICK.keys() <= CODE.keys()
