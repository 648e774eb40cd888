"""A pure torch function of rows as one kernel launch, with its gradient, and a masked update of rows from other rows.

A gradient is one more launch in place of torch's many. The backward pass is traced like the forward pass, with torch's own
formulas. It recomputes their intermediates in registers.
Letters: E rows.
"""

import hashlib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import torch
import warp as wp
from torch import Tensor

from aerial_gym.interop.launches import BLOCK_DIM, compile_ahead, on_torch_stream, wait_for_kernel
from aerial_gym.interop.rows.row_trace import UntraceableError, trace
from aerial_gym.interop.rows.source import WARP_TYPES, write
from aerial_gym.interop.warp_start import start_warp

_kernels: dict[str, wp.Kernel] = {}  # Kernels by source; equal functions share a kernel


@dataclass(frozen=True, kw_only=True)
class KernelInput:
    """An input that the kernel computes in each row, by straight-line code."""

    lines: tuple[str, ...]  # Warp code that computes `made_0`, `made_1`, ... of `row` from `given`
    names: Mapping[str, Any]  # Names that the code uses, besides `wp`
    given_type: Any  # The `wp.struct` of `given`
    given: Any  # Its value; what it points to must be kept alive


@dataclass(frozen=True, kw_only=True)
class RowWork:
    """Work on a row by a separate thread of any kernel."""

    function: wp.Function  # `wp.func` (row: int, given: the struct)
    given_type: Any  # The `wp.struct`
    given: Any  # Its value; what it points to must be kept alive


class RowFunction:
    """A torch function applied to every row in one Warp kernel, without gradients."""

    def __init__(
        self, function: Callable[..., Tensor | tuple[Tensor, ...]], inputs: Sequence[Tensor], *, masked: bool = False,
        made: KernelInput | None = None, beside: RowWork | None = None, lifts: bool = False, fresh: bool = False,
    ) -> None:  # fmt: skip
        """Trace the function and write its kernel; the first call compiles it.

        Args:
            function: Pure function from tensors to tensors of E rows. It is traced once, so that numbers from elsewhere become
                constants.
            inputs: Example inputs of the right shapes and types: (E, ...), or another first dimension for tensors that all
                rows share.
            masked: Whether calls give a mask; other rows are then neither computed nor written.
            made: The first input, if the kernel computes it; calls ignore theirs.
            beside: Work of other threads on the same masked rows; neither reads the other's results.
            lifts: Whether the function may read tensors (E, ...) from elsewhere, which must keep their memory.
            fresh: Whether every call has new contiguous inputs; excludes a mask, ``made`` and ``beside``.

        Raises:
            UntraceableError: If it cannot be computed row by row; the text states the reason.
        """
        start_warp()
        traced = trace(function, inputs, lifts=lifts)
        self.lifted = tuple(traced.lifted)
        """Lifted tensors from elsewhere, as kernel arrays."""
        source = write(traced, masked=masked, made=() if made is None else made.lines, beside=beside is not None)
        self._given = [each.given for each in (beside, made) if each is not None]
        self._threads = 1 if beside is None else 2
        self._block_dim = (
            self._threads * BLOCK_DIM
        )  # equally many blocks, most of which exit at once (measured on an H200)
        self.code = source.code
        """The kernel."""
        self._inputs, self._shared = source.inputs, source.shared
        self.outputs = [(shape, dtype) for _, shape, dtype in traced.outputs]
        self.kernel = _kernel(source.code, source.names, made, beside)
        """It as Warp has it."""
        device = wp.device_from_torch(next(tensor for tensor in inputs if tensor.ndim).device)
        compile_ahead(self.kernel, device, block_dim=self._block_dim)
        self._ready = False
        self._fresh = fresh
        self._recorded: tuple[int, wp.Launch] | None = None
        self._known: dict[int, tuple[Tensor, wp.array]] = {}

    def __call__(
        self, *inputs: Tensor, out: Sequence[Tensor | None] = (), mask: Tensor | None = None
    ) -> tuple[Tensor, ...]:
        """Launch on torch's current stream, and return the results without waiting.

        Args:
            inputs: As at construction. Tensors that are the same objects in all calls cost nothing more.
            out: Memory for results; new tensors are allocated for missing ones. An input may be an output.
            mask: Rows to compute, bool (E,); required with all of ``out`` if the function is masked, else forbidden.
        """
        first = next(tensor for tensor in inputs if tensor.ndim)
        rows, device = first.shape[0], first.device
        inputs = (*inputs, *self.lifted)
        given = [*out, *[None] * (len(self.outputs) - len(out))]
        results = [
            torch.empty((rows, *shape), dtype=dtype, device=device) if tensor is None else tensor
            for tensor, (shape, dtype) in zip(given, self.outputs, strict=True)
        ]
        if self._fresh:
            self._launch([*(inputs[i] for i in self._inputs), *results], rows)
            return tuple(results)
        arrays = [] if mask is None else [self._view(len(inputs), mask)]
        arrays += [*self._given, *(self._view(i, inputs[i]) for i in self._inputs)]
        arrays += [
            _as_rows(tensor, passing=True) if new is None else self._view(-1 - i, tensor)
            for i, (tensor, new) in enumerate(zip(results, given, strict=True))
        ]
        target = self._wait(device)
        with on_torch_stream(first):
            wp.launch(self.kernel, dim=self._threads * rows, inputs=arrays, device=target, block_dim=self._block_dim)
        return tuple(results)

    def _wait(self, device: torch.device) -> wp.Device:
        """Wait for the kernel on a device, and return the Warp device."""
        target = wp.device_from_torch(device)
        if not self._ready:
            wait_for_kernel(self.kernel, target, block_dim=self._block_dim)
            self._ready = True
        return target

    def _launch(self, tensors: Sequence[Tensor], rows: int) -> None:
        """Launch on new tensors of the same shapes; only their addresses are passed."""
        if self._recorded is None or self._recorded[0] != rows:
            shared = [i in self._shared for i in self._inputs] + [False] * len(self.outputs)
            arrays = [_as_rows(tensor, shared=same) for tensor, same in zip(tensors, shared, strict=True)]
            target = self._wait(tensors[0].device)
            command = wp.launch(
                self.kernel, dim=rows, inputs=arrays, device=target, block_dim=self._block_dim, record_cmd=True
            )
            assert isinstance(command, wp.Launch)
            self._recorded = (rows, command)
        _, command = self._recorded
        for place, tensor in enumerate(tensors, start=1):  # behind the bounds
            command.params[place].data = tensor.data_ptr()
        with on_torch_stream(tensors[0]):
            command.launch()

    def _view(self, key: int, tensor: Tensor) -> wp.array:
        known = self._known.get(key)
        if known is None or known[0] is not tensor:
            known = self._known[key] = (tensor, _as_rows(tensor, shared=key in self._shared))
        return known[1]


