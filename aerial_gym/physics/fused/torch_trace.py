"""Warp functions from pure torch functions of one environment: the torch function is the only statement of a formula.

A function gets its arguments as rows: a tensor (E, ...) for a number, vector or matrix, and an object with such tensors as
attributes for a ``wp.struct``. It is traced once; the result is straight-line code.
"""

import traceback
from collections.abc import Callable, Iterator, Mapping, Sequence
from math import prod
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import torch
import warp as wp
from torch import Tensor

from aerial_gym.errors import CapabilityError
from aerial_gym.interop.rows import UntraceableError, row_trace, trace
from aerial_gym.interop.rows.warp_function import function_lines
from aerial_gym.math.warp_functions import inverse_root, reciprocal, root
from aerial_gym.physics.fused.readers import compile_source

QUICK_FUNCTIONS = {"inverse_root": inverse_root, "reciprocal": reciprocal, "root": root}
"""Functions that traced code may call."""

WAY_OUT = (
    "A Warp function needs the same arithmetic in every environment: replace branches on values by torch.where, and "
    "operations without a rule by arithmetic. The torch backend runs any function"
)

DTYPES = {float: torch.float32, int: torch.int32, bool: torch.bool, wp.float32: torch.float32, wp.int32: torch.int32}
"""Torch types of Warp's scalars; vectors and matrices have float32."""


def trace_to_warp(
    name: str,
    arguments: Mapping[str, Any],
    function: Callable[..., Tensor | tuple[Tensor, ...]],
    returns: Sequence[Any],
    *,
    constants: Mapping[str, Tensor] | None = None,
) -> wp.Function:
    """Return a ``wp.func`` that computes a torch function for one environment.

    Args:
        name: Name of the function in the generated source and in errors.
        arguments: Warp type of each argument of both functions.
        function: Pure torch function of rows, called once with keywords.
        returns: Warp type of each result.
        constants: Known numbers of fields, by path such as ``at.rotor_axis``, in the shape of one row; NaN where unknown.
            Arithmetic with them is simplified as if all other numbers were finite.

    Raises:
        CapabilityError: If it cannot be traced; the text states the cause and its place in the source.
    """
    inputs = [entry for argument, kind in arguments.items() for entry in _flatten(argument, kind)]
    tensors = {path: torch.zeros(2, *shape, dtype=dtype) for path, shape, dtype in inputs}

    def from_rows(*rows: Tensor) -> Tensor | tuple[Tensor, ...]:
        by_path = dict(zip(tensors, rows, strict=True))
        return function(**{argument: _assemble(argument, kind, by_path) for argument, kind in arguments.items()})

    try:
        traced = trace(from_rows, list(tensors.values()), constants=_constants_by_entry(list(tensors), constants or {}))
    except UntraceableError as error:
        raise CapabilityError(f"{name}: {error}, at {_place(error)}. {WAY_OUT}") from error
    shapes, paths = [shape for _, shape, _ in inputs], list(tensors)
    lines = function_lines(
        traced, lambda position, entry: paths[position] + _index(shapes[position], entry), _constructors(returns)
    )
    return _compile(name, arguments, returns, lines)


def _place(error: BaseException) -> str:
    """Return file and line of the innermost code outside torch and the tracer that raised an error."""
    frames = traceback.extract_tb(error.__traceback__)
    outside = [frame for frame in frames if not any(part in frame.filename for part in _TRACER)]
    return f"{outside[-1].filename}:{outside[-1].lineno} ({outside[-1].line})"


_TRACER = (str(Path(torch.__file__).parent), str(Path(row_trace.__file__).parent), __file__)


def _compile(name: str, arguments: Mapping[str, Any], returns: Sequence[Any], lines: Sequence[str]) -> wp.Function:
    kinds = {f"{argument}_type": kind for argument, kind in arguments.items()}
    made = {f"result_{i}": kind for i, kind in enumerate(returns)}
    head = f"def {name}({', '.join(f'{argument}: {argument}_type' for argument in arguments)}):\n"
    return compile_source(name, head + "\n".join(lines) + "\n", {**kinds, **made, **QUICK_FUNCTIONS})


def _constructors(returns: Sequence[Any]) -> list[str]:
    return ["" if kind in DTYPES else f"result_{i}" for i, kind in enumerate(returns)]


def _flatten(path: str, kind: Any) -> Iterator[tuple[str, tuple[int, ...], torch.dtype]]:
    """Yield path, row shape and type of the tensors of an argument."""
    if hasattr(kind, "cls"):
        for name, inner in kind.cls.__annotations__.items():
            yield from _flatten(f"{path}.{name}", inner)
    else:
        yield path, () if kind in DTYPES else tuple(kind._shape_), DTYPES.get(kind, torch.float32)


def _assemble(path: str, kind: Any, by_path: Mapping[str, Tensor]) -> Any:
    """Return the tensor at a path, or an object with those below it."""
    if not hasattr(kind, "cls"):
        return by_path[path]
    fields = kind.cls.__annotations__
    return SimpleNamespace(**{name: _assemble(f"{path}.{name}", inner, by_path) for name, inner in fields.items()})


def _index(shape: tuple[int, ...], entry: int) -> str:
    """Return the index of an entry of a row in row-major order, as code."""
    if not shape:
        return ""
    numbers = [entry // prod(shape[k + 1 :]) % shape[k] for k in range(len(shape))]
    return f"[{', '.join(map(str, numbers))}]"


def _constants_by_entry(paths: Sequence[str], constants: Mapping[str, Tensor]) -> dict[tuple[int, int], float]:
    return {
        (paths.index(path), entry): value
        for path, rows in constants.items()
        for entry, value in enumerate(rows.flatten().tolist())
        if value == value
    }
