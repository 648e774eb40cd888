"""Warp launches on torch's current stream, in order with torch's work, and threads on the CPU."""

from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor, wait
from contextlib import contextmanager, nullcontext
from functools import cache
from itertools import pairwise

import torch
from threadpoolctl import threadpool_limits

from aerial_gym.interop.launches import ReusableLaunch, wait_for_all


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


@contextmanager
def one_thread() -> Iterator[None]:
    """Run torch, and the linear algebra of NumPy and SciPy, on one thread.

    Our tensors on the CPU are small: threads gain nothing on an idle machine and wait for each other on a busy one. On two
    busy cores, a step of 4,096 environments took 18 ms with one thread and 164 ms with two.
    """
    threads = torch.get_num_threads()
    torch.set_num_threads(1)
    try:
        with threadpool_limits(1):
            yield
    finally:
        torch.set_num_threads(threads)


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
