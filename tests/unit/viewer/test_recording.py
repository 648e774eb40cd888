"""The page of a recorded flight answers its controls."""

from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest

pytest.importorskip("viser", reason="viser is not installed")

from aerial_gym.viewer.flight_record import load_logs
from aerial_gym.viewer.recording import RecordingPage, legend
from tests.unit.sim2real.flat_flights import ROBOT, flight, write
from tests.unit.viewer.test_flight_record import DRAG, DRAGGED

if TYPE_CHECKING:
    from viser import ViserServer

ROBOTS = {"declared": ROBOT, "corrected": DRAGGED}


@pytest.fixture(scope="module")
def page(server: "ViserServer", tmp_path_factory: pytest.TempPathFactory) -> RecordingPage:
    folder = tmp_path_factory.mktemp("logs")
    paths = [write(flight(seed, drag=DRAG), folder / f"f{seed}.csv") for seed in (3, 5)]
    flights, notes = load_logs(paths, ROBOTS)
    return RecordingPage(server, flights, ROBOTS, notes=notes)


def control(page: RecordingPage, label: str) -> Any:
    handles = page._server.gui._gui_input_handle_from_uuid.values()
    (handle,) = (one for one in handles if getattr(one, "label", None) == label)
    return handle


def vehicle_position(page: RecordingPage, name: str) -> np.ndarray:
    node: Any = page._server.scene.get_handle_by_name(f"/flight/{name}")
    return node.position


def test_playback_moves_the_vehicles_along_log_and_predictions(page: RecordingPage) -> None:
    page.time = 2.0
    control(page, "speed").value = "0.5 x"
    page.advance(1.0)
    assert page.time == pytest.approx(2.5)
    assert control(page, "time [s]").value == pytest.approx(2.5)
    row = page.record.row_of_time(2.5)
    np.testing.assert_allclose(vehicle_position(page, "measured"), page.record.position[row], rtol=1e-6)
    for name, track in page.record.tracks.items():
        np.testing.assert_allclose(vehicle_position(page, name), track.position[row], rtol=1e-6)
    root = page._server.scene.get_handle_by_name("/flight")
    assert root is not None
    np.testing.assert_allclose(root.position, -page.record.position[row], rtol=1e-6)


def test_slider_pause_and_end(page: RecordingPage) -> None:
    page._count_press(None)
    control(page, "time [s]").value = 7.25
    page.advance(1.0)
    assert (page.playing, page.time, control(page, "play").label) == (False, 7.25, "play")
    page._count_press(None)
    page.advance(1e3)
    assert (page.playing, page.time) == (False, page.record.time[-1])
    page._count_press(None)
    page.advance(0.0)
    assert (page.playing, page.time) == (True, 0.0)


def test_the_user_sets_the_time_between_restarts(page: RecordingPage) -> None:
    restart = control(page, "restart every [s]")
    for seconds in (2.0, 0.5):
        restart.value = seconds
        page.advance(0.0)
        start = page.record.tracks["declared"].start
        assert np.diff(np.unique(start[start >= 0])).tolist() == pytest.approx(
            [100 * seconds] * (int(11.9 / seconds)), abs=1
        )


def test_each_quantity_and_span_has_plots(page: RecordingPage) -> None:
    quantity, span = control(page, "plot"), control(page, "time span")
    for name in quantity.options:
        quantity.value, span.value = name, "whole flight"
        page.advance(0.2)
        assert page._plots is not None
        assert len(page._plots._plots) == len(page.record.plots()[name])
        x, *lines = page._plots._plots[0].data
        assert (x[0], x[-1]) == pytest.approx((0.0, 12.0), abs=0.5)
        assert all(np.isfinite(line).any() for line in lines)


def test_another_flight_starts_at_its_beginning_and_events_are_reached(page: RecordingPage) -> None:
    page.playing = False
    control(page, "flight").value = "f5"
    page.advance(0.0)
    assert (page.record.log.name, page.time) == ("f5", 0.0)
    page._events = {"3.00 s: gap": 3.0}
    event = control(page, "jump to")
    event.options = ("-", *page._events)
    event.value = "3.00 s: gap"
    page.advance(0.0)
    assert (page.time, event.value) == (3.0, "-")


def test_without_following_the_vehicle_the_scene_stays(page: RecordingPage) -> None:
    root: Any = page._server.scene.get_handle_by_name("/flight")
    page.playing, page.time = False, 2.0
    page.advance(0.0)
    control(page, "follow the vehicle").value, page.time = False, 4.0
    page.advance(0.0)
    np.testing.assert_allclose(root.position, -page.record.position[page.record.row_of_time(2.0)], rtol=1e-6)


def test_texts_of_a_log_are_not_html(server: "ViserServer", tmp_path: Path) -> None:
    """Notes name the file, and a file name may hold markup."""
    path = write(flight(3), tmp_path / "<img src=x onerror=alert(1)>.csv")
    flights, _ = load_logs([path], {})
    page = RecordingPage(server, flights, {}, notes=[f"Left out: {path}"])
    assert "<img" not in page._remarks.content
    assert "&lt;img" in page._remarks.content
    assert "--robot" in legend(page.record, 0.5, has_robot=False)
