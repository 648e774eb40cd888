"""``make view-pictures``: pictures of the viewer for the documentation, from a headless browser."""

import shutil
from io import BytesIO
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
from PIL import Image
from playwright.sync_api import Browser, Page, sync_playwright
from viser import ViserServer

from aerial_gym.cli.view import ViewCmd
from aerial_gym.viewer.flight_record import load_logs
from aerial_gym.viewer.recording import RecordingPage
from aerial_gym.viewer.server import close_server, open_server, page_url
from tests.browser.conftest import ARGUMENTS
from tests.browser.flight_server import serve_flight
from tests.unit.sim2real.flat_flights import ROBOT, flight, write
from tests.unit.viewer.test_flight_record import DRAG, DRAGGED

IMAGES = Path(__file__).parents[2] / "docs" / "images"
SIZE = (1000, 600)  # Width and height [pixels]
QUALITY = 85  # Of the compression, 0 to 100
DRAW = "() => new Promise(end => { let n = 0; const next = () => ++n > 10 ? end() : requestAnimationFrame(next); next(); })"
"""Waits for ten frames: a browser without a GPU draws one in a second."""

FLIGHTS = {
    "view_controller": ViewCmd(),
    "view_sensors": ViewCmd(env="env_with_obstacles", robot="base_quadrotor_with_camera"),
}
ROBOTS = {"declared": ROBOT, "corrected": DRAGGED}
INSTANT_S = 12.9  # Instant of the picture of a recording, at the end of a prediction [s]
GOAL = np.array([0.8, 0.5, 0.4])  # Move of the goal before the picture [m]


def picture_flight(browser: Browser, command: ViewCmd, file: Path) -> None:
    """Write a picture of the page of a flight towards a goal."""
    with serve_flight(command) as live:
        page, start = open_view(browser, live.server), live.position
        live.view.panel.requests.append(lambda: live.flight.move_goal(tuple(start + GOAL)))
        while np.linalg.norm(live.position - start) < 0.6 * np.linalg.norm(GOAL):
            page.wait_for_timeout(20)
        live.view.panel.paused = True
        save_picture(page, file)


def picture_recording(browser: Browser, file: Path) -> None:
    """Write a picture of the page of a log, in which the declared vehicle has no drag."""
    server = open_server(port=0)
    with TemporaryDirectory() as folder:
        log = write(flight(3, drag=DRAG, seconds=30.0, rate=100.0), Path(folder) / "flight.csv")
        flights, notes = load_logs([log], ROBOTS)
    recording = RecordingPage(server, flights, ROBOTS, notes=notes, restart_s=1.0)
    recording.playing, recording.time = False, INSTANT_S
    recording.advance(1.0)
    save_picture(open_view(browser, server), file)
    close_server(server)


def open_view(browser: Browser, server: ViserServer) -> Page:
    """Return the page of a server without the warning about a browser without a GPU."""
    page = browser.new_page(viewport={"width": SIZE[0], "height": SIZE[1]})
    page.goto(page_url(server))
    page.get_by_text("Connected").wait_for()
    page.get_by_role("alert").get_by_role("button").click()
    page.evaluate(DRAW)
    return page


def save_picture(page: Page, file: Path) -> None:
    """Write what a page shows once it is drawn, and close it."""
    page.evaluate(DRAW)
    Image.open(BytesIO(page.screenshot())).convert("RGB").save(file, quality=QUALITY)
    print(f"{file}: {file.stat().st_size / 1e3:.0f} kB")
    page.close()


def main() -> None:
    """Write all pictures."""
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=shutil.which("chromium"), args=list(ARGUMENTS))
        for name, command in FLIGHTS.items():
            picture_flight(browser, command, IMAGES / f"{name}.webp")
        picture_recording(browser, IMAGES / "view_recording.webp")


if __name__ == "__main__":
    main()
