"""The page of ``aerial-gym view`` in a browser: it draws, flies after its goal, and survives a lost connection."""

from collections.abc import Callable, Iterator
from io import BytesIO

import numpy as np
import pytest
from PIL import Image

pytest.importorskip("viser", reason="viser is not installed")

from viser import CameraHandle
from viser.transforms import SO3

from aerial_gym.cli.view import ViewCmd
from tests.browser.conftest import PageRecord
from tests.browser.flight_server import FlightServer, serve_flight

pytestmark = pytest.mark.slow

OpenPage = Callable[..., PageRecord]
BLOCKED_CODE = "'unsafe-eval' is not an allowed source"
"""Error of viser's sorter of Gaussian splats, which makes functions from text; the page's rules refuse that, and no view
has splats."""
LIFT_M = 0.5  # Length of the drag of the goal [m]


@pytest.fixture(scope="module")
def live() -> Iterator[FlightServer]:
    """Return the default flight: a controller holds a quadrotor at a goal in an empty environment."""
    with serve_flight(ViewCmd()) as flight:
        yield flight


def open_view(live: FlightServer, open_page: OpenPage) -> PageRecord:
    """Return the page once its camera is known."""
    record = open_page(live.address)
    record.page.get_by_text("Connected").wait_for()
    wait(record, lambda: any(client.camera.fov > 0.0 for client in live.server.get_clients().values()))
    record.page.wait_for_timeout(1000)
    return record


def wait(record: PageRecord, condition: Callable[[], bool], time_ms: int = 15_000) -> None:
    """Let the browser work until a condition holds."""
    for _ in range(time_ms // 50):
        if condition():
            return
        record.page.wait_for_timeout(50)
    raise AssertionError("the condition did not become true in time")


def check(record: PageRecord) -> None:
    """Assert that the page had no error but the blocked one, and asked no other machine."""
    record.page_errors = [error for error in record.page_errors if BLOCKED_CODE not in error]
    record.check()


def canvas_colors(record: PageRecord) -> np.ndarray:
    """Return the pixels of the scene, (pixels, 3)."""
    picture = record.page.locator("canvas").first.screenshot()
    return np.asarray(Image.open(BytesIO(picture)).convert("RGB")).reshape(-1, 3)


def project(record: PageRecord, camera: CameraHandle, point: np.ndarray) -> tuple[float, float]:
    """Return the place of a point of the world on the page [CSS pixels]."""
    x, y, z = SO3(np.asarray(camera.wxyz)).inverse().apply(point - np.asarray(camera.position))
    box = record.page.locator("canvas").first.bounding_box()
    focal = 0.5 * box["height"] / np.tan(0.5 * camera.fov)
    return box["x"] + 0.5 * box["width"] + focal * x / z, box["y"] + 0.5 * box["height"] + focal * y / z


def test_the_page_draws_the_scene_and_asks_no_other_machine(live: FlightServer, open_page: OpenPage) -> None:
    record = open_view(live, open_page)
    colors = canvas_colors(record)
    kinds, counts = np.unique(colors // 16, axis=0, return_counts=True)
    assert len(kinds) > 30
    assert counts.max() < 0.9 * len(colors)
    assert any(address.startswith("ws://127.0.0.1:") for address in record.requests)
    check(record)


def test_the_vehicle_follows_a_goal_that_the_mouse_drags(live: FlightServer, open_page: OpenPage) -> None:
    """A drag of the goal's upper arrow lifts the goal by the same length, within the throttle of events, and the vehicle."""
    record = open_view(live, open_page)
    (client,), mouse = live.server.get_clients().values(), record.page.mouse
    before, goal, up = live.position, np.asarray(live.view.scene.goal.position), np.array([0.0, 0.0, 1.0])
    arrow = goal + 1.5 * live.view.scene.vehicle.size * up
    mouse.move(*project(record, client.camera, arrow))
    record.page.wait_for_timeout(300)
    mouse.down()
    mouse.move(*project(record, client.camera, arrow + LIFT_M * up), steps=10)
    mouse.up()
    wait(record, lambda: abs(live.view.scene.goal.position[2] - goal[2] - LIFT_M) < 0.2 * LIFT_M)
    wait(record, lambda: np.abs(live.position - live.view.scene.goal.position).max() < 0.02)
    assert live.position - before == pytest.approx(LIFT_M * up, abs=0.2 * LIFT_M)
    check(record)


def test_a_page_that_loses_its_connection_returns_with_its_controls(live: FlightServer, open_page: OpenPage) -> None:
    """A paused flight is paused on the page that has connected again, and goes on by the same box."""
    record = open_view(live, open_page)
    box = record.page.get_by_label("pause")
    box.check()
    wait(record, lambda: live.view.panel.paused)
    before = set(live.server.get_clients())
    live.server._websock_server.disconnect_all_clients()
    wait(record, lambda: bool(set(live.server.get_clients()) - before))
    record.page.get_by_text("Connected").wait_for()
    assert box.is_checked()
    assert len(np.unique(canvas_colors(record) // 16, axis=0)) > 30
    box.uncheck()
    wait(record, lambda: not live.view.panel.paused)
    check(record)
