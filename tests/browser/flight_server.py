"""A live flight on a page, which a thread advances while a browser uses it."""

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from tempfile import TemporaryDirectory
from threading import Event, Thread

import numpy as np
from viser import ViserServer

from aerial_gym.cli.view import ViewCmd
from aerial_gym.viewer.live import LiveView
from aerial_gym.viewer.server import close_server, open_server
from aerial_gym.viewer.simulation import FlightInView


@dataclass
class FlightServer:
    """A flight in progress, and its server."""

    server: ViserServer
    flight: FlightInView
    view: LiveView

    @property
    def address(self) -> str:
        """Return the address of the page."""
        return f"http://127.0.0.1:{self.server.get_port()}"

    @property
    def position(self) -> np.ndarray:
        """Return the position of the first vehicle [m], world, (3,)."""
        return self.flight.env.gtd["robot_position"][0].numpy().copy()


@contextmanager
def serve_flight(command: ViewCmd) -> Iterator[FlightServer]:
    """Yield the flight of a command ``aerial-gym view`` on a free port."""
    server, ends = open_server(port=0), Event()
    with TemporaryDirectory() as folder:
        flight = command._build_flight(folder)
    view = LiveView(server, flight)

    def fly() -> None:
        while not ends.is_set():
            view.run(0.2)

    thread = Thread(target=fly)
    thread.start()
    try:
        yield FlightServer(server, flight, view)
    finally:
        ends.set()
        thread.join()
        close_server(server)
