"""Warp functions from pure torch functions of one environment: the torch function is the only statement of a formula.

A function gets its arguments as rows: a tensor (E, ...) for a number, vector or matrix, and an object with such tensors as
attributes for a ``wp.struct``. It is traced once; the result is straight-line code.
"""

import traceback
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass
from math import prod
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import torch
import warp as wp
from torch import Tensor

from aerial_gym.errors import CapabilityError
from aerial_gym.interop.rows import UntraceableError, row_trace, trace
from aerial_gym.interop.rows.row_trace import Trace
from aerial_gym.interop.rows.warp_function import function_lines
from aerial_gym.math.warp_functions import inverse_root, reciprocal, root, vector_type
from aerial_gym.physics.fused.types import compile_source

QUICK_FUNCTIONS = {"inverse_root": inverse_root, "reciprocal": reciprocal, "root": root}
"""Functions that traced code may call."""

Input = tuple[str, tuple[int, ...], torch.dtype]  # Path, row shape and type of an input of a trace
RowsOfArguments = Callable[..., Tensor | tuple[Tensor, ...]]  # Torch function of rows with the arguments of Warp's

WAY_OUT = (
    "A Warp function needs the same arithmetic in every environment: replace branches on values by torch.where, and "
    "operations without a rule by arithmetic. The torch backend runs any function"
)

DTYPES = {
    float: torch.float32,
    int: torch.int32,
    bool: torch.bool,
    wp.float32: torch.float32,
    wp.int32: torch.int32,
    wp.uint32: torch.int64,
    wp.float64: torch.float64,
}
"""Torch types of Warp's scalars; vectors and matrices have float32."""


def trace_to_warp(
    name: str, arguments: Mapping[str, Any], function: RowsOfArguments, returns: Sequence[Any], *,
    constants: Mapping[str, Tensor] | None = None, shared: Collection[str] = (), differentiable: bool = False,
) -> wp.Function:  # fmt: skip
    """Return a ``wp.func`` that computes a torch function for one environment.

    Args:
        name: Name of the function in the generated source and in errors.
        arguments: Warp type of each argument of both functions.
        function: Pure torch function of rows, called once with keywords.
        returns: Warp type of each result.
        constants: Known numbers of fields, by path such as ``at.rotor_axis``, in the shape of one row; NaN where unknown.
            Arithmetic with them is simplified as if all other numbers were finite.
        shared: Paths of numbers that the torch function takes without rows, as tensors of no dimension.
        differentiable: Whether the adjoint is needed; see ``compile_traced``.

    Raises:
        CapabilityError: If it cannot be traced; the text states the cause and its place in the source.
    """
    traced = trace_arguments(name, arguments, function, constants=constants, shared=shared)
    lines = function_lines(traced.trace, traced.code_of_entry, constructors(returns))
    return compile_traced(name, arguments, returns, lines, traced.trace, differentiable=differentiable)


@dataclass(frozen=True)
class ArgumentsTrace:
    """A trace of a function of arguments, with the code of its inputs."""

    trace: Trace
    inputs: list[Input]

    def code_of_entry(self, position: int, entry: int) -> str:
        """Return the code of an entry of an argument; bits of random states are computed in 64 bits, as in torch."""
        path, shape, dtype = self.inputs[position]
        code = path + _subscript(shape, entry)
        return f"wp.int64({code})" if dtype == torch.int64 else code

    def positions(self, arguments: Sequence[str]) -> set[int]:
        """Return the positions of the inputs of some arguments."""
        return {i for i, (path, _, _) in enumerate(self.inputs) if path.split(".")[0] in arguments}


def trace_arguments(
    name: str, arguments: Mapping[str, Any], function: RowsOfArguments, *,
    constants: Mapping[str, Tensor] | None = None, shared: Collection[str] = (), num_envs: int = 2, lifts: bool = False,
    known: Callable[[Tensor], Mapping[int, float]] | None = None,
) -> ArgumentsTrace:  # fmt: skip
    """Return the trace of a function; arguments as for ``trace_to_warp``.

    Args:
        num_envs: Number of rows E of tensors from elsewhere.
        lifts: Whether the function may read tensors (E, ...) from elsewhere, which become further inputs.
        known: As for ``trace``.
    """
    inputs = [entry for argument, kind in arguments.items() for entry in _flatten(argument, kind)]
    tensors = {
        path: torch.zeros((), dtype=dtype).expand(() if path in shared else (num_envs, *shape))
        for path, shape, dtype in inputs
    }

    def from_rows(*rows: Tensor) -> Tensor | tuple[Tensor, ...]:
        by_path = dict(zip(tensors, rows, strict=True))
        return function(**{argument: _assemble(argument, kind, by_path) for argument, kind in arguments.items()})

    entries = _constants_by_entry(list(tensors), constants or {})
    try:
        return ArgumentsTrace(
            trace(from_rows, list(tensors.values()), lifts=lifts, fixes=not lifts, constants=entries, known=known),
            inputs,
        )
    except UntraceableError as error:
        raise CapabilityError(
            f"{_name_of_failed_object(error) or name}: {error}, at {_line_of_error(error)}. {WAY_OUT}"
        ) from error


