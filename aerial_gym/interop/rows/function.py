"""A pure torch function of rows as one kernel launch.

Letters: E rows.
"""

import hashlib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import torch
import warp as wp
from torch import Tensor

from aerial_gym.interop.launches import compile_ahead, on_torch_stream, wait_for_kernel
from aerial_gym.interop.rows.row_trace import trace
from aerial_gym.interop.rows.source import WARP_TYPES, write
from aerial_gym.interop.streams import BLOCK_DIM
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
        self,
        function: Callable[..., Tensor | tuple[Tensor, ...]],
        inputs: Sequence[Tensor],
        *,
        masked: bool = False,
        made: KernelInput | None = None,
        beside: RowWork | None = None,
        lifts: bool = False,
        fresh: bool = False,
    ) -> None:
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
