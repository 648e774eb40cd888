"""Engines that run workers over batches: in this process, or on the cores of this machine or of a cluster by Ray Data.

Results come in the order of the batches, so tables fill in the order of the logs.
"""

import logging
import os
import pickle
import secrets
import subprocess
import sys
import traceback
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager
from itertools import islice
from typing import Any, TypeVar

from aerial_gym.errors import ConfigError

T = TypeVar("T")
R = TypeVar("R")

BATCHES_AT_ONCE = 512  # Batches that Ray Data knows at a time, so that memory is flat whatever the number of logs
CONNECT_S = 60.0  # Longest time until a cluster answers
STORE_BYTES = 512 << 20  # Shared memory of Ray on this machine; batches of results take some megabytes


Engine = Callable[[Iterable[Any], Callable[[], Callable[[Any], Any]]], Iterator[Any]]
"""Function of batches and a function that makes workers: gives workers one batch at a time, and yields the results in order."""


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

        return {"result": np.array([self._result(pickle.loads(batch)) for batch in table["batch"]], dtype=object)}

    def _result(self, batch: Any) -> bytes:
        """Return the result of a batch, or the error, which Ray would wrap and print."""
        try:
            return pickle.dumps(self._worker(batch))
        except Exception as error:
            error.add_note(traceback.format_exc())
            return pickle.dumps(error)


def _local_settings() -> dict[str, str]:
    """Return the environment in which Ray listens on loopback alone, and to holders of a token that only this run knows."""
    closed = {"RAY_ENABLE_WINDOWS_OR_OSX_CLUSTER": "0"}  # Ray's own switch for a node without a cluster, on any system
    return closed | {"RAY_AUTH_MODE": "token", "RAY_AUTH_TOKEN": secrets.token_hex(32)}


def _check_cluster(address: str) -> None:
    """Raise ``ConfigError`` unless a process of its own connects to a cluster in time, as Ray tries on and on."""
    code = f"import ray; ray.init({address!r}, log_to_driver=False); ray.cluster_resources()['CPU']"
    try:
        subprocess.run([sys.executable, "-c", code], capture_output=True, timeout=CONNECT_S, check=True)
    except subprocess.SubprocessError:
        message = f"no Ray cluster with processors answers within {CONNECT_S:g} s. Start one with: ray start --head"
        raise ConfigError(f"--address {address}: {message}") from None


@contextmanager
def _native_output_off() -> Iterator[None]:
    """Discard what native code writes to stderr, such as the log level that Ray reads."""
    own = os.dup(2)
    with open(os.devnull, "wb") as nowhere:
        os.dup2(nowhere.fileno(), 2)
    try:
        yield
    finally:
        os.dup2(own, 2)
        os.close(own)


@contextmanager
def ray_engine(workers: int | None = None, address: str | None = None) -> Iterator[Engine]:
    """Yield an engine of Ray: actors that restart when they die, on the cores of this machine or of the cluster ``address``."""
    os.environ |= {"RAY_USAGE_STATS_ENABLED": "0", "RAY_BACKEND_LOG_LEVEL": "fatal"}
    if address:
        _check_cluster(address)
    else:
        os.environ |= _local_settings()
    import ray
    from ray.data import ActorPoolStrategy, DataContext

    own = {"num_cpus": workers, "include_dashboard": False, "object_store_memory": STORE_BYTES}
    with _native_output_off():
        ray.init(address or "local", log_to_driver=False, logging_level=logging.CRITICAL, **({} if address else own))
    context = DataContext.get_current()
    context.execution_options.preserve_order = True
    context.enable_progress_bars = context.print_on_execution_start = False
    logging.getLogger("ray.data").setLevel(logging.CRITICAL)  # errors are raised
    count = workers or int(ray.cluster_resources()["CPU"])

    def run(batches: Iterable[Any], make_worker: Callable[[], Callable[[Any], Any]]) -> Iterator[Any]:
        rest = iter(batches)
        while some := [{"batch": pickle.dumps(batch)} for batch in islice(rest, BATCHES_AT_ONCE)]:
            results = ray.data.from_items(some, override_num_blocks=len(some)).map_batches(
                _RayWorker, fn_constructor_args=(make_worker,), batch_size=1, batch_format="numpy", num_cpus=1,
                compute=ActorPoolStrategy(size=min(count, len(some))),
            )  # fmt: skip
            for row in results.iter_rows():
                if isinstance(result := pickle.loads(row["result"]), Exception):
                    raise result
                yield result

    try:
        yield run
    finally:
        ray.shutdown()
