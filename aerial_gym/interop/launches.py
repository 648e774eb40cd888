"""Reusable kernel launches on torch's streams and in threads, and compilation of their kernels in background threads.

Warp compiles a module at the first launch or recording of one of its kernels, and blocks. Here a launch is recorded at its
first use, and threads compile its module before that, in parallel with others.
"""

import os
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor, wait
from contextlib import contextmanager, nullcontext
from contextvars import ContextVar
from functools import cache, cached_property
from itertools import pairwise
from threading import Lock
from typing import Any, TypeVar

import torch
import warp as wp
from threadpoolctl import threadpool_limits
from torch import Tensor

BLOCK_DIM = 64  # Threads of a block with one per environment: Warp's 256 would leave most multiprocessors idle
MAX_WORKERS = 4  # Most modules compiled at the same time; each worker reads Warp's headers once, in 2 s
HEADER_FLAGS = "-DWP_NO_BFLOAT16= -fpch-instantiate-templates"
"""Leave out bfloat16, a fifth of Warp's headers, which no kernel here uses. Instantiate templates once, with the precompiled
headers: each kernel then compiles in 0.07 s less; a small one took 0.08 s."""

LONGEST_SEARCHED = 2000
"""Largest number of lines of a kernel with superword vectorisation on CPUs. Most kernels have tens to hundreds of lines, and
gain; the 3700 lines of 337 observations would compile in 45 s instead of 6."""

_begun: dict[tuple[wp.Module, str, int | None], Future[None]] = {}  # By module, device and block size, None on a CPU


@cache
def _workers() -> ThreadPoolExecutor:
    return ThreadPoolExecutor(min(os.cpu_count() or 1, MAX_WORKERS), thread_name_prefix="compile")


def _reset_after_fork() -> None:
    """Reset the compilations in a forked process, which has no threads of its parent."""
    for pool in (_workers, _workers_of_one_thread, _pool):
        pool.cache_clear()
    _begun.clear()


if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_reset_after_fork)


def compile_ahead(kernel: wp.Kernel, device: wp.Device, *, block_dim: int = BLOCK_DIM) -> None:
    """Start to compile a kernel for a device, or to load it from Warp's cache, in the background."""
    key = _compilation_key(kernel, device, block_dim)
    if key in _begun:
        return
    if device.is_cpu and wp.config.cpu_compiler_flags is not None:
        flags = [wp.config.cpu_compiler_flags, HEADER_FLAGS]  # one set for nearly all: headers are precompiled for each
        flags += _compiler_flags_of_long_kernel(kernel)
        kernel.module.options["cpu_compiler_flags"] = " ".join(flags)
    _begun[key] = _workers().submit(
        wp.force_load, device=device, modules=[kernel.module], block_dim=key[2], max_workers=0
    )


def _compilation_key(kernel: wp.Kernel, device: wp.Device, block_dim: int) -> tuple[wp.Module, str, int | None]:
    return kernel.module, device.alias, None if device.is_cpu else block_dim


def _compiler_flags_of_long_kernel(kernel: wp.Kernel) -> tuple[str, ...]:
    """Return the compiler flags of a kernel with very many lines."""
    return ("-fno-slp-vectorize",) if kernel.adj.source.count("\n") > LONGEST_SEARCHED else ()


def wait_for_kernel(kernel: wp.Kernel, device: wp.Device, *, block_dim: int = BLOCK_DIM) -> None:
    """Wait until a kernel of ``compile_ahead`` can be launched; compile errors appear at the launch."""
    begun = _begun.get(_compilation_key(kernel, device, block_dim))
    if begun is not None:
        wait([begun])


def wait_for_all() -> None:
    """Wait for all kernels of ``compile_ahead``, because a GPU loads none during the capture of a CUDA graph."""
    wait(_begun.values())


@contextmanager
def on_torch_stream(tensor: Tensor) -> Iterator[None]:
    """Run Warp launches on the torch stream of ``tensor``'s device; no effect on the CPU."""
    if tensor.device.type != "cuda":
        yield
        return
    stream = wp.stream_from_torch(torch.cuda.current_stream(tensor.device))
    with wp.ScopedStream(
        stream, sync_enter=False
    ):  # without an event on Warp's own stream, which would break a capture
        yield