def _line_of_error(error: BaseException) -> str:
    """Return file and line of the innermost code outside torch and the tracer that raised an error."""
    frames = traceback.extract_tb((error.__cause__ or error).__traceback__)
    outside = [frame for frame in frames if not any(part in frame.filename for part in _TRACER)]
    return f"{outside[-1].filename}:{outside[-1].lineno} ({outside[-1].line})"


def _name_of_failed_object(error: BaseException) -> str:
    """Return the name of the innermost object with a name, such as an effect, whose method raised an error; else nothing."""
    frames = traceback.walk_tb((error.__cause__ or error).__traceback__)
    owners = [frame.f_locals.get("self") for frame, _ in frames]
    names = [owner.name for owner in owners if isinstance(getattr(owner, "name", None), str)]
    return names[-1] if names else ""


_TRACER = (str(Path(torch.__file__).parent), str(Path(row_trace.__file__).parent), __file__)


def compile_traced(
    name: str, arguments: Mapping[str, Any], returns: Sequence[Any], lines: Sequence[str], trace: Trace, *,
    differentiable: bool, names: Mapping[str, Any] | None = None,
) -> wp.Function:  # fmt: skip
    """Return the ``wp.func`` with the given body.

    Args:
        trace: Its trace, with the functions that it calls.
        differentiable: Whether the adjoint is needed, for functions with a hand-written Warp version.
        names: Further names in the body.
    """
    kinds = {f"{argument}_type": kind for argument, kind in arguments.items()}
    made = {f"result_{i}": kind for i, kind in enumerate(returns)}
    called = {key: value for i in range(len(trace.calls)) for key, value in _call_names(name, trace, i, differentiable)}
    head = f"def {name}({', '.join(f'{argument}: {argument}_type' for argument in arguments)}):\n"
    body = head + "\n".join(lines) + "\n"
    more = called | dict(names or {})
    return compile_source(name, body, {**kinds, **made, **more, **QUICK_FUNCTIONS})


def _call_names(name: str, trace: Trace, index: int, differentiable: bool) -> Iterator[tuple[str, Any]]:
    """Yield the names of a call: the function and the types of its arguments and results."""
    call = trace.calls[index]
    kinds = [_kind_of_row(shape, dtype) for shape, dtype in zip(call.shapes, call.dtypes, strict=True)]
    arguments = {f"argument_{k}": kind for k, kind in enumerate(kinds)}
    results = [_kind_of_row(shape, call.dtype) for shape in call.results]
    if call.body is None:
        function = call.function.make_warp(call.shapes, call.constants, differentiable)
    else:
        lines = function_lines(
            call.body,
            lambda position, entry: f"argument_{position}{_subscript(call.shapes[position], entry)}",
            constructors(results),
        )
        function = compile_traced(
            f"{name}_{index}", arguments, results, lines, call.body, differentiable=differentiable
        )
    yield f"call_{index}", function
    yield from ((f"call_{index}_{argument}", kind) for argument, kind in arguments.items())
    yield from ((f"call_{index}_result_{k}", kind) for k, kind in enumerate(results))


def _kind_of_row(shape: tuple[int, ...], dtype: torch.dtype) -> Any:
    """Return the Warp type of a number, or of a float vector or matrix."""
    if not shape:
        return {torch.float32: float, torch.float64: wp.float64, torch.int32: int, torch.bool: bool}[dtype]
    return vector_type(*shape) if len(shape) == 1 else wp.types.matrix(shape=shape, dtype=wp.float32)


def constructors(returns: Sequence[Any]) -> list[str]:
    """Return the names of the constructors of results in the generated code; empty for single numbers."""
    return ["" if kind in DTYPES else f"result_{i}" for i, kind in enumerate(returns)]


def _flatten(path: str, kind: Any) -> Iterator[Input]:
    """Yield path, row shape and type of the tensors of an argument."""
    if hasattr(kind, "cls"):
        for name, inner in kind.cls.__annotations__.items():
            yield from _flatten(f"{path}.{name}", inner)
    else:
        yield path, () if kind in DTYPES else tuple(kind._shape_), DTYPES[getattr(kind, "_wp_scalar_type_", kind)]


def _assemble(path: str, kind: Any, by_path: Mapping[str, Tensor]) -> Any:
    """Return the tensor at a path, or an object with those below it."""
    if not hasattr(kind, "cls"):
        return by_path[path]
    fields = kind.cls.__annotations__
    return SimpleNamespace(**{name: _assemble(f"{path}.{name}", inner, by_path) for name, inner in fields.items()})


def _subscript(shape: tuple[int, ...], entry: int) -> str:
    """Return the subscript of the ``entry``-th number of a row in row-major order, as code: ``[1, 2]``; empty for a scalar."""
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
