"""The page of ``aerial-gym view --log`` in a browser: three vehicles, plots, and a slider that moves the time."""

from collections.abc import Iterator
from threading import Event, Thread
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

pytest.importorskip("viser", reason="viser is not installed")

from aerial_gym.viewer.flight_record import load_logs
from aerial_gym.viewer.recording import RecordingPage
from aerial_gym.viewer.recording_scene import COLORS
from aerial_gym.viewer.server import close_server, open_server
from tests.browser.test_view import OpenPage, canvas_colors, check, open_view, wait
from tests.unit.sim2real.flat_flights import ROBOT, flight, write
from tests.unit.viewer.test_flight_record import DRAG, DRAGGED

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def recording(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Any]:
    """Return a paused page of a vehicle with drag, 1.9 s after the restart of its predictions."""
    robots = {"declared": ROBOT, "corrected": DRAGGED}
    flights, _ = load_logs([write(flight(3, drag=DRAG), tmp_path_factory.mktemp("log") / "log.csv")], robots)
    server, ends = open_server(port=0), Event()
    page = RecordingPage(server, flights, robots, restart_s=2.0)
    page.playing = False
    start = page.record.tracks["declared"].start
    page.time = float(page.record.time[start.max() - 10])

    def play() -> None:
        while not ends.wait(0.03):
            page.advance(0.03)

    thread = Thread(target=play)
    thread.start()
    yield SimpleNamespace(server=server, page=page, address=f"http://127.0.0.1:{server.get_port()}")
    ends.set()
    thread.join()
    close_server(server)


def test_the_page_draws_three_colours_and_plots_and_its_slider_moves_the_time(
    recording: Any, open_page: OpenPage
) -> None:
    record = open_view(recording, open_page)
    colors = canvas_colors(record).astype(float)
    chroma = colors - colors.mean(axis=1, keepdims=True)
    assert ((np.linalg.norm(chroma, axis=1) < 40.0) & (colors.mean(axis=1) < 130.0)).sum() > 50, "measured"
    for name in ("declared", "corrected"):
        own = np.array(COLORS[name]) - np.mean(COLORS[name])
        near = chroma @ own > 0.97 * np.linalg.norm(chroma, axis=1) * np.linalg.norm(own)
        assert (near & (np.linalg.norm(chroma, axis=1) > 20.0)).sum() > 50, name
    assert record.page.locator(".uplot").count() == 3
    before = recording.page.time
    slider = record.page.get_by_role("slider").first
    slider.focus()
    for _ in range(20):
        slider.press("ArrowLeft")
    wait(record, lambda: recording.page.time == pytest.approx(before - 0.2, abs=0.02))
    check(record)
