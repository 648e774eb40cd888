"""Trace of a pure torch function on one row, as a list of scalar operations.

The function is called once on zeros, with a record of each element's scalar. Torch itself applies operations that only move
elements (slices, ``cat``, ``stack``, ``expand``, ...) to the numbers of those scalars. All others add scalars, each only
once.
Letters: B rows of the trace.
"""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cache
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor
from torch.overrides import TorchFunctionMode
from torch.utils._python_dispatch import TorchDispatchMode, _disable_current_modes

from aerial_gym.interop.rows.operations import COMPOSED, IN_PLACE, INTO_ZEROS, MOVES, POINTWISE, REDUCTIONS
from aerial_gym.interop.rows.simplification import simplify

Array = NDArray[np.int64]
ROWS = 97  # Number of rows of the trace, B: a prime that equals no other size
LARGEST_ROW = 512  # Largest number of entries in a row of an input; each becomes a variable of the kernel


_MARK = 1 << 32  # Row b adds (b + 1) times this to the numbers of its scalars, which exposes operations that mix rows


class UntraceableError(Exception):
    """The function is not the same small computation in every row; the text states the reason."""


@dataclass(frozen=True)
class Scalar:
    """One number of a row: its operation and arguments."""

    kind: str  # ``input`` (one row), ``shared`` (by all rows), ``constant``, or the name of an operation
    args: tuple[int | float | bool, ...]  # Numbers of scalars; position and entry of an input; a constant's value
    dtype: torch.dtype


@dataclass(frozen=True, kw_only=True)
class FunctionCall:
    """A function that a trace calls in place of a copy of its code.

    Arguments of its scalars are the condition, the other results and the arguments; ``result K I`` is entry I of result K.
    """

    function: Callable[..., Any]
    body: "Trace | None"  # None for a function with ``make_warp``, a hand-written Warp function
    is_conditional: bool
    shapes: tuple[tuple[int, ...], ...]  # Row shapes of its arguments
    dtypes: tuple[torch.dtype, ...]
    constants: dict[tuple[int, int], float]  # Known numbers of the arguments, by position and entry
    results: tuple[tuple[int, ...], ...]  # Row shapes of its results
    dtype: torch.dtype  # Of the results


@dataclass
class Trace:
    """All scalars of a function, each after its arguments."""

    scalars: list[Scalar] = field(default_factory=list)
    outputs: list[tuple[list[int], tuple[int, ...], torch.dtype]] = field(default_factory=list)
    """Scalars, row shape and type of each output."""

    widths: dict[int, int] = field(default_factory=dict)  # Number of entries in a row of each input, by position
    lifted: list[Tensor] = field(default_factory=list)  # Tensors from elsewhere, (E, ...) or shared, as further inputs
    sources: list[Tensor] = field(default_factory=list)  # The same with all rows (E, ...), by their order
    calls: list["FunctionCall"] = field(default_factory=list)  # Functions of the scalars of kind ``call K``, by K
    simplifies: bool = False  # Whether products with 0 and 1, sums with 0 and operations on constants are replaced
    _numbers: dict[tuple[str, str | tuple[Any, ...], torch.dtype], int] = field(default_factory=dict)

    def number(self, kind: str, args: tuple[Any, ...], dtype: torch.dtype) -> int:
        """Return the number of a scalar; equal scalars share one."""
        if self.simplifies and (simpler := simplify(self, kind, args, dtype)) is not None:
            return simpler
        key = (kind, repr(args) if kind == "constant" else args, dtype)  # 0.0 is not -0.0
        known = self._numbers.get(key)
        if known is None:
            known = self._numbers[key] = len(self.scalars)
            self.scalars.append(Scalar(kind, args, dtype))
        return known

    def cast(self, number: int, dtype: torch.dtype) -> int:
        """Return a scalar converted to another type."""
        return number if self.scalars[number].dtype == dtype else self.number("cast", (number,), dtype)


