"""Source code of a ``wp.func`` of a trace: straight-line arithmetic of one row, for any kernel to call.

Arithmetic is that of physics kernels: quotients and roots have one instruction on a GPU, and limits drop NaN like Warp's own.

Random draws compute modulo 2^32 in int64, because torch has no unsigned arithmetic. A GPU needs several instructions for
64 bits, so integers whose ranges allow it are unsigned with 32 bits here.
"""

import re
from collections.abc import Callable, Collection, Sequence
from math import prod

import torch

from aerial_gym.interop.rows.operations import CODE
from aerial_gym.interop.rows.row_trace import Scalar, Trace
from aerial_gym.interop.rows.source import constant_code, dependencies, operation_code

MODULUS = 1 << 32


def fits_32_bits(trace: Trace, needed: Sequence[int]) -> bool:
    """Return whether the int64 scalars can be computed modulo 2^32: each is below it, or only its lower bits are read.

    Inputs of int64 are random states, which have 32 bits.
    """
    bounds: dict[int, int | None] = {}  # largest value of a scalar; None if only its lower bits are right
    for n in needed:
        scalar = trace.scalars[n]
        given = [] if scalar.kind in ("input", "shared", "constant") else [int(a) for a in scalar.args]
        if any(bounds.get(a, 0) is None for a in given) and scalar.kind not in ("add", "mul", "bit_and", "bit_xor"):
            return False
        if scalar.dtype == torch.int64:
            if scalar.kind == "cast" and trace.scalars[given[0]].dtype != torch.int32:
                return False
            bounds[n] = _largest_value(
                scalar, [bounds.get(a) for a in given], [trace.scalars[a].kind == "constant" for a in given]
            )
    return True


