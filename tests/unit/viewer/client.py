"""A client of the page's websocket, without a browser.

A message is: sizes of the packed part, plain and compressed (u64 each), the packed part (zstd, msgpack), binary arrays.
"""

import time
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import msgspec
import viser
import zstandard
from websockets.sync.client import connect
from websockets.sync.connection import Connection

ANSWER_S = 20.0  # Longest wait for a message [s]


@contextmanager
def page_client(port: int) -> Iterator[Connection]:
    """Yield a connection as a page of this version opens it."""
    protocol: Any = f"viser-v{viser.__version__}"
    with connect(f"ws://127.0.0.1:{port}", subprotocols=[protocol], max_size=None) as line:
        yield line


def receive(line: Connection) -> list[dict[str, Any]]:
    """Return the messages of the next window."""
    data = line.recv(ANSWER_S)
    assert isinstance(data, bytes)
    packed = zstandard.ZstdDecompressor().decompress(data[16 : 16 + int.from_bytes(data[8:16], "little")])
    return msgspec.msgpack.decode(packed)["messages"]


def names_of_updates(line: Connection, wanted: str) -> list[str]:
    """Return the names of the nodes of all messages until one of them is of the node ``wanted``."""
    names: list[str] = []
    while wanted not in names:
        names += [message["name"] for message in receive(line) if "name" in message]
    return names


def count_updates(port: int, node: str, duration_s: float) -> tuple[int, float]:
    """Return the number of updates of a node's poses that arrive, and their time [s], at least ``duration_s``."""
    with page_client(port) as line:
        names_of_updates(line, node)
        count, start = 0, time.perf_counter()
        while time.perf_counter() - start < duration_s:
            count += sum(
                message.get("name") == node and "batched_positions" in message.get("updates", {})
                for message in receive(line)
            )
        return count, time.perf_counter() - start
