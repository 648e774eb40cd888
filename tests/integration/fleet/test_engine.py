"""The engine of Ray: results in order, errors as they are, silence on stderr, and clusters that do not answer."""

import socket
import subprocess
import sys
from collections.abc import Callable
from importlib.util import find_spec

import pytest

from aerial_gym.errors import ConfigError, StorageError
from aerial_gym.fleet import engine

pytestmark = [pytest.mark.slow, pytest.mark.skipif(find_spec("ray") is None, reason="ray is not installed")]


def make_worker() -> Callable[[int], int]:
    """Return a worker that doubles numbers, and fails at 3."""

    def work(batch: int) -> int:
        if batch == 3:
            raise StorageError("the disk is full")
        return 2 * batch

    return work


def test_ray_prints_nothing_and_raises_the_error_of_a_worker() -> None:
    """In a process of its own, as Ray reads its settings when it is imported."""
    code = """
from tests.integration.fleet.test_engine import StorageError, engine, make_worker
with engine.ray_engine(1) as run:
    print(list(run([1, 2], make_worker)))
    try:
        list(run([3], make_worker))
    except StorageError as error:
        print(error)
"""
    result = subprocess.run([sys.executable, "-c", code], check=True, capture_output=True, text=True)
    assert (result.stdout, result.stderr) == ("[2, 4]\nthe disk is full\n", "")


def test_cluster_that_does_not_answer_is_refused_in_time(monkeypatch: pytest.MonkeyPatch) -> None:
    """The port is open, and nothing answers there."""
    monkeypatch.setattr(engine, "CONNECT_S", 8.0)
    with socket.create_server(("127.0.0.1", 0)) as server:
        address = f"127.0.0.1:{server.getsockname()[1]}"
        with pytest.raises(ConfigError, match=f"{address}: no Ray cluster with processors answers within 8 s"):
            engine._check_cluster(address)
