"""A pure torch function of rows as one launch.

Letters: E rows.
"""

import hashlib
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import torch
import warp as wp
from torch import Tensor

from aerial_gym.interop.launches import compile_ahead, wait_for
from aerial_gym.interop.rows.source import WARP_TYPES, write
from aerial_gym.interop.rows.tracing import trace
from aerial_gym.interop.streams import BLOCK_DIM, on_torch_stream, start_warp

_kernels: dict[str, wp.Kernel] = {}
"""By source: two functions that do the same share a kernel."""


@dataclass(frozen=True, kw_only=True)
class Before:
    """What a kernel does in each of its rows before the traced function: it may write inputs of that row."""

    function: wp.Function
    """``wp.func`` (row: int, given: the struct)."""

    given_type: Any
    """The ``wp.struct``."""

    given: Any
    """Its value; what it points to must be kept alive."""


class RowFunction:
    """Does what a torch function does to every row, in one Warp kernel; no gradients flow through it."""

    def __init__(
        self,
        function: Callable[..., Tensor | tuple[Tensor, ...]],
        inputs: Sequence[Tensor],
        *,
        masked: bool = False,
        before: Before | None = None,
    ) -> None:
        """Trace the function and write its kernel, which is compiled at the first call.

        Args:
            function: Pure; takes tensors, returns tensors of E rows. It is traced once: numbers that it reads from elsewhere
                are those of this moment.
            inputs: What it will be called with, or tensors of the same shapes and types: (E, ...), or of any other first
                dimension for what all rows share.
            masked: Whether calls give a mask: other rows are then neither computed nor written.
            before: What the kernel does in a row before all.

        Raises:
            UntraceableError: If it cannot be done row by row; the text says why.
        """
        start_warp()
        traced = trace(function, inputs)
        source = write(traced, masked=masked, prepared=before is not None)
        self._before = [] if before is None else [before.given]
        self.code = source.code
        """The kernel."""
        self._inputs, self._shared = source.inputs, source.shared
        self._outputs = [(shape, dtype) for _, shape, dtype in traced.outputs]
        self.kernel = _kernel(source.code, before, source.names)
        """It as Warp has it."""
        compile_ahead(self.kernel, wp.device_from_torch(next(tensor for tensor in inputs if tensor.ndim).device))
        self._ready = False
        self._known: dict[int, tuple[Tensor, wp.array]] = {}

    def __call__(
        self, *inputs: Tensor, out: Sequence[Tensor | None] = (), mask: Tensor | None = None
    ) -> tuple[Tensor, ...]:
        """Return the results; launched on torch's current stream, not waited for.

        Args:
            inputs: As at construction. Tensors that stay the same objects from call to call cost nothing more.
            out: Receives the results, where given; new tensors are made for the others. An input may be an output.
            mask: Rows to compute, bool (E,); given exactly if the function is masked, and then with all of ``out``.
        """
        first = next(tensor for tensor in inputs if tensor.ndim)
        rows, device = first.shape[0], first.device
        given = [*out, *[None] * (len(self._outputs) - len(out))]
        results = [
            torch.empty((rows, *shape), dtype=dtype, device=device) if tensor is None else tensor
            for tensor, (shape, dtype) in zip(given, self._outputs, strict=True)
        ]
        arrays = [] if mask is None else [self._view(len(inputs), mask)]
        arrays += [*self._before, *(self._view(i, inputs[i]) for i in self._inputs)]
        arrays += [
            _as_rows(tensor, passing=True) if new is None else self._view(-1 - i, tensor)
            for i, (tensor, new) in enumerate(zip(results, given, strict=True))
        ]
        target = wp.device_from_torch(device)
        if not self._ready:
            wait_for(self.kernel, target)
            self._ready = True
        with on_torch_stream(first):
            wp.launch(self.kernel, dim=rows, inputs=arrays, device=target, block_dim=BLOCK_DIM)
        return tuple(results)

    def _view(self, key: int, tensor: Tensor) -> wp.array:
        known = self._known.get(key)
        if known is None or known[0] is not tensor:
            known = self._known[key] = (tensor, _as_rows(tensor, shared=key in self._shared))
        return known[1]


def _as_rows(tensor: Tensor, *, shared: bool = False, passing: bool = False) -> wp.array:
    """Return the tensor as Warp sees it: (E, n), or (n,) where all rows share it. Nothing is copied.

    What is ``passing``, for one launch, is described to Warp alone, which is faster.
    """
    kind = getattr(wp, WARP_TYPES[tensor.dtype])
    view = tensor.view(-1) if shared else tensor.view(tensor.shape[0], -1)
    return wp.from_torch(view, dtype=kind, requires_grad=False, return_ctype=passing)


def _kernel(code: str, before: Before | None, names: dict[str, Any]) -> wp.Kernel:
    """Return the kernel of a source; the same in every process, so that Warp finds it in its cache."""
    given = "" if before is None else f"# before: {before.function.key}\n"
    if given + code not in _kernels:
        namespace: dict[str, object] = {"wp": wp, **names}
        if before is not None:
            namespace |= {"before": before.function, "given_type": before.given_type}
        exec(code, namespace)
        name = f"aerial_gym_rows_{hashlib.sha256((given + code).encode()).hexdigest()[:12]}"
        module = wp.get_module(name)
        module.options["enable_backward"] = False
        _kernels[given + code] = wp.Kernel(namespace["rows"], key="rows", source=code, module=module)
    return _kernels[given + code]