def _largest_value(scalar: Scalar, given: list[int | None], fixed: list[bool]) -> int | None:
    """Return the largest value of a scalar >= 0; None from 2^32 on, or if it is unknown.

    Args:
        given: Bounds of its arguments.
        fixed: Whether they are constants.
    """
    if scalar.kind in ("input", "shared"):
        return MODULUS - 1
    if scalar.kind == "constant":
        return int(scalar.args[0]) if 0 <= scalar.args[0] < MODULUS else None
    known = [bound for bound in given if bound is not None]
    if scalar.kind == "bit_and" and known:
        return min(known)
    if len(known) < len(given) or not known:
        return None
    match scalar.kind:
        case "bit_xor":
            return (1 << max(bound.bit_length() for bound in known)) - 1
        case "shift_right":
            return known[0] >> known[1] if fixed[1] else known[0]
        case "add" | "mul":
            whole = known[0] + known[1] if scalar.kind == "add" else known[0] * known[1]
            return whole if whole < MODULUS else None
    return None


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

    Calls are those of functions ``call_0``, ..., with arguments of types ``call_0_argument_0``, ... and results of types
    ``call_0_result_0``, ...

    Args:
        read: Function from position and entry of an input to its code.
    """
    lines = [line for n in needed for line in _lines(trace, n, read)]
    return [INTEGER.sub(_uint32_code, line) for line in lines] if fits_32_bits(trace, needed) else lines


INTEGER = re.compile(r"wp\.int64\((\d*)")  # A conversion to int64, with its constant


def _uint32_code(conversion: re.Match[str]) -> str:
    """Return the code of a conversion to uint32; Warp stores constants as int32, so those from 2^31 on become negative."""
    value = conversion[1] and int(conversion[1])
    return f"wp.uint32({value - MODULUS if value and value >= MODULUS // 2 else value}"


def _lines(trace: Trace, n: int, read: Callable[[int, int], str]) -> list[str]:
    scalar = trace.scalars[n]
    kind, *places = scalar.kind.split(" ")
    if kind == "call":
        return _call_lines(trace, n, int(places[0]))
    if kind == "result":
        call = trace.calls[int(trace.scalars[int(scalar.args[0])].kind.split(" ")[1])]
        entry = f"[{places[1]}]" if call.results[int(places[0])] else ""
        return [f"    v{n} = v{scalar.args[0]}_{places[0]}{entry}"]
    return [f"    v{n} = {_code(trace, scalar, read)}"]


def _call_lines(trace: Trace, number: int, index: int) -> list[str]:
    """Return the lines of a call, whose results are ``v1_0``, ``v1_1``, ... for number 1."""
    call, name, numbers = trace.calls[index], f"call_{index}", [f"v{n}" for n in trace.scalars[number].args]
    results = [f"v{number}_{k}" for k in range(len(call.results))]
    condition = [numbers.pop(0)] if call.is_conditional else []

    def take(shapes: Sequence[tuple[int, ...]], kind: str) -> list[str]:
        parts = []
        for k, shape in enumerate(shapes):
            part = ", ".join(numbers[: prod(shape)])
            parts.append(f"{name}_{kind}_{k}({part})" if shape else part)
            del numbers[: prod(shape)]
        return parts

    defaults = take(call.results, "result") if condition else []
    code = f"{', '.join(results)} = {name}({', '.join(take(call.shapes, 'argument'))})"
    if not condition:
        return [f"    {code}"]
    lines = [f"    {result} = {other}" for result, other in zip(results, defaults, strict=True)]
    return [*lines, f"    if {condition[0]}:", f"        {code}"]


def function_lines(trace: Trace, read: Callable[[int, int], str], returns: Sequence[str]) -> list[str]:
    """Return the body of the function: all scalars of the outputs and the return statement.

    Args:
        read: Function from position and entry of an input to its code.
        returns: Constructor of each output, or empty for a single number.
    """
    ends = [n for numbers, _, _ in trace.outputs for n in numbers]
    return [*body_lines(trace, dependencies(trace, ends), read), return_line(trace, returns)]


def split_function_lines(
    trace: Trace, read: Callable[[int, int], str], returns: Sequence[str], early: Collection[int], late: Collection[int]
) -> tuple[list[str], list[str], int]:
    """Return the bodies of two functions, the first of which needs no late inputs, and the number of its results.

    The first computes the scalars that depend on early inputs and not on late ones, as far as the second
    needs them; the second reads them as ``prepared[0]``, ``prepared[1]``, ...
    The first returns a ``prepared_type``. Scalars of other inputs alone are in both.

    Args:
        early: Positions of inputs of the first function.
        late: Positions of inputs of the second function only.
    """
    ends = [n for numbers, _, _ in trace.outputs for n in numbers]
    needed = dependencies(trace, ends)
    depends: dict[int, set[bool]] = {}  # True: on early inputs; False: on late ones
    for n in needed:
        scalar = trace.scalars[n]
        if scalar.kind in ("input", "shared"):
            depends[n] = {True} if scalar.args[0] in early else {False} if scalar.args[0] in late else set()
        else:
            depends[n] = set().union(*(depends[int(a)] for a in scalar.args if scalar.kind != "constant"))
    ahead = {n for n in needed if depends[n] == {True} and _is_kept(trace.scalars[n])}
    used = {
        int(a) for n in needed if n not in ahead and _has_arguments(trace.scalars[n]) for a in trace.scalars[n].args
    }
    frontier = [n for n in needed if n in ahead and n in used | set(ends)]
    first = [*body_lines(trace, dependencies(trace, frontier), read)]
    first.append(f"    return prepared_type({', '.join(f'v{n}' for n in frontier)})")
    kept = dependencies(trace, ends, known=frontier)
    read_back = [f"    v{n} = prepared[{i}]" for i, n in enumerate(frontier)]
    rest = [n for n in kept if n not in set(frontier)]
    return first, [*read_back, *body_lines(trace, rest, read), return_line(trace, returns)], len(frontier)


def return_line(trace: Trace, returns: Sequence[str]) -> str:
    """Return the return statement; ``returns`` has the constructor of each output, or empty for a single number."""
    results = [
        f"{made}({', '.join(f'v{n}' for n in numbers)})" if made else f"v{numbers[0]}"
        for (numbers, _, _), made in zip(trace.outputs, returns, strict=True)
    ]
    return f"    return {', '.join(results)}"


def _is_kept(scalar: Scalar) -> bool:
    """Return whether a prepared scalar is kept for the second function; the others are recomputed from kept ones."""
    return scalar.dtype == torch.float32 and scalar.kind != "neg" and not scalar.kind.startswith("call ")


def _has_arguments(scalar: Scalar) -> bool:
    """Return whether the arguments of a scalar are numbers of other scalars."""
    return scalar.kind not in ("input", "shared", "constant")


def _code(trace: Trace, scalar: Scalar, read: Callable[[int, int], str]) -> str:
    if scalar.kind in ("input", "shared"):
        return read(int(scalar.args[0]), int(scalar.args[1]))
    if scalar.dtype != torch.float32 or scalar.kind not in QUICK:
        return operation_code(scalar)
    if scalar.kind == "div" and (divisor := trace.scalars[int(scalar.args[1])]).kind == "constant":
        return _quotient_by_constant(int(scalar.args[0]), divisor)
    return QUICK[scalar.kind].format(*(f"v{n}" for n in scalar.args))


def _quotient_by_constant(above: int, divisor: Scalar) -> str:
    inverse = torch.tensor(1.0 / divisor.args[0], dtype=divisor.dtype).item()
    return f"v{above} * {constant_code(inverse, divisor.dtype)}"


assert QUICK.keys() <= CODE.keys()