def _as_rows(tensor: Tensor, *, shared: bool = False, passing: bool = False) -> wp.array:
    """Return a Warp view of a tensor: (E, n), or (n,) if all rows share it, without a copy.

    A ``passing`` view, for one launch, skips the registration of memory, which is faster.
    """
    kind = getattr(wp, WARP_TYPES[tensor.dtype])
    view = tensor.view(-1) if shared else tensor.view(tensor.shape[0], -1)
    return wp.from_torch(view, dtype=kind, requires_grad=False, return_ctype=passing)


def _kernel(code: str, names: dict[str, Any], made: KernelInput | None, beside: RowWork | None) -> wp.Kernel:
    """Return the kernel of a source, with the same name in every process, so that Warp's cache finds it."""
    more: dict[str, Any] = {}
    if made is not None:
        more |= {"given_type": made.given_type, **made.names}
    if beside is not None:
        more |= {"beside": beside.function, "beside_type": beside.given_type}
    meant = "".join(f"# {name}: {value.key}\n" for name, value in more.items())
    if meant + code not in _kernels:
        namespace = {"wp": wp, **names, **more}
        exec(code, namespace)
        name = f"aerial_gym_rows_{hashlib.sha256((meant + code).encode()).hexdigest()[:12]}"
        module = wp.get_module(name)
        module.options["enable_backward"] = False
        _kernels[meant + code] = wp.Kernel(namespace["rows"], key="rows", source=code, module=module)
    return _kernels[meant + code]


class DifferentiableRows:
    """A torch function applied to every row in one Warp kernel, with its gradient in another."""

    def __init__(
        self, function: Callable[..., tuple[Tensor, ...]], inputs: Sequence[Tensor], *, lifts: bool = False,
        has_gradient: Callable[[int], bool] = lambda _: True,
    ) -> None:  # fmt: skip
        """Trace the function and its gradient with respect to all float inputs.

        A result that a loss ignores has a gradient of 0; if its derivatives are not finite, the product is NaN.

        Args:
            function: Pure function from tensors to tensors of E rows, traced once.
            inputs: Example inputs of the right shapes and types, (E, ...) or shared by all rows; shared ones have no gradient.
            lifts: Whether the function may read tensors (E, ...) from elsewhere, which must keep their memory; they have no
                gradient.
            has_gradient: Whether the result of an index has a gradient; called after one call of the function.

        Raises:
            UntraceableError: If the function or its gradient cannot be computed row by row; the text states the reason.
        """
        rows = next(tensor.shape[0] for tensor in inputs if tensor.ndim)
        wanted = [i for i, tensor in enumerate(inputs) if tensor.is_floating_point() and tensor.shape[:1] == (rows,)]
        self._forward = RowFunction(function, inputs, lifts=lifts, fresh=True)
        self.outputs = self._forward.outputs
        pulled = [i for i, (_, dtype) in enumerate(self.outputs) if dtype.is_floating_point and has_gradient(i)]
        seeds = [inputs[0].new_empty(rows, *self.outputs[i][0], dtype=self.outputs[i][1]) for i in pulled]
        self._back = RowFunction(
            _pullback(function, len(inputs), wanted, pulled), [*inputs, *seeds], lifts=lifts, fresh=True
        )
        self._num_inputs, self._wanted, self._pulled = len(inputs), wanted, pulled

    def __call__(self, *inputs: Tensor) -> tuple[Tensor, ...]:
        """Launch on torch's current stream, and return the differentiable results without waiting."""
        return _Rows.apply(self, *inputs)