def trace(
    function: Callable[..., Tensor | tuple[Tensor, ...]], inputs: Sequence[Tensor], *, lifts: bool = False,
    fixes: bool = False, constants: Mapping[tuple[int, int], float] | None = None,
    known: Callable[[Tensor], Mapping[int, float]] | None = None,
) -> Trace:  # fmt: skip
    """Trace a function on one row.

    Args:
        function: Pure function of tensors that returns tensors of rows, without branches on tensors.
        inputs: Tensors (E, ...), with E from the first that has a dimension; others are shared by all rows. A row of more
            than ``LARGEST_ROW`` entries, such as an image, may be passed but not read.
        lifts: Whether tensors (E, ...) from elsewhere become inputs; else they are refused.
        fixes: Whether tensors from elsewhere become constants.
        constants: Known values of entries of inputs, by position and entry. With it, arithmetic on constants is simplified
            as if all numbers were finite, and functions of ``compute_if``, ``apply_by_element`` and ``choose`` are called.
        known: Function from a tensor from elsewhere to the known entries of its rows, which become constants.

    Raises:
        UntraceableError: If it cannot be computed row by row with the operations of ``operations.py``.
    """
    into = Trace(simplifies=constants is not None)
    watch = _Recorder(into, dict(constants or {}))
    num_rows = next((tensor.shape[0] for tensor in inputs if tensor.ndim), 0)
    rows = [
        watch.add_input(position, tensor, rows=tensor.shape[:1] == (num_rows,))
        for position, tensor in enumerate(inputs)
    ]
    try:
        with (
            torch.no_grad(),
            watch,
            _ExternalTensors(watch, len(inputs), num_rows if lifts else None, fixes=fixes, known=known),
        ):
            results = function(*rows)
    except UntraceableError:
        raise
    except Exception as error:
        raise UntraceableError(f"{type(error).__name__}: {(str(error).strip().splitlines() or [''])[0]}") from error
    for result in results if isinstance(results, tuple) else (results,):
        if not isinstance(result, Tensor) or result.shape[:1] != (ROWS,) or not watch.depends_on_input(result):
            raise UntraceableError("a result does not have a row for each environment")
        numbers = watch.find_scalars(result, result.dtype).one
        into.outputs.append((numbers.ravel().tolist(), tuple(result.shape[1:]), result.dtype))
    return into


class _Scalars:
    """Numbers of the scalars of a tensor."""

    def __init__(self, one: Array, *, rows: bool, marked: bool = True, numbers: Tensor | None = None) -> None:
        """Store the numbers of one row, or of a shared tensor.

        Args:
            one: The numbers without the row dimension.
            rows: Whether they belong to one row.
            marked: Whether rows are marked; equal rows need no mark.
            numbers: Numbers of all rows, if known.
        """
        self.one, self.rows, self._marked, self._all = one, rows, marked, numbers

    @classmethod
    def from_numbers(cls, numbers: Tensor) -> "_Scalars":
        """Return the scalars of numbers (B, ...) that an operation has moved.

        Raises:
            UntraceableError: If rows were mixed.
        """
        return cls(_remove_marks(numbers), rows=numbers.shape[:1] == (ROWS,), numbers=numbers)

    @property
    def all(self) -> Tensor:
        """Numbers of all rows, (B, ...), equal but for each row's ``_MARK``; any shape for shared tensors.

        They are computed on demand, because most scalars are never moved.
        """
        if self._all is None:
            self._all = torch.from_numpy(self.one)
            if self.rows:
                rows = self._all.expand(ROWS, *self.one.shape)
                self._all = rows + _marks(self.one.ndim) if self._marked else rows
        return self._all

    @property
    def ndim(self) -> int:
        """Dimensions of the tensor."""
        return self.one.ndim + self.rows

    def map_numbers(self, change: Callable[[int], int]) -> "_Scalars":
        """Apply a function to each number."""
        changed = [change(number) for number in self.one.ravel().tolist()]
        return _Scalars(np.array(changed, dtype=np.int64).reshape(self.one.shape), rows=self.rows)


