"""A server for the pages of the tests."""

from collections.abc import Iterator
from typing import TYPE_CHECKING

import pytest

if TYPE_CHECKING:
    from viser import ViserServer


@pytest.fixture(scope="module")
def server() -> "Iterator[ViserServer]":
    """Return a server on a free port; without viser the tests skip."""
    pytest.importorskip("viser", reason="viser is not installed")
    from aerial_gym.viewer.server import close_server, open_server

    started = open_server(port=0)
    yield started
    close_server(started)
