"""A server of the pages of an invented fleet."""

import json
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from http.client import HTTPConnection, HTTPResponse
from pathlib import Path
from threading import Thread
from typing import Any

import pytest

from aerial_gym.fleet.page.server import PageServer
from tests.unit.fleet.page.fleet_tables import HOSTILE, write_fleet

VEHICLES = ["alpha", "bravo", f"x{HOSTILE}", "../up", *(f"v{n}" for n in range(60))]
FLIGHTS = 12


class Client:
    """Requests to a server."""

    def __init__(self, server: PageServer) -> None:
        self.server = server

    def request(self, path: str, method: str = "GET", **headers: str) -> HTTPResponse:
        connection = HTTPConnection("127.0.0.1", self.server.server_port, timeout=60)
        connection.request(method, path, headers=headers)
        return connection.getresponse()

    def page(self, path: str) -> str:
        response = self.request(path)
        body = response.read().decode()
        assert response.status == 200, body
        return body

    def json(self, path: str) -> Any:
        return json.loads(self.page(f"/api/{path}"))


@contextmanager
def serve_tables(out: Path) -> Iterator[Client]:
    """Yield a client of a server of a folder of tables."""
    with PageServer(out, 0) as server:
        thread = Thread(target=server.serve_forever)
        thread.start()
        try:
            yield Client(server)
        finally:
            server.shutdown()
            thread.join()


@pytest.fixture(scope="session")
def fleet(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the tables of 64 vehicles with 12 flights each, and three refused logs."""
    return write_fleet(tmp_path_factory.mktemp("fleet"), VEHICLES, FLIGHTS)


@pytest.fixture(scope="session")
def client(fleet: Path) -> Iterator[Client]:
    """Return a client of a server of these tables."""
    with serve_tables(fleet) as one:
        yield one


@pytest.fixture
def open_tables() -> Iterator[Callable[[Path], Client]]:
    """Return a function that serves a folder of tables until the test ends."""
    with ExitStack() as servers:
        yield lambda out: servers.enter_context(serve_tables(out))