def _broadcast(make: Callable[..., int], given: Sequence[_Scalars], shape: torch.Size) -> _Scalars:
    """Broadcast scalars and combine them elementwise by ``make``, for a result of the given shape.

    Raises:
        UntraceableError: If the row dimension of one meets another dimension.
    """
    rows, ndim = any(each.rows for each in given), max(each.ndim for each in given)
    operands = []
    for each in given:
        if each.rows and each.ndim != ndim:
            raise UntraceableError("an operation mixes rows")
        operands.append(each.one[0] if rows and not each.rows and each.ndim == ndim else each.one)
    if any(one.shape != operands[0].shape for one in operands):
        operands = np.broadcast_arrays(*operands)
    made = np.array(
        [make(*row) for row in zip(*(one.ravel().tolist() for one in operands), strict=True)], dtype=np.int64
    )
    made, has_rows = made.reshape(operands[0].shape), shape[:1] == (ROWS,)
    if has_rows and not rows and made.ndim == len(shape):
        made = made[0]
    expected = tuple(shape[has_rows:])
    made = made if made.shape == expected else np.broadcast_to(made, expected).copy()
    return _Scalars(made, rows=has_rows, marked=rows)


def _result(into: Trace, kind: str, row: tuple[int, ...], dtype: torch.dtype, result: int = 0, entry: int = 0) -> int:
    """Return the scalar of an entry of a result of a call."""
    return into.number(f"result {result} {entry}", (into.number(kind, row, dtype),), dtype)


