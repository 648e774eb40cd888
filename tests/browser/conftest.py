"""A headless Chromium for the tests of pages; every request to another machine is blocked and counted.

``make browser`` installs Chromium and Playwright, ``make view-test`` runs these tests. Without either they skip.
"""

import shutil
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from dataclasses import dataclass, field
from typing import TYPE_CHECKING
from urllib.parse import urlsplit

import pytest

if TYPE_CHECKING:
    from playwright.sync_api import Browser, BrowserContext, Page

ARGUMENTS = (
    "--no-sandbox", "--use-gl=angle", "--use-angle=swiftshader",  # WebGL without a GPU
    "--host-resolver-rules=MAP * ~NOTFOUND, EXCLUDE 127.0.0.1",
)  # fmt: skip
LOCAL_HOST = "127.0.0.1"
LOCAL_SCHEMES = ("file", "data", "blob", "about")
TELEPHONE = (390, 844)  # Width and height of a telephone's page [CSS pixels]
DESKTOP = (1280, 800)


@dataclass
class PageRecord:
    """A page, and the requests and errors since it opened."""

    page: "Page"
    requests: list[str] = field(default_factory=list)  # Addresses of all requests and websockets
    console_errors: list[str] = field(default_factory=list)
    page_errors: list[str] = field(default_factory=list)  # Uncaught exceptions

    @property
    def foreign_requests(self) -> list[str]:
        """Return the requests to another host than 127.0.0.1; all of them were blocked."""
        return [address for address in self.requests if not is_local(address)]

    def check(self) -> None:
        """Assert that the page had no error and asked no other machine."""
        assert (self.foreign_requests, self.console_errors, self.page_errors) == ([], [], [])


def is_local(address: str) -> bool:
    """Return whether an address stays on this machine."""
    parts = urlsplit(address)
    return parts.scheme in LOCAL_SCHEMES or parts.hostname == LOCAL_HOST


@pytest.fixture(scope="package")
def chromium() -> Iterator["Browser"]:
    """Return a headless Chromium with WebGL in software."""
    api = pytest.importorskip("playwright.sync_api", reason="Playwright is not installed: run `make browser`")
    program = shutil.which("chromium")
    if program is None:
        pytest.skip("Chromium is not installed: run `make browser`")
    with api.sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=program, args=list(ARGUMENTS))
        yield browser
        browser.close()


@pytest.fixture
def open_page(chromium: "Browser") -> Iterator[Callable[..., PageRecord]]:
    """Return a function that opens an address: ``open_page(address, size=TELEPHONE, color_scheme="dark")``."""
    with ExitStack() as contexts:

        def open_address(address: str, *, size: tuple[int, int] = DESKTOP, color_scheme: str = "light") -> PageRecord:
            context = chromium.new_context(
                viewport={"width": size[0], "height": size[1]}, color_scheme=color_scheme,
                has_touch=size == TELEPHONE, is_mobile=size == TELEPHONE, service_workers="block",
            )  # fmt: skip
            contexts.callback(context.close)
            record = watch_context(context)
            record.page.goto(address)
            return record

        yield open_address


def watch_context(context: "BrowserContext") -> PageRecord:
    """Return a new page of a context whose requests and errors are recorded."""
    record = PageRecord(context.new_page())
    context.route(lambda address: not is_local(address), lambda route: route.abort())
    context.on("request", lambda request: record.requests.append(request.url))
    context.on("weberror", lambda error: record.page_errors.append(str(error.error)))
    context.on("console", lambda entry: record.console_errors.append(entry.text) if entry.type == "error" else None)
    record.page.on("websocket", lambda socket: record.requests.append(socket.url))
    return record
