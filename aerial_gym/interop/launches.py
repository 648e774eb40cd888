"""Launches that are recorded once and repeated, and the compilation of their kernels beside other work.

Warp compiles a module when one of its kernels is first launched or recorded, while everything else waits. Here a launch is
recorded at its first use. Threads compile its module meanwhile, side by side with others.
"""

import os
from collections.abc import Iterator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor, wait
from contextlib import contextmanager, nullcontext
from functools import cache, cached_property
from typing import Any

import torch
import warp as wp
from torch import Tensor

MAX_WORKERS = 4
"""Modules that are compiled at the same time, at most. Each worker reads Warp's headers once for itself, which takes 2 s."""

NO_BFLOAT16 = "-DWP_NO_BFLOAT16="
"""Leaves out of Warp's headers what only kernels of bfloat16 need, a fifth of them; ours have none. Warp leaves it out of every
such module, but not of the headers that it precompiles."""

LONGEST_SEARCHED = 2000
"""Lines of a kernel up to which a compiler for CPUs looks for operations to do side by side. Most have tens to some hundreds,
and gain; over the 3700 of 337 observations it takes 45 s in place of 6."""

_begun: dict[tuple[wp.Module, str, int | None], Future[None]] = {}
"""By module, device and threads of a block, for each of which a GPU has a module of its own; None on a CPU."""


@cache
def _workers() -> ThreadPoolExecutor:
    return ThreadPoolExecutor(min(torch.get_num_threads(), MAX_WORKERS), thread_name_prefix="compile")


def _forget() -> None:
    """Begin anew in a process that was forked: the threads stayed behind."""
    _workers.cache_clear()
    _begun.clear()


if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_forget)


def compile_ahead(kernel: wp.Kernel, device: wp.Device, *, block_dim: int = 256) -> None:
    """Start to compile a kernel that a device will need, or to fetch it from Warp's cache, and wait for nothing."""
    key = _key(kernel, device, block_dim)
    if key in _begun:
        return
    if (
        device.is_cpu and wp.config.cpu_compiler_flags is not None
    ):  # one set for nearly all: headers are precompiled for each
        kernel.module.options["cpu_compiler_flags"] = " ".join(
            (wp.config.cpu_compiler_flags, NO_BFLOAT16, *_own_flags(kernel))
        )
    _begun[key] = _workers().submit(
        wp.force_load, device=device, modules=[kernel.module], block_dim=key[2], max_workers=0
    )


def _key(kernel: wp.Kernel, device: wp.Device, block_dim: int) -> tuple[wp.Module, str, int | None]:
    return kernel.module, device.alias, None if device.is_cpu else block_dim


def _own_flags(kernel: wp.Kernel) -> tuple[str, ...]:
    """Return the flags of a kernel of very many lines."""
    return ("-fno-slp-vectorize",) if kernel.adj.source.count("\n") > LONGEST_SEARCHED else ()


def wait_for(kernel: wp.Kernel, device: wp.Device, *, block_dim: int = 256) -> None:
    """Wait until a kernel of ``compile_ahead`` can be launched. If it cannot be compiled, its launch says why."""
    begun = _begun.get(_key(kernel, device, block_dim))
    if begun is not None:
        wait([begun])


def wait_for_all() -> None:
    """Wait for all kernels of ``compile_ahead``: a GPU loads none while a CUDA graph is recorded."""
    wait(_begun.values())


@contextmanager
def on_torch_stream(tensor: Tensor) -> Iterator[None]:
    """Run the Warp launches inside on the torch stream of ``tensor``'s device; on the CPU there is nothing to join."""
    if tensor.device.type != "cuda":
        yield
        return
    stream = wp.stream_from_torch(torch.cuda.current_stream(tensor.device))
    with wp.ScopedStream(stream, sync_enter=False):  # no event on Warp's own stream: a capture would refuse it
        yield


class RecordedLaunch:
    """A launch with everything fixed, to be repeated.

    Its kernel may still be compiled when this is made; the first use waits for it.
    """

    def __init__(
        self,
        kernel: wp.Kernel,
        *,
        dim: int | Sequence[int],
        inputs: Sequence[object],
        outputs: Sequence[object] = (),
        device: wp.Device | torch.device,
        block_dim: int = 256,
        tiled: bool = False,
    ) -> None:
        """Take what ``warp.launch`` takes, or ``warp.launch_tiled`` if it is ``tiled``.

        A tensor becomes an array of the type that the kernel declares. All arguments are kept alive.
        """
        device = wp.device_from_torch(device) if isinstance(device, torch.device) else device
        self._kernel, self._device = kernel, device
        arguments = [self._argument(place, value) for place, value in enumerate((*inputs, *outputs))]
        self._given = {"dim": dim, "inputs": arguments, "block_dim": block_dim}
        self._launch = wp.launch_tiled if tiled else wp.launch
        compile_ahead(kernel, device, block_dim=block_dim)

    @cached_property
    def command(self) -> wp.Launch:
        """What Warp recorded."""
        wait_for(self._kernel, self._device, block_dim=self._given["block_dim"])
        command = self._launch(self._kernel, device=self._device, record_cmd=True, **self._given)
        assert isinstance(command, wp.Launch)
        return command

    def set_param_at_index(self, index: int, value: object) -> None:
        """Replace an argument."""
        self.command.set_param_at_index(index, self._argument(index, value))

    def launch(self, like: Tensor | None = None) -> None:
        """Launch it, and do not wait: on the current stream of Warp, or of torch on the device of a tensor."""
        with nullcontext() if like is None else on_torch_stream(like):
            self.command.launch()

    def _argument(self, place: int, value: object) -> object:
        return _as_declared(value, self._kernel.adj.args[place].type)


def make_struct(kind: Any, **values: object) -> Any:
    """Return a Warp struct with values in its fields; a tensor becomes an array of the declared type and is kept alive."""
    struct = kind()
    for name, value in values.items():
        setattr(struct, name, _as_declared(value, kind.cls.__annotations__[name]))
    return struct


def _as_declared(value: object, kind: Any) -> object:
    """Return a tensor as an array of a kind, and anything else as it is."""
    if not isinstance(value, Tensor):
        return value
    return wp.from_torch(value, dtype=kind.dtype if hasattr(kind.dtype, "_wp_scalar_type_") else None)