class _Recorder(TorchDispatchMode):
    """Dispatch mode that runs every torch operation and records its effect on scalars."""

    def __init__(self, into: Trace, constants: dict[tuple[int, int], float]) -> None:
        super().__init__()
        self.into, self.whole, self.constants = into, into, constants
        # by id of a kept tensor; None: a constant whose numbers may still change
        self._scalars: dict[int, tuple[Tensor, _Scalars | None]] = {}
        self._owners: dict[int, Trace] = {}  # of tensors that depend on an input
        self._literals: dict[tuple[str, torch.dtype | None], tuple[_Scalars, torch.dtype]] = {}
        self._large: dict[int, tuple[Tensor, str]] = {}

    @classmethod
    def _should_skip_dynamo(cls) -> bool:
        return False  # else torch imports its whole compiler

    def add_input(self, position: int, tensor: Tensor, *, rows: bool) -> Tensor:
        """Return zeros as the placeholder of an input."""
        kind, shape = ("input", tensor.shape[1:]) if rows else ("shared", tensor.shape)
        first = (ROWS,) if rows else ()
        if shape.numel() > LARGEST_ROW:
            large = torch.zeros((), dtype=tensor.dtype).expand(first + tuple(shape))
            self._large[id(large)] = (large, f"input {position} has {shape.numel()} entries in a row")
            return large
        self.into.widths[position] = shape.numel()
        numbers = [
            self.into.number("constant", (self.constants[position, i],), tensor.dtype)
            if (position, i) in self.constants
            else self.into.number(kind, (position, i), tensor.dtype)
            for i in range(shape.numel())
        ]
        scalars = _Scalars(np.array(numbers, dtype=np.int64).reshape(tuple(shape)), rows=rows)
        return self._note(torch.zeros(first + tuple(shape), dtype=tensor.dtype), scalars)

    def is_traced(self, tensor: Tensor) -> bool:
        """Return whether the tensor is an input or results from inputs and constants."""
        return id(tensor) in self._scalars or id(tensor) in self._large

    def depends_on_input(self, tensor: Tensor) -> bool:
        """Return whether the tensor depends on an input."""
        return self._scalars.get(id(tensor), (None, None))[1] is not None

    @property
    def call_recorder(self) -> Callable[..., tuple[Tensor, ...]] | None:
        """Function that records a call; None where kernels call no functions."""
        return self._record_call if self.into.simplifies else None

    def _record_call(
        self, function: Callable[..., Any], arguments: Sequence[Tensor], condition: Tensor | None = None,
        otherwise: Sequence[Tensor] = (), *, apply_by_element: bool = False,
    ) -> tuple[Tensor, ...]:  # fmt: skip
        """Trace a function as a body of its own, and return placeholders of the results of a call.

        Args:
            condition: Condition for the call; None: always.
            otherwise: Results where it does not hold.
            apply_by_element: Whether each element has its own call; the tensors are broadcast.
        """
        first = (() if condition is None else (condition,)) + tuple(otherwise)
        copies = [tensor.clone() for tensor in (*first, *arguments)]  # the trace sees each of them
        with torch._C.DisableTorchFunction(), _disable_current_modes():
            given = [self.find_scalars(tensor) for tensor in copies]
        rows = [each.one if each.rows or apply_by_element else each.one[0] for each in given]
        call = self._trace_call(
            function,
            [() if apply_by_element else numbers.shape for numbers in rows[len(first) :]],
            [tensor.dtype for tensor in copies[len(first) :]],
            {} if apply_by_element else self._find_constants(rows[len(first) :]),
            None
            if condition is None
            else [() if apply_by_element else numbers.shape for numbers in rows[1 : len(first)]],
            arguments[0].dtype,
        )
        into, kind = self.into, f"call {len(self.into.calls)}"
        into.calls.append(call)
        if apply_by_element:
            shape = torch.Size(np.broadcast_shapes(*(tensor.shape for tensor in copies)))
            scalars = _broadcast(lambda *row: _result(into, kind, row, call.dtype), given, shape)
            return (self._note(torch.zeros(shape, dtype=call.dtype), scalars),)
        flat, placeholders = tuple(n for numbers in rows for n in numbers.ravel().tolist()), []
        for k, shape in enumerate(call.results):
            made = np.array([_result(into, kind, flat, call.dtype, k, i) for i in range(math.prod(shape))])
            scalars = _Scalars(made.astype(np.int64).reshape(shape), rows=True)
            placeholders.append(self._note(torch.zeros(ROWS, *shape, dtype=call.dtype), scalars))
        return tuple(placeholders)

    def _find_constants(self, rows: Sequence[Array]) -> dict[tuple[int, int], float]:
        """Return the constants among the entries of rows, by position and entry."""
        return {
            (position, entry): float(scalar.args[0])
            for position, numbers in enumerate(rows)
            for entry, n in enumerate(numbers.ravel().tolist())
            if (scalar := self.into.scalars[n]).kind == "constant"
        }

    def _trace_call(
        self, function: Callable[..., Any], shapes: Sequence[tuple[int, ...]], dtypes: Sequence[torch.dtype],
        constants: dict[tuple[int, int], float], results: Sequence[tuple[int, ...]] | None, dtype: torch.dtype,
    ) -> FunctionCall:  # fmt: skip
        """Return a call; ``results`` are the shapes of the results of a conditional one, else None."""
        body = None
        if not hasattr(function, "make_warp"):
            body = self._trace_body(function, shapes, dtypes, constants)
            dtype = body.outputs[0][2]
        return FunctionCall(
            function=function,
            body=body,
            is_conditional=results is not None,
            shapes=tuple(shapes),
            dtypes=tuple(dtypes),
            constants=constants,
            results=tuple(shape for _, shape, _ in body.outputs) if body else tuple(results or ()),
            dtype=dtype,
        )

    def _trace_body(
        self, function: Callable[..., Any], shapes: Sequence[tuple[int, ...]], dtypes: Sequence[torch.dtype],
        constants: dict[tuple[int, int], float],
    ) -> Trace:  # fmt: skip
        """Return the trace of a function that reads its arguments only."""
        outer = self.into, self.constants, self._literals
        self.into, self.constants, self._literals = Trace(simplifies=True), constants, {}
        try:
            inputs = [
                self.add_input(i, torch.zeros(2, *shape, dtype=dtype), rows=True)
                for i, (shape, dtype) in enumerate(zip(shapes, dtypes, strict=True))
            ]
            results = function(*inputs)
            for result in results if isinstance(results, tuple) else (results,):
                numbers = self.find_scalars(result).one.ravel().tolist()
                self.into.outputs.append((numbers, tuple(result.shape[1:]), result.dtype))
            return self.into
        finally:
            self.into, self.constants, self._literals = outer

    def constant(self, tensor: Tensor) -> Tensor:
        """Return a copy of a tensor as a constant of the trace."""
        return self._note(tensor.detach().cpu().clone(), None)

    def find_scalars(self, value: Any, dtype: torch.dtype | None = None) -> _Scalars:
        """Return the scalars of a traced tensor, a shared tensor or a number, converted to a type."""
        known = self._scalars.get(id(value), (None, None))[1] if isinstance(value, Tensor) else None
        if known is not None:
            if self._owners[id(value)] is not self.into:
                raise UntraceableError(_NOT_AN_ARGUMENT)
            scalars, given = known, value.dtype
        elif isinstance(value, Tensor):
            scalars, given = self._constant(value.detach()), value.dtype
        else:
            key = (repr(value), dtype)
            if key not in self._literals:
                plain = torch.tensor(value, dtype=dtype)
                self._literals[key] = self._constant(plain), plain.dtype
            scalars, given = self._literals[key]
        return (
            scalars
            if dtype is None or given == dtype
            else scalars.map_numbers(lambda number: self.into.cast(number, dtype))
        )

    def _constant(self, plain: Tensor) -> _Scalars:
        rows = plain.shape[:1] == (ROWS,)
        same = rows and bool(((plain == plain[:1]) | (plain != plain)).all())
        one = plain[0] if same else plain
        if one.numel() > LARGEST_ROW:
            raise UntraceableError(f"a constant of {one.numel()} entries")
        if rows and not same:
            raise UntraceableError("an operation mixes rows")
        numbers = [self.into.number("constant", (entry,), plain.dtype) for entry in one.flatten().tolist()]
        return _Scalars(np.array(numbers, dtype=np.int64).reshape(tuple(one.shape)), rows=rows, marked=False)

    def __torch_dispatch__(
        self, func: Any, types: Any, args: tuple[Any, ...] = (), kwargs: dict[str, Any] | None = None
    ) -> Any:
        """Run the operation on the tensors and on their scalars."""
        kwargs, name = kwargs or {}, func.overloadpacket.__name__
        tensors = [leaf for leaf in _leaves((args, kwargs)) if isinstance(leaf, Tensor)]
        for leaf in tensors:
            if id(leaf) in self._large:
                raise UntraceableError(self._large[id(leaf)][1])
        follows = any(map(self.depends_on_input, tensors))
        if follows and name in COMPOSED:
            with self:
                return COMPOSED[name](*args, **kwargs)
        if follows and name in IN_PLACE and torch._C._current_graph_task_id() >= 0:  # on tensors of its own
            with self:
                result = IN_PLACE[name](*args, **kwargs)
            return self._note(args[0], self.find_scalars(result, args[0].dtype))
        if follows and not any(name in known for known in (MOVES, INTO_ZEROS, REDUCTIONS, POINTWISE)):
            with self:
                result = func.decompose(*args, **kwargs)
            if result is not NotImplemented:
                return result
            raise UntraceableError(_refusal(name))
        if torch.Tag.nondeterministic_seeded in func.tags:
            raise UntraceableError(f"torch.{name} draws random numbers")
        if "empty" in name:
            raise UntraceableError(f"torch.{name}: writes to this memory cannot be traced")
        result = func(*args, **kwargs)
        if not follows:
            return _map_leaves(result, lambda leaf: self._note(leaf, None) if isinstance(leaf, Tensor) else leaf)
        if name in INTO_ZEROS:
            return self._note(result, _Scalars.from_numbers(self._into_zeros(name, args, result)))
        if name in MOVES:
            moved = self._move_elements(func, args, kwargs, result)
            if isinstance(result, (list, tuple)):
                return [self._note(leaf, _Scalars.from_numbers(own)) for leaf, own in zip(result, moved, strict=True)]
            return self._note(result, _Scalars.from_numbers(moved))
        make = self._reduce if name in REDUCTIONS else self._pointwise
        return self._note(result, make(name, args, kwargs, result))

    def _note(self, tensor: Tensor, scalars: _Scalars | None) -> Tensor:
        self._scalars[id(tensor)], self._owners[id(tensor)] = (tensor, scalars), self.into
        return tensor

    def _move_elements(self, func: Any, args: Any, kwargs: Any, result: Any) -> Any:
        """Apply an operation that only moves elements to the numbers; ``constant_pad_nd`` adds a constant."""
        dtype = result[0].dtype if isinstance(result, (list, tuple)) else result.dtype
        if func.overloadpacket.__name__ == "index_select":
            return func(self.find_scalars(args[0], dtype).all, *args[1:])
        if func.overloadpacket.__name__ == "constant_pad_nd":
            value = args[2] if len(args) > 2 else kwargs.get("value", 0.0)
            args = (*args[:2], self.into.number("constant", (torch.tensor(value, dtype=dtype).item(),), dtype))
        return func(
            *_map_leaves(args, lambda leaf: self.find_scalars(leaf, dtype).all if isinstance(leaf, Tensor) else leaf),
            **kwargs,
        )

    def _into_zeros(self, name: str, args: Any, result: Tensor) -> Tensor:
        """Return zeros with a slice or an entry replaced by a gradient."""
        zero = self.into.number("constant", (torch.zeros((), dtype=result.dtype).item(),), result.dtype)
        numbers = torch.full(result.shape, zero, dtype=torch.int64)
        if result.shape[:1] == (ROWS,):
            numbers += _marks(result.ndim - 1)
        INTO_ZEROS[name](numbers, *args[2:]).copy_(self.find_scalars(args[0], result.dtype).all)
        return numbers

    def _pointwise(self, name: str, args: Any, kwargs: Any, result: Tensor) -> _Scalars:
        operation = POINTWISE[name]
        if (unknown := set(kwargs) - operation.known) or (operation.floats and not result.dtype.is_floating_point):
            raise UntraceableError(f"torch.{name} of {result.dtype}{' with ' if unknown else ''}{', '.join(unknown)}")
        if name in ("bitwise_or", "bitwise_not") and result.dtype != torch.bool:
            raise UntraceableError(f"torch.{name} of integers")
        values = operation.arguments(args, kwargs)
        inside = torch.result_type(*values) if operation.compares else operation.inside or result.dtype
        types = operation.types or (inside,) * len(values)
        given = [self.find_scalars(value, dtype) for value, dtype in zip(values, types, strict=True)]
        into, dtype = self.into, result.dtype
        return _broadcast(lambda *row: into.cast(operation.make(into, row, dtype), dtype), given, result.shape)

    def _reduce(self, name: str, args: Any, kwargs: Any, result: Tensor) -> _Scalars:
        reduction, given = REDUCTIONS[name], args[0]
        dims, keep = reduction.dims(args, kwargs, given.ndim)
        scalars = self.find_scalars(given, torch.bool if name in ("any", "all") else result.dtype)
        if scalars.rows and 0 in dims:
            raise UntraceableError(f"torch.{name} over the rows")
        one, over = scalars.one, sorted(dim - scalars.rows for dim in dims)
        kept = [dim for dim in range(one.ndim) if dim not in over]
        shape = [one.shape[dim] for dim in kept]
        rows = one.transpose(kept + over).reshape(math.prod(shape), -1).tolist()
        made = [reduction.make(self.into, tuple(row), result.dtype, args, kwargs) for row in rows]
        reduced = np.array(made, dtype=np.int64).reshape(shape)
        return _Scalars(np.expand_dims(reduced, over) if keep else reduced, rows=scalars.rows)


