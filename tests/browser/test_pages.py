"""Pages of ``close-loop``, ``demo``, ``render-gallery``, ``robot check`` and ``log plot`` in a browser."""

from collections.abc import Callable
from io import BytesIO
from pathlib import Path
from typing import TYPE_CHECKING

import pytest
from PIL import Image

from aerial_gym.cli.main import main
from tests.browser.conftest import DESKTOP, TELEPHONE, PageRecord
from tests.unit.sim2real.flat_flights import flight, write

if TYPE_CHECKING:
    from playwright.sync_api import Locator

pytestmark = pytest.mark.slow

PAGES = ("close-loop", "demo", "render-gallery", "robot check", "log plot")
LEAST_CONTRAST = 4.5  # Web Content Accessibility Guidelines 2.2, criterion 1.4.3

OpenPage = Callable[..., PageRecord]

CONTRASTS = """() => {
  const channels = text => text.match(/[\\d.]+/g).map(Number);
  const luminance = ([r, g, b]) => [r, g, b].map(c => c / 255)
    .map(c => c <= 0.04045 ? c / 12.92 : ((c + 0.055) / 1.055) ** 2.4)
    .reduce((sum, c, n) => sum + c * [0.2126, 0.7152, 0.0722][n], 0);
  const background = element => {
    for (; element; element = element.parentElement) {
      const colour = channels(getComputedStyle(element).backgroundColor);
      if (colour.length === 3 || colour[3] === 1) return luminance(colour);
    }
    return 1;
  };
  const hasText = element => [...element.childNodes].some(node => node.nodeType === 3 && node.data.trim());
  return [...document.querySelectorAll("main *")].filter(e => hasText(e) && e.checkVisibility()).map(element => {
    const style = getComputedStyle(element), drawn = element instanceof SVGElement;
    const pair = [luminance(channels(drawn ? style.fill : style.color)), background(element)];
    return [(Math.max(...pair) + 0.05) / (Math.min(...pair) + 0.05), element.outerHTML.slice(0, 80)];
  });
}"""

TRACE = """plot => ({
  view: plot.querySelector("svg").getAttribute("viewBox").split(" ").map(Number),
  times: [...plot.querySelectorAll("i.x")].map(label => +label.textContent),
  heights: [...plot.querySelectorAll("i.y")].map(label => +label.textContent),
})"""


