"""The loop of a live flight: steps at the speed that the page asks for, and scene updates."""

import threading
import time
from typing import TYPE_CHECKING

from aerial_gym.viewer.panel import ControlPanel
from aerial_gym.viewer.scene import SceneView
from aerial_gym.viewer.simulation import FlightInView

if TYPE_CHECKING:
    from viser import ViserServer

UPDATES_PER_S = 30.0
LONGEST_S = 0.1  # Longest time made up for after a pause of the loop [s], so that a slow step does not pile up


class LiveView:
    """A flight on a page."""

    def __init__(self, server: "ViserServer", flight: FlightInView) -> None:
        """Add scene and controls; the flight begins with ``run``."""
        self._server, self._flight = server, flight
        self.scene = SceneView(server, flight.content)
        self.panel = ControlPanel(server, flight, self.scene)
        self.ends = threading.Event()
        """Ends ``run`` from another thread."""
        self.num_updates = 0
        """Scene updates since the start."""
        first = flight.snapshot()
        self.scene.aim(first)
        self.scene.update(first)
        self._behind = 0.0

    def run(self, duration_s: float | None = None) -> None:
        """Fly until an interrupt or ``ends``, or for a time [s]."""
        start = last = time.perf_counter()
        while not self.ends.is_set() and (duration_s is None or last - start < duration_s):
            due = last + 1.0 / UPDATES_PER_S
            self.advance(min(due - last, LONGEST_S))
            time.sleep(max(0.0, due - time.perf_counter()))
            now = time.perf_counter()
            last = due if now - due < LONGEST_S else now

    def advance(self, span: float) -> None:
        """Make the requests of the page, step for a time ``span`` [s], and update the scene."""
        panel, flight, dt = self.panel, self._flight, self._flight.env.dt
        asked = bool(panel.requests)
        while panel.requests:
            panel.requests.popleft()()
        self._behind += 0.0 if panel.paused else span * panel.speed
        steps = panel.single_steps if panel.paused else int(self._behind / dt)
        panel.single_steps, self._behind = 0, 0.0 if panel.paused else self._behind - steps * dt
        for _ in range(steps):
            flight.step()
        snapshot = flight.snapshot(forces=panel.shows_forces)
        with self._server.atomic():
            self.scene.update(snapshot)
            speed = float((snapshot.velocity**2).sum() ** 0.5)
            panel.show_state(f"{snapshot.time:.1f} s, {snapshot.position[snapshot.chosen][2]:.1f} m, {speed:.1f} m/s")
        self.num_updates += bool(steps or asked)