def _pullback(
    function: Callable[..., tuple[Tensor, ...]], num_inputs: int, wanted: Sequence[int], pulled: Sequence[int]
) -> Callable[..., tuple[Tensor, ...]]:
    """Return the function from inputs and gradients of some results to gradients of some inputs."""

    def back(*given: Tensor) -> tuple[Tensor, ...]:
        with torch.enable_grad():
            inputs = list(given[:num_inputs])
            for i in wanted:
                inputs[i] = inputs[i].detach().requires_grad_()
            results = function(*inputs)
            pairs = [
                (results[i], seed)
                for i, seed in zip(pulled, given[num_inputs:], strict=True)
                if results[i].requires_grad
            ]
            ends, seeds = zip(*pairs, strict=True)
            input_grads = torch.autograd.grad(ends, [inputs[i] for i in wanted], seeds, allow_unused=True)
        none = [torch.zeros_like(given[i]) for i in wanted]
        return tuple(zero if grad is None else grad for grad, zero in zip(input_grads, none, strict=True))

    return back


class _Rows(torch.autograd.Function):
    @staticmethod
    def forward(ctx: Any, rows: DifferentiableRows, *inputs: Tensor) -> tuple[Tensor, ...]:
        results = rows._forward(*(tensor.contiguous() for tensor in inputs))
        ctx.rows = rows
        ctx.save_for_backward(
            *inputs, *rows._back.lifted
        )  # torch refuses the backward pass if these were written since
        ctx.mark_non_differentiable(*(result for i, result in enumerate(results) if i not in rows._pulled))
        return results

    @staticmethod
    def backward(ctx: Any, *grads: Tensor) -> tuple[Tensor | None, ...]:  # pyright: ignore[reportIncompatibleMethodOverride]
        rows = ctx.rows
        inputs = ctx.saved_tensors[: rows._num_inputs]
        given = [tensor.contiguous() for tensor in (*inputs, *(grads[i] for i in rows._pulled))]
        input_grads = dict(zip(rows._wanted, rows._back(*given), strict=True))
        return (None, *(input_grads.get(i) for i in range(len(inputs))))


class RowUpdate:
    """Update of target tensors from source tensors by a row function, in one launch on masked rows only.

    An untraceable function runs as plain torch on all rows and is written by the mask: correct, but slower.
    """

    def __init__(
        self, function: Callable[..., tuple[Tensor, ...]], sources: Sequence[Tensor], targets: Sequence[Tensor], *,
        mask: Tensor, made: KernelInput, beside: RowWork, plain: Callable[..., tuple[Tensor, ...]] | None = None,
    ) -> None:  # fmt: skip
        """Record the launch for fixed tensors.

        Args:
            sources: Inputs of the function, (E, ...).
            targets: Memory for its results, (E, ...).
            mask: Rows to write, bool, (E,); read at every call.
            made: Computation of the first source, which comes first in each masked row and is written.
            beside: Further work on each masked row; neither reads the other's results.
            plain: The same function for untraceable cases; it may read tensors from elsewhere.
        """
        self._function, self._sources, self._targets = plain or function, list(sources), list(targets)
        self._written = [sources[0], *targets]
        self._mask = mask
        self._rows: RowFunction | None = None
        self.why_slow = ""
        """Why it runs as plain torch; empty where it is one launch."""
        try:
            self._rows = RowFunction(
                lambda *given: (given[0], *function(*given)), sources, masked=True, made=made, beside=beside
            )
        except UntraceableError as error:
            self.why_slow = str(error)
            self._alone = RowFunction(lambda source: source, sources[:1], masked=True, made=made, beside=beside)

    def __call__(self) -> None:
        """Launch the update of masked rows on torch's current stream."""
        if self._rows is not None:
            self._rows(*self._sources, out=self._written, mask=self._mask)
            return
        self._alone(self._sources[0], out=self._sources[:1], mask=self._mask)
        with torch.no_grad():
            for target, rows in zip(self._targets, self._function(*self._sources), strict=True):
                target.copy_(torch.where(self._mask.view(-1, *[1] * (target.ndim - 1)), rows, target))

    def mark_written(self) -> None:
        """Mark the targets as modified for torch, so that a backward pass through old values raises an error."""
        for target in self._targets:
            target.add_(0.0)