@pytest.fixture(scope="module")
def pages(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    """Return the pages of all commands. The demo's policy trains for two seconds only."""
    folder = tmp_path_factory.mktemp("pages")
    demo, gallery, check, plot = folder / "demo", folder / "gallery", folder / "check.html", folder / "log.html"
    assert main(["demo", "--out", str(demo), "--train-time-s", "2"]) == 0
    sensors = ["st_vl53l5cx", "base_normal_face_id_camera", "base_lidar"]
    command = ["render-gallery", "--out", str(gallery), "--environments", "env_with_obstacles", "--sensors", *sensors]
    assert main(command) == 0
    log = write(flight(1, seconds=8.0), folder / "log.csv")
    assert main(["log", "plot", str(log), "--out", str(plot)]) == 0
    assert main(["robot", "check", "tilted_hexarotor", "x500", "--no-fly", "--page", str(check)]) == 0
    return {
        "close-loop": demo / "loop" / "report.html", "demo": demo / "index.html",
        "render-gallery": gallery / "index.html", "robot check": check, "log plot": plot,
    }  # fmt: skip


@pytest.mark.parametrize("scheme", ["light", "dark"])
@pytest.mark.parametrize("name", PAGES)
def test_a_page_is_legible_on_a_telephone(name: str, scheme: str, pages: dict[str, Path], open_page: OpenPage) -> None:
    """One request, no errors, no wider than the screen; every text has contrast, and every image and plot a label."""
    address = pages[name].as_uri()
    record = open_page(address, size=TELEPHONE, color_scheme=scheme)
    assert [one for one in record.requests if not one.startswith("data:")] == [address]
    record.check()
    assert record.page.evaluate("document.documentElement.scrollWidth") == TELEPHONE[0]
    contrasts = record.page.evaluate(CONTRASTS)
    assert len(contrasts) > 10
    assert min(contrasts) >= [LEAST_CONTRAST]
    assert record.page.locator("img:not([alt]), img[alt='']").count() == 0
    drawings, labelled = (record.page.locator(part).count() for part in ("svg", "[role=img][aria-label] > svg"))
    assert drawings == labelled


@pytest.mark.parametrize("name", PAGES)
def test_dark_and_light_pages_differ(name: str, pages: dict[str, Path], open_page: OpenPage) -> None:
    """The corner of a screenshot, which is background, is dark or light."""
    for scheme, is_right in (("light", lambda level: level > 230), ("dark", lambda level: level < 40)):
        picture = open_page(pages[name].as_uri(), color_scheme=scheme).page.screenshot()
        assert is_right(max(Image.open(BytesIO(picture)).convert("RGB").getpixel((0, 0))))


def test_a_dark_page_prints_on_white_without_controls(pages: dict[str, Path], open_page: OpenPage) -> None:
    page = open_page(pages["close-loop"].as_uri(), color_scheme="dark").page
    button, color = page.locator("button.zoom").first, "getComputedStyle(document.body).backgroundColor"
    assert button.is_visible()
    page.emulate_media(media="print", color_scheme="dark")
    assert page.evaluate(color) == "rgb(255, 255, 255)"
    assert button.is_hidden()


@pytest.fixture
def trace(pages: dict[str, Path], open_page: OpenPage) -> "Locator":
    """Return the residual over time of the first channel, on the page of ``close-loop``."""
    plot = open_page(pages["close-loop"].as_uri(), size=DESKTOP).page.locator(".plot[data-x]:has(i.x)").nth(1)
    plot.scroll_into_view_if_needed()
    return plot


def drag(plot: "Locator", start: float, end: float) -> None:
    """Drag the mouse over a plot between two shares of its width."""
    box, mouse = plot.bounding_box(), plot.page.mouse
    mouse.move(box["x"] + start * box["width"], box["y"] + 20)
    mouse.down()
    mouse.move(box["x"] + end * box["width"], box["y"] + 30, steps=4)
    mouse.up()


def test_a_drag_shows_a_range_and_a_double_click_the_whole(trace: "Locator") -> None:
    """From 25 to 75 % of the width half of the time axis remains, in all plots that share it; its numbers lie within."""
    low, high = map(float, trace.get_attribute("data-x").split())
    before = trace.evaluate(TRACE)
    drag(trace, 0.25, 0.75)
    after = trace.evaluate(TRACE)
    assert after["view"][2] == pytest.approx(0.5 * before["view"][2], rel=0.01)
    quarter = 0.25 * (high - low)
    assert all(low + 0.98 * quarter <= time <= high - 0.98 * quarter for time in after["times"])
    assert len(after["times"]) >= 3
    figure = trace.locator("xpath=ancestor::figure")
    shared = figure.locator(f".plot[data-x='{trace.get_attribute('data-x')}']")
    assert {plot["view"][2] for plot in shared.evaluate_all(f"plots => plots.map({TRACE})")} == {after["view"][2]}
    trace.dblclick()
    assert trace.evaluate(TRACE) == before


def test_heights_fit_to_the_shown_range(trace: "Locator") -> None:
    """The marks between the shown ends fill the height but for a margin of 5 % on either side."""
    drag(trace, 0.4, 0.5)
    left, top, wide, high = trace.evaluate(TRACE)["view"]
    points = trace.evaluate("""plot => [...plot.querySelectorAll("path[style]")].flatMap(path => {
      const points = [];
      for (const [, x, y, steps] of path.getAttribute("d").matchAll(/M(\\d+) (\\d+)l([-\\d ]+)/g)) {
        const numbers = steps.match(/-?\\d+/g).map(Number);
        let [a, b] = [+x, +y];
        points.push([a, b]);
        for (let n = 0; n < numbers.length; n += 2) points.push([a += numbers[n], b += numbers[n + 1]]);
      }
      return points;
    })""")
    heights = [y for x, y in points if left <= x <= left + wide]
    assert (min(heights) - top) / high == pytest.approx(0.05 / 1.1, abs=0.01)
    assert (top + high - max(heights)) / high == pytest.approx(0.05 / 1.1, abs=0.01)


def test_wheel_and_keys_zoom_a_plot_with_focus(trace: "Locator") -> None:
    """The wheel scrolls the page until the plot has been clicked; + halves the range, an arrow moves it, 0 resets."""
    page, before = trace.page, trace.evaluate(TRACE)
    trace.hover()
    page.mouse.wheel(0, -120)
    assert trace.evaluate(TRACE) == before
    page.wait_for_timeout(200)
    trace.click()
    page.mouse.wheel(0, -120)
    page.wait_for_timeout(200)
    assert trace.evaluate(TRACE)["view"][2] < 0.9 * before["view"][2]
    page.keyboard.press("0")
    page.keyboard.press("+")
    left, _, wide, _ = trace.evaluate(TRACE)["view"]
    assert wide == pytest.approx(0.5 * before["view"][2])
    page.keyboard.press("ArrowRight")
    assert trace.evaluate(TRACE)["view"][0] == pytest.approx(left + 0.2 * wide)
    assert trace.evaluate("plot => getComputedStyle(plot).outlineStyle") == "solid"
    page.get_by_role("button", name="show the whole range").click()
    assert trace.evaluate(TRACE) == before


def test_two_fingers_zoom_and_one_moves(pages: dict[str, Path], open_page: OpenPage) -> None:
    """Fingers at 40 and 60 % that part to 20 and 80 % show a third of the range; then one moves it by its own way."""
    page = open_page(pages["close-loop"].as_uri(), size=TELEPHONE).page
    plot = page.locator(".plot[data-x]").first
    plot.scroll_into_view_if_needed()
    box, touch, whole = plot.bounding_box(), page.context.new_cdp_session(page), plot.evaluate(TRACE)["view"][2]

    def send(kind: str, *shares: float) -> None:
        at = [{"x": box["x"] + s * box["width"], "y": box["y"] + 40, "id": n} for n, s in enumerate(shares)]
        touch.send("Input.dispatchTouchEvent", {"type": kind, "touchPoints": at})

    for kind, *shares in (("touchStart", 0.4, 0.6), ("touchMove", 0.2, 0.8), ("touchEnd",)):
        send(kind, *shares)
    left, _, wide, _ = plot.evaluate(TRACE)["view"]
    assert wide == pytest.approx(whole / 3.0, rel=0.02)
    for kind, *shares in (("touchStart", 0.8), ("touchMove", 0.7), ("touchMove", 0.6), ("touchEnd",)):
        send(kind, *shares)
    assert plot.evaluate(TRACE)["view"][0] == pytest.approx(left + 0.2 * wide, rel=0.05)
