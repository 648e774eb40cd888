"""Source code of the Warp kernel of a trace: one thread per row, every number in a register."""

from collections.abc import Container, Iterable, Sequence
from dataclasses import dataclass, field
from math import isinf, isnan
from typing import Any

import torch
import warp as wp

from aerial_gym.interop.rows.operations import CODE
from aerial_gym.interop.rows.row_trace import Scalar, Trace
from aerial_gym.interop.rows.transport import LARGEST, MOST_STAGED, load_row_4, store_row

WARP_TYPES = {
    torch.float32: "float32",
    torch.float64: "float64",
    torch.int32: "int32",
    torch.int64: "int64",
    torch.bool: "bool",
}
"""Names of Warp's types."""


@dataclass(frozen=True, kw_only=True)
class KernelSource:
    """Source of a kernel ``rows``, and its inputs."""

    code: str
    shared: frozenset[int]  # Positions of inputs that all rows share
    inputs: tuple[int, ...]  # Positions of the inputs read: arguments before the outputs, (E, n) or shared (n,)
    names: dict[str, Any] = field(default_factory=dict)  # Names that the code uses, besides `wp`


def write(trace: Trace, *, masked: bool = False, made: Sequence[str] = (), beside: bool = False) -> KernelSource:
    """Write the kernel of a trace.

    Args:
        masked: Whether its first argument is a mask, whose other rows are skipped.
        made: Lines that compute ``made_0``, ``made_1``, ... in place of the first input, from ``given``: ``given_type``.
        beside: Whether it runs with twice as many threads as rows; the second half calls ``beside(row, other)`` with
            ``other``: ``beside_type``. Only with a mask, whose length is the number of rows.
    """
    needed = dependencies(trace, [n for numbers, _, _ in trace.outputs for n in numbers])
    kinds = {int(scalar.args[0]): scalar for n in needed if (scalar := trace.scalars[n]).kind in ("input", "shared")}
    if made:
        kinds.pop(0, None)
    shared = frozenset(i for i, scalar in kinds.items() if scalar.kind == "shared")
    arguments = [f"in_{i}: {_array(kinds[i].dtype, kinds[i].kind == 'input')}" for i in sorted(kinds)]
    arguments += [f"out_{i}: {_array(dtype, True)}" for i, (_, _, dtype) in enumerate(trace.outputs)]
    names: dict[str, Any] = {}
    together = () if masked else [i for i, kind in kinds.items() if _is_quad(kind, trace.widths[i])]
    if together:
        names["load_row_4"] = load_row_4
    lines = [f"    r{i} = load_row_4(in_{i}, row)" for i in together]
    lines += [f"    {line}" for line in made]
    lines += [f"    v{n} = {_code(trace.scalars[n], together, made=bool(made))}" for n in needed]
    staged = 0
    for i, (numbers, _, dtype) in enumerate(trace.outputs):
        width = len(numbers)
        pitch = width | 1
        if dtype == torch.float32 and 2 <= width <= LARGEST and not masked and staged + pitch <= MOST_STAGED:
            staged += pitch
            names |= {"store_row": store_row, f"vector_{width}": wp.types.vector(length=width, dtype=wp.float32)}
            values = ", ".join(f"v{n}" for n in numbers)
            lines.append(f"    store_row(out_{i}, row, vector_{width}({values}))")
        else:
            lines += [f"    out_{i}[row, {entry}] = v{n}" for entry, n in enumerate(numbers)]
    first = {"mask: wp.array2d[wp.bool]": masked, "other: beside_type": beside, "given: given_type": bool(made)}
    arguments = [*(argument for argument, taken in first.items() if taken), *arguments]
    head = f"def rows({', '.join(arguments)}):\n    row = wp.tid()\n"
    if beside:
        head += _BESIDE
    if masked:
        head += "    if not mask[row, 0]:\n        return\n"
    return KernelSource(code=head + "\n".join(lines) + "\n", inputs=tuple(sorted(kinds)), shared=shared, names=names)


_BESIDE = """\
    if row >= mask.shape[0]:
        row = row - mask.shape[0]
        if mask[row, 0]:
            beside(row, other)
        return
"""


def dependencies(trace: Trace, ends: Iterable[int], *, known: Container[int] = ()) -> list[int]:
    """Return the numbers of the scalars on which ``ends`` depend, and of these themselves, in order.

    Args:
        known: Scalars without further dependencies.
    """
    needed: set[int] = set()
    ahead = list(ends)
    while ahead:
        number = ahead.pop()
        if number not in needed:
            needed.add(number)
            scalar = trace.scalars[number]
            if number not in known and scalar.kind not in ("input", "shared", "constant"):
                ahead += [int(n) for n in scalar.args]
    return sorted(needed)


def _array(dtype: torch.dtype, rows: bool) -> str:
    return f"wp.array{'2d' if rows else ''}[wp.{WARP_TYPES[dtype]}]"


def _is_quad(scalar: Scalar, width: int) -> bool:
    return scalar.kind == "input" and scalar.dtype == torch.float32 and width == 4


def _code(scalar: Scalar, together: Container[object] = (), *, made: bool = False) -> str:
    if made and scalar.kind == "input" and scalar.args[0] == 0:
        return f"made_{scalar.args[1]}"
    if scalar.kind == "input" and scalar.args[0] in together:
        return f"r{scalar.args[0]}[{scalar.args[1]}]"
    if scalar.kind == "input":
        return f"in_{scalar.args[0]}[row, {scalar.args[1]}]"
    if scalar.kind == "shared":
        return f"in_{scalar.args[0]}[{scalar.args[1]}]"
    return operation_code(scalar)


def operation_code(scalar: Scalar) -> str:
    """Return the code of a constant or of an operation on the variables ``v0``, ``v1``, ..."""
    if scalar.kind == "constant":
        return constant_code(scalar.args[0], scalar.dtype)
    names = [f"v{n}" for n in scalar.args]
    if scalar.kind == "cast":
        return f"wp.{WARP_TYPES[scalar.dtype]}({names[0]})"
    if scalar.kind in ("minimum", "maximum") and scalar.dtype in (torch.int32, torch.int64):
        return f"wp.{scalar.kind[:3]}({names[0]}, {names[1]})"  # avoids compiler warnings of NaN checks on integers
    code = CODE[scalar.kind].format(*names)
    if scalar.dtype == torch.float64:
        code = (
            code.replace("1.0", "wp.float64(1.0)")
            .replace("0.0", "wp.float64(0.0)")
            .replace("wp.nan", "wp.float64(wp.nan)")
        )
    return code


def constant_code(value: float, dtype: torch.dtype) -> str:
    """Return the code of a number."""
    kind = f"wp.{WARP_TYPES[dtype]}"
    if isinstance(value, float) and isnan(value):
        return f"{kind}(wp.nan)"
    if isinstance(value, float) and isinf(value):
        return f"{kind}({'-' if value < 0.0 else ''}wp.inf)"
    return f"{kind}({value!r})"
