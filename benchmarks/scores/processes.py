"""Cases side by side in processes of one core each."""

import os
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import ProcessPoolExecutor, as_completed
from multiprocessing import get_context
from typing import TypeVar

Item = TypeVar("Item")
Result = TypeVar("Result")

THREADS = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")


def run_in_processes(
    call: Callable[[Item], Result], items: Iterable[Item], processes: int, *, cases_of_each: int | None = None
) -> Iterator[tuple[Item, Result]]:
    """Yield each item with its result as they come; a process ends after ``cases_of_each`` cases, if given."""
    os.environ.update(dict.fromkeys(THREADS, "1"))  # before the processes start
    context = get_context("spawn")
    with ProcessPoolExecutor(processes, mp_context=context, max_tasks_per_child=cases_of_each) as pool:
        try:
            futures = {pool.submit(call, item): item for item in items}
            for future in as_completed(futures):
                yield futures[future], future.result()
        except BaseException:
            pool.shutdown(wait=False, cancel_futures=True)
            raise