class _ExternalTensors(TorchFunctionMode):
    """Function mode that refuses tensors from elsewhere, which may change between calls, or lifts them to inputs."""

    def __init__(
        self, watch: _Recorder, num_inputs: int, num_rows: int | None, *, fixes: bool,
        known: Callable[[Tensor], Mapping[int, float]] | None,
    ) -> None:  # fmt: skip
        """Store the number of inputs, and of rows if tensors are lifted, and the function of their known entries."""
        super().__init__()
        self._watch, self._next, self._num_rows, self._fixes, self._known = watch, num_inputs, num_rows, fixes, known
        self._lifted: dict[int, tuple[Tensor, Tensor]] = {}  # placeholders by id of a kept tensor

    def __torch_function__(
        self, func: Any, types: Any, args: tuple[Any, ...] = (), kwargs: dict[str, Any] | None = None
    ) -> Any:
        """Run the function with placeholders for external tensors."""
        if func in _BRANCHES and self._watch.depends_on_input(args[0]):
            raise UntraceableError(_VALUE)
        args = _map_leaves(args, self._substitute)
        return func(*args, **{name: _map_leaves(value, self._substitute) for name, value in (kwargs or {}).items()})

    def _substitute(self, leaf: Any) -> Any:
        """Return the placeholder of an external tensor; other values unchanged."""
        if not isinstance(leaf, Tensor) or self._watch.is_traced(leaf):
            return leaf
        if id(leaf) not in self._lifted:
            self._lifted[id(leaf)] = (leaf, self._lift(leaf))
        return self._lifted[id(leaf)][1]

    def _lift(self, tensor: Tensor) -> Tensor:
        if self._fixes:
            return self._watch.constant(tensor)
        refused = tensor.requires_grad and not self._watch.into.simplifies
        if self._num_rows is None or tensor.shape[:1] != (self._num_rows,) or refused:
            raise UntraceableError(f"it reads a tensor of shape {tuple(tensor.shape)} that is not among its arguments")
        if self._watch.into is not self._watch.whole:
            raise UntraceableError(_NOT_AN_ARGUMENT)
        own = tensor.stride(0) != 0 or self._num_rows == 1
        kept = tensor if own else tensor[0]
        if self._known is not None:
            self._watch.constants.update({(self._next, i): value for i, value in self._known(tensor).items()})
        placeholder = self._watch.add_input(self._next, kept, rows=own)
        self._watch.into.lifted.append(kept)
        self._watch.into.sources.append(tensor)
        self._next += 1
        return placeholder if own else placeholder.expand(ROWS, *placeholder.shape)


