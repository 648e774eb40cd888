"""``make view-pictures``: pictures of the viewer for the documentation, from a headless browser."""

import shutil
from io import BytesIO
from pathlib import Path

import numpy as np
from PIL import Image
from playwright.sync_api import Browser, sync_playwright

from aerial_gym.cli.view import ViewCmd
from tests.browser.conftest import ARGUMENTS
from tests.browser.flight_server import FlightServer, serve_flight

IMAGES = Path(__file__).parents[2] / "docs" / "images"
SIZE = (1000, 600)  # Width and height [pixels]
QUALITY = 85  # Of the compression, 0 to 100
DRAW = "() => new Promise(end => { let n = 0; const next = () => ++n > 10 ? end() : requestAnimationFrame(next); next(); })"
"""Waits for ten frames: a browser without a GPU draws one in a second."""

FLIGHTS = {
    "view_controller": ViewCmd(),
    "view_sensors": ViewCmd(env="env_with_obstacles", robot="base_quadrotor_with_camera"),
}
GOAL = np.array([0.8, 0.5, 0.4])  # Move of the goal before the picture [m]


def take_picture(browser: Browser, live: FlightServer, file: Path) -> None:
    """Write a picture of the page of a flight towards a goal."""
    page = browser.new_page(viewport={"width": SIZE[0], "height": SIZE[1]})
    page.goto(live.address)
    page.get_by_text("Connected").wait_for()
    page.get_by_role("alert").get_by_role("button").click()  # The warning about a browser without a GPU
    page.evaluate(DRAW)
    start = live.position
    live.view.panel.requests.append(lambda: live.flight.move_goal(tuple(start + GOAL)))
    while np.linalg.norm(live.position - start) < 0.6 * np.linalg.norm(GOAL):
        page.wait_for_timeout(20)
    live.view.panel.paused = True
    page.evaluate(DRAW)
    Image.open(BytesIO(page.screenshot())).convert("RGB").save(file, quality=QUALITY)
    print(f"{file}: {file.stat().st_size / 1e3:.0f} kB")
    page.close()


def main() -> None:
    """Write all pictures."""
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=shutil.which("chromium"), args=list(ARGUMENTS))
        for name, command in FLIGHTS.items():
            with serve_flight(command) as live:
                take_picture(browser, live, IMAGES / f"{name}.webp")


if __name__ == "__main__":
    main()
