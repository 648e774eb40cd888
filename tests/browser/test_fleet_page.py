"""The pages of ``aerial-gym fleet view`` in a browser: sort, filter, open a vehicle and a flight."""

from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

pytest.importorskip("deltalake", reason="deltalake is not installed")
pytest.importorskip("duckdb", reason="duckdb is not installed")

from tests.browser.conftest import PageRecord
from tests.browser.test_pages import CONTRASTS, LEAST_CONTRAST
from tests.unit.fleet.page.fleet_tables import HOSTILE, write_fleet
from tests.unit.fleet.page.servers import serve_tables

pytestmark = pytest.mark.slow

OpenPage = Callable[..., PageRecord]
NARROW = (360, 740)
REPORT = "<!doctype html><style>b { color: red }</style><p>Report<script>document.title = 'drawn'</script>"


@pytest.fixture(scope="module")
def address(tmp_path_factory: pytest.TempPathFactory) -> Iterator[str]:
    """Return the address of the pages of 120 vehicles, the first one with a report."""
    out: Path = tmp_path_factory.mktemp("fleet")
    write_fleet(out, [f"v{n:03d}" for n in range(119)] + [f"z{HOSTILE}"], 12)
    (out / "reports" / "v000").mkdir(parents=True)
    (out / "reports" / "v000" / "report.html").write_text(REPORT, encoding="utf-8")
    with serve_tables(out) as client:
        yield client.server.address


def test_a_reader_sorts_filters_and_opens_a_vehicle_and_a_flight(address: str, open_page: OpenPage) -> None:
    record = open_page(address)
    page = record.page
    names, heading = page.locator(".vehicles tbody th"), page.locator("h1")
    assert names.first.inner_text() == "v000"
    column = page.get_by_role("columnheader", name="vehicle", exact=True)
    for order in ("ascending", "descending"):
        column.get_by_role("link").click()
        page.locator(f"th[aria-sort={order}]").get_by_text("vehicle").wait_for()
    assert names.first.inner_text() == f"z{HOSTILE}"
    page.get_by_role("link", name="Next").click()
    assert "page 2 of 3" in page.locator(".pager").inner_text()
    page.get_by_label("Name, cause or firmware").fill("rotor 3")
    page.keyboard.press("Enter")
    page.get_by_text("1 of 120 vehicles").wait_for()
    assert names.all_inner_texts() == ["v000"]
    names.first.get_by_role("link").click()
    assert heading.inner_text() == "Vehicle v000"
    assert page.locator("figure").first.locator(".plot svg path").count() > 3
    page.get_by_role("link", name="Show over time").click()
    page.get_by_text("days since the first flight").first.wait_for()
    page.get_by_role("link", name="10", exact=True).click()
    assert heading.inner_text() == "Flight 10 of 12, vehicle v000"
    page.get_by_role("link", name="Next flight").click()
    assert heading.inner_text().startswith("Flight 11")
    page.get_by_role("link", name="Open the report of this vehicle").click()
    page.get_by_text("Report").wait_for()
    assert page.title() == "drawn"
    assert page.evaluate("fetch('/api/fleet').then(() => 'read', () => 'refused')") == "refused"
    record.console_errors = [error for error in record.console_errors if "/api/fleet" not in error]
    record.check()


def test_keys_reach_the_content_and_the_first_vehicle(address: str, open_page: OpenPage) -> None:
    record = open_page(address)
    page = record.page
    page.keyboard.press("Tab")
    assert page.evaluate("document.activeElement.textContent") == "Skip to the content"
    page.keyboard.press("Enter")
    page.keyboard.press("Tab")
    assert page.evaluate("document.activeElement.textContent").startswith("vehicle v000, rotor 3")
    page.keyboard.press("Enter")
    page.get_by_role("heading", name="Vehicle v000").wait_for()
    record.check()


@pytest.mark.parametrize("scheme", ["light", "dark"])
@pytest.mark.parametrize("path", ["", "vehicles/v000", "vehicles/v001", "flights/0000000010", "vehicles/nobody"])
def test_pages_are_narrow_enough_and_have_contrast(address: str, open_page: OpenPage, path: str, scheme: str) -> None:
    record = open_page(address + path, size=NARROW, color_scheme=scheme)
    assert record.page.evaluate("document.documentElement.scrollWidth") <= NARROW[0]
    assert [text for contrast, text in record.page.evaluate(CONTRASTS) if contrast < LEAST_CONTRAST] == []
    assert record.page.locator("script").count() == 0
    if path != "vehicles/nobody":  # a browser reports its status 404 as an error
        record.check()
