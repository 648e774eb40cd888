"""The fixture ``open_page`` blocks and counts requests to other machines, and collects errors."""

from collections.abc import Callable
from pathlib import Path

import pytest

from tests.browser.conftest import TELEPHONE, PageRecord

pytestmark = pytest.mark.slow

FOREIGN = "https://example.org/library.js"
SOCKET = "wss://example.org/socket"


def test_foreign_requests_and_errors_are_counted(open_page: Callable[..., PageRecord], tmp_path: Path) -> None:
    """A page with a script of another host, a foreign websocket and an uncaught exception shows all three."""
    path = tmp_path / "page.html"
    path.write_text(
        f"<script src='{FOREIGN}'></script><script>new WebSocket('{SOCKET}'); throw Error('broken')</script>",
        encoding="utf-8",
    )
    record = open_page(path.as_uri())
    record.page.wait_for_timeout(200)
    assert set(record.foreign_requests) == {FOREIGN, SOCKET}
    assert record.console_errors
    assert ["broken" in error for error in record.page_errors] == [True]
    with pytest.raises(AssertionError):
        record.check()


def test_a_telephone_draws_webgl(open_page: Callable[..., PageRecord], tmp_path: Path) -> None:
    """A canvas of 390 pixels width on a plain page takes the colour that WebGL clears it with."""
    path = tmp_path / "page.html"
    path.write_text(
        "<!doctype html><meta name=viewport content='width=device-width'><canvas></canvas>", encoding="utf-8"
    )
    record = open_page(path.as_uri(), size=TELEPHONE, color_scheme="dark")
    pixel = record.page.evaluate(
        "() => { const gl = document.querySelector('canvas').getContext('webgl'); gl.clearColor(1, 0, 0, 1);"
        "gl.clear(gl.COLOR_BUFFER_BIT); const p = new Uint8Array(4);"
        "gl.readPixels(0, 0, 1, 1, gl.RGBA, gl.UNSIGNED_BYTE, p); return [innerWidth, ...p]; }"
    )
    assert pixel == [390, 255, 0, 0, 255]
    record.check()