@cache
def _marks(ndim: int) -> Tensor:
    """Return the marks of all rows, with ``ndim`` further dimensions."""
    return _MARK * torch.arange(1, ROWS + 1).view(-1, *[1] * ndim)


def _remove_marks(numbers: Tensor) -> Array:
    """Remove the marks: return the numbers of one row, or of a shared tensor.

    Raises:
        UntraceableError: If a row does not have its own.
    """
    given = numbers.numpy()
    rows = numbers.shape[:1] == (ROWS,)
    first = given[0] if rows else given
    own = first >= _MARK if rows else False  # the others are constants or shared
    if not ((first >= 0) & (first < (1 + own) * _MARK)).all() or (
        rows and not (given[1:] - given[:-1] == own * _MARK).all()
    ):
        raise UntraceableError("an operation mixes rows")
    return np.asarray(first - own * _MARK)


_NOT_AN_ARGUMENT = "a called function reads a tensor that is not among its arguments"
_VALUE = "a branch on a value, or a number taken out of a tensor"
_BRANCHES = (
    Tensor.__bool__,
    Tensor.__float__,
    Tensor.__int__,
    Tensor.__array__,
    Tensor.item,
    Tensor.numpy,
    Tensor.tolist,
)


def _refusal(name: str) -> str:
    """Return the reason why an operation cannot be traced."""
    if name == "_local_scalar_dense":
        return _VALUE
    if name.endswith("_"):
        return f"torch.{name} writes in place"
    return f"torch.{name} is not a supported operation of row kernels"


def _leaves(value: Any) -> list[Any]:
    if isinstance(value, dict):
        value = list(value.values())
    return [leaf for item in value for leaf in _leaves(item)] if isinstance(value, (list, tuple)) else [value]


def _map_leaves(value: Any, change: Callable[[Any], Any]) -> Any:
    if isinstance(value, (list, tuple)):
        return type(value)(_map_leaves(item, change) for item in value)
    return change(value)
