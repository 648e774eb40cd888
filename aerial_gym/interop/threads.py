"""Threads on the CPU: torch's own, and Warp launches side by side."""

from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor, wait
from contextlib import contextmanager
from functools import cache
from itertools import pairwise

import torch
from threadpoolctl import threadpool_limits

from aerial_gym.interop.launches import RecordedLaunch


@contextmanager
def one_thread() -> Iterator[None]:
    """Run torch, and the linear algebra of NumPy and SciPy, on one thread inside.

    Our tensors on the CPU are small: threads win nothing on a quiet machine, and on a busy one they wait for each other.
    A step of 4,096 environments took 18 ms on one and 164 ms on two threads of two cores that were shared with other work.
    """
    threads = torch.get_num_threads()
    torch.set_num_threads(1)
    try:
        with threadpool_limits(1):
            yield
    finally:
        torch.set_num_threads(threads)


def split(count: int, parts: int) -> list[tuple[int, int]]:
    """Return first and number of items of equal parts, at most one per item."""
    parts = max(1, min(parts, count))
    return [(a, b - a) for a, b in pairwise(count * i // parts for i in range(parts + 1))]


@cache
def _pool(workers: int) -> ThreadPoolExecutor:
    return ThreadPoolExecutor(workers, thread_name_prefix="warp")


def launch_side_by_side(launches: Sequence[RecordedLaunch]) -> None:
    """Run recorded CPU launches at the same time, each on a thread: Warp leaves Python's lock while a kernel runs.

    One launch, as always on a GPU, costs nothing more. Split a batch into ``torch.get_num_threads()`` launches, so that
    Warp uses as many cores as torch may.
    """
    first, *rest = launches
    others = [_pool(len(rest)).submit(launch.launch) for launch in rest]
    first.launch()
    wait(others)
    for other in others:
        other.result()