class ReusableLaunch:
    """A launch with fixed arguments, for repeated use.

    The first use waits for the compilation of its kernel.
    """

    def __init__(
        self, kernel: wp.Kernel, *, dim: int | Sequence[int], inputs: Sequence[object],
        outputs: Sequence[object] = (), device: wp.Device | torch.device, block_dim: int = BLOCK_DIM, tiled: bool = False,
    ) -> None:  # fmt: skip
        """Store the arguments of ``warp.launch``, or of ``warp.launch_tiled`` if ``tiled``. Tensors become arrays of the types
        that the kernel declares. All arguments are kept alive."""
        device = wp.device_from_torch(device) if isinstance(device, torch.device) else device
        self._kernel, self._device = kernel, device
        arguments = [self._argument(place, value) for place, value in enumerate((*inputs, *outputs))]
        self._given = {"dim": dim, "inputs": arguments, "block_dim": block_dim}
        self._launch = wp.launch_tiled if tiled else wp.launch
        compile_ahead(kernel, device, block_dim=block_dim)

    @cached_property
    def command(self) -> wp.Launch:
        """The launch as Warp recorded it."""
        wait_for_kernel(self._kernel, self._device, block_dim=self._given["block_dim"])
        command = self._launch(self._kernel, device=self._device, record_cmd=True, **self._given)
        assert isinstance(command, wp.Launch)
        return command

    def set_param_at_index(self, index: int, value: object) -> None:
        """Replace an argument."""
        self.command.set_param_at_index(index, self._argument(index, value))

    def launch(self, like: Tensor | None = None) -> None:
        """Launch without waiting, on Warp's current stream, or on torch's for the device of a tensor."""
        with nullcontext() if like is None else on_torch_stream(like):
            self.command.launch()

    def _argument(self, place: int, value: object) -> object:
        return _as_declared(value, self._kernel.adj.args[place].type)


def make_struct(kind: Any, **values: object) -> Any:
    """Return a Warp struct with the given fields; tensors become arrays of the declared types and are kept alive."""
    struct = kind()
    for name, value in values.items():
        setattr(struct, name, _as_declared(value, kind.cls.__annotations__[name]))
    return struct


def _as_declared(value: object, kind: Any) -> object:
    """Return a tensor as an array of the declared type; other values unchanged."""
    if not isinstance(value, Tensor):
        return value
    return wp.from_torch(value, dtype=kind.dtype if hasattr(kind.dtype, "_wp_scalar_type_") else None)


@contextmanager
def on_device(device: torch.device) -> Iterator[None]:
    """Make a GPU torch's current device; no effect for the CPU."""
    with torch.cuda.device(device) if device.type == "cuda" else nullcontext():
        yield


@contextmanager
def record_graph(graph: torch.cuda.CUDAGraph, device: torch.device, *, errors: str = "global") -> Iterator[None]:
    """Capture launches into a CUDA graph, on a stream of the given GPU.

    torch's own capture stream belongs to the GPU of the first capture. Pending compilations are awaited first, because a GPU
    loads no kernel during a capture.

    Args:
        graph: Receives the launches.
        errors: torch's ``capture_error_mode``.
    """
    wait_for_all()
    stream = torch.cuda.Stream(device)
    with on_device(device), torch.cuda.graph(graph, stream=stream, capture_error_mode=errors):
        yield


_compiling = Lock()
_free_threads = ContextVar("free_threads", default=1)  # Threads that torch had outside ``one_thread``; 1 outside it


@contextmanager
def one_thread() -> Iterator[None]:
    """Run torch, and the linear algebra of NumPy and SciPy, on one thread; the others are left to ``map_in_threads``.

    Our tensors on the CPU are small: threads gain nothing on an idle machine and wait for each other on a busy one. On two
    busy cores, a step of 4,096 environments took 18 ms with one thread and 164 ms with two.
    """
    threads = torch.get_num_threads()
    torch.set_num_threads(1)
    before = _free_threads.set(max(threads, _free_threads.get()))
    try:
        with threadpool_limits(1):
            yield
    finally:
        _free_threads.reset(before)
        torch.set_num_threads(threads)


Item = TypeVar("Item")
Result = TypeVar("Result")


def map_in_threads(function: Callable[[Item], Result], items: Sequence[Item]) -> list[Result]:
    """Return the results of independent items, inside ``one_thread`` side by side on as many threads as torch had before.

    Torch, NumPy and Warp release Python's lock while they compute on long arrays. A call from such a thread uses no others.
    """
    workers = min(_free_threads.get(), len(items))
    if workers < 2:
        return [function(item) for item in items]
    return list(_workers_of_one_thread(workers).map(function, items))


def launch_on_cpu(make_kernel: Callable[[], Any], **arguments: Any) -> None:
    """Launch a kernel on the CPU, on one thread at a time: Warp compiles it at its first launch."""
    with _compiling:
        wp.launch(make_kernel(), device="cpu", **arguments)


@cache
def _workers_of_one_thread(workers: int) -> ThreadPoolExecutor:
    return ThreadPoolExecutor(workers, thread_name_prefix="map", initializer=torch.set_num_threads, initargs=(1,))


def split(count: int, parts: int) -> list[tuple[int, int]]:
    """Split ``count`` items into equal parts; return the first item and the size of each."""
    parts = max(1, min(parts, count))
    return [(a, b - a) for a, b in pairwise(count * i // parts for i in range(parts + 1))]


@cache
def _pool(workers: int) -> ThreadPoolExecutor:
    return ThreadPoolExecutor(workers, thread_name_prefix="warp")


def launch_side_by_side(launches: Sequence[ReusableLaunch]) -> None:
    """Run recorded CPU launches in parallel, each on a thread: Warp releases Python's lock while a kernel runs.

    A single launch, as always on a GPU, has no overhead. Split a batch into ``torch.get_num_threads()`` launches, so that
    Warp uses as many cores as torch.
    """
    first, *rest = launches
    futures = [_pool(len(rest)).submit(launch.launch) for launch in rest]
    first.launch()
    wait(futures)
    for other in futures:
        other.result()
