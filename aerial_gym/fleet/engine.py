"""Engines that run workers over batches: in this process, or on the cores of this machine or of a cluster by Ray Data.

Results come in the order of the batches, so tables fill in the order of the logs.
"""

import logging
import os
import pickle
import secrets
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager
from itertools import islice
from typing import Any, Protocol, TypeVar

T = TypeVar("T")
R = TypeVar("R")

BATCHES_AT_ONCE = 512  # Batches that Ray Data knows at a time, so that memory is flat whatever the number of logs
STORE_BYTES = 512 << 20  # Shared memory of Ray on this machine; batches of results take some megabytes


class Engine(Protocol):
    """Function that makes workers, gives each one batch at a time, and yields the results in order."""

    def __call__(self, batches: Iterable[T], make_worker: Callable[[], Callable[[T], R]]) -> Iterator[R]:
        """Yield the result of each batch."""
        ...


def run_serially(batches: Iterable[T], make_worker: Callable[[], Callable[[T], R]]) -> Iterator[R]:
    """Run one worker in this process."""
    worker = make_worker()
    return map(worker, batches)


class _RayWorker:
    """Actor of Ray Data around a worker; batches and results are opaque to Ray."""

    def __init__(self, make_worker: Callable[[], Callable[[Any], Any]]) -> None:
        self._worker = make_worker()

    def __call__(self, table: Mapping[str, Any]) -> Mapping[str, Any]:
        import numpy as np

        results = [pickle.dumps(self._worker(pickle.loads(batch))) for batch in table["batch"]]
        return {"result": np.array(results, dtype=object)}


def _local_settings() -> dict[str, str]:
    """Return the environment in which Ray listens on loopback alone, and to holders of a token that only this run knows."""
    closed = {"RAY_ENABLE_WINDOWS_OR_OSX_CLUSTER": "0"}  # Ray's own switch for a node without a cluster, on any system
    quiet = {"RAY_BACKEND_LOG_LEVEL": "fatal"}
    return closed | quiet | {"RAY_AUTH_MODE": "token", "RAY_AUTH_TOKEN": secrets.token_hex(32)}


@contextmanager
def ray_engine(workers: int | None = None, address: str | None = None) -> Iterator[Engine]:
    """Yield an engine of Ray: actors that restart when they die, on the cores of this machine or of the cluster ``address``."""
    os.environ |= {"RAY_USAGE_STATS_ENABLED": "0"} | ({} if address else _local_settings())
    import ray
    from ray.data import ActorPoolStrategy, DataContext

    own = {"num_cpus": workers, "include_dashboard": False, "object_store_memory": STORE_BYTES}
    ray.init(address or "local", log_to_driver=False, logging_level=logging.ERROR, **({} if address else own))
    context = DataContext.get_current()
    context.execution_options.preserve_order = True
    context.enable_progress_bars = context.print_on_execution_start = False
    logging.getLogger("ray.data").setLevel(logging.ERROR)
    count = workers or int(ray.cluster_resources()["CPU"])

    def run(batches: Iterable[Any], make_worker: Callable[[], Callable[[Any], Any]]) -> Iterator[Any]:
        rest = iter(batches)
        while some := [{"batch": pickle.dumps(batch)} for batch in islice(rest, BATCHES_AT_ONCE)]:
            results = ray.data.from_items(some, override_num_blocks=len(some)).map_batches(
                _RayWorker, fn_constructor_args=(make_worker,), batch_size=1, batch_format="numpy", num_cpus=1,
                compute=ActorPoolStrategy(size=min(count, len(some))),
            )  # fmt: skip
            for row in results.iter_rows():
                yield pickle.loads(row["result"])

    try:
        yield run
    finally:
        ray.shutdown()
