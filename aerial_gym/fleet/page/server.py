"""Server of the pages, on this machine alone. It only reads, and its pages may load nothing from elsewhere.

Pages are at ``/``, ``/vehicles/NAME`` and ``/flights/HASH``, and the same content as JSON at ``/api/fleet`` and so on.
"""

import json
import sys
import webbrowser
from contextlib import suppress
from functools import cached_property
from http import HTTPStatus
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import TYPE_CHECKING, Any
from urllib.parse import parse_qsl, quote, unquote, urlencode, urlsplit

from aerial_gym.errors import ConfigError
from aerial_gym.fleet.page import content as contents
from aerial_gym.fleet.page.charts import effect_figures
from aerial_gym.fleet.page.snapshot import TEMPLATES, FleetStore
from aerial_gym.fleet.page.texts import time_text
from aerial_gym.fleet.report_folder import report_folder
from aerial_gym.sim2real.json_values import finite_or_none, map_leaves
from aerial_gym.sim2real.report import canvas

if TYPE_CHECKING:
    from jinja2 import Environment

LOOPBACK = "127.0.0.1"
REPORT_STYLE = Path(canvas.__file__).parent / "templates" / "page.css"
IDLE_S = 30.0  # A connection without a request is closed after this time [s]

PAGE_RULES = (
    "default-src 'none'; style-src 'self'; style-src-attr 'unsafe-inline'; img-src data:; base-uri 'none'; "
    "form-action 'self'; frame-ancestors 'none'"
)
"""Content security policy of a page: its own style file, no script, nothing from elsewhere."""

REPORT_RULES = (
    "sandbox allow-scripts; default-src 'none'; script-src 'unsafe-inline'; style-src 'unsafe-inline'; img-src data:; "
    "base-uri 'none'; form-action 'none'; frame-ancestors 'none'"
)
"""Content security policy of a report of close-loop, which has its styles and scripts inside and reads no other page."""

HEADERS = {
    "X-Content-Type-Options": "nosniff", "Referrer-Policy": "no-referrer", "Cache-Control": "no-cache",
    "Cross-Origin-Resource-Policy": "same-origin", "Cross-Origin-Opener-Policy": "same-origin",
}  # fmt: skip
HTML, JSON, CSS = "text/html", "application/json", "text/css"

CONTENTS = {"fleet": contents.fleet_content, "vehicles": contents.vehicle_content, "flights": contents.flight_content}
"""Function of the content by the first part of an address; the template of the page has the same name."""


class PageServer(ThreadingHTTPServer):
    """Server of the pages of one folder of tables."""

    daemon_threads = True

    def __init__(self, tables: Path, port: int) -> None:
        """Raise ``ConfigError`` if the folder holds no tables, or if the port is not free."""
        self.store = FleetStore(tables)
        try:
            super().__init__((LOOPBACK, port), _Handler)
        except (OSError, OverflowError) as error:
            reason = getattr(error, "strerror", None) or error
            place = f"{LOOPBACK}, port {port}"
            raise ConfigError(f"cannot listen on {place}: {reason}. Choose another with --port") from None
        self.hosts = (f"{LOOPBACK}:{self.server_port}", f"localhost:{self.server_port}")
        self.address = f"http://{self.hosts[0]}/"

    @cached_property
    def templates(self) -> "Environment":
        """Return the templates of pages, which escape every text."""
        from jinja2 import Environment, FileSystemLoader, StrictUndefined

        pages = Environment(loader=FileSystemLoader(TEMPLATES), autoescape=True, undefined=StrictUndefined)
        pages.trim_blocks = pages.lstrip_blocks = True
        pages.filters |= {"time": time_text, "address": lambda name: quote(name, safe=""), "options": urlencode}
        pages.globals |= {"verdict_words": contents.VERDICTS, "sorts": list(contents.SORTS), "figures": effect_figures}
        return pages


def serve(tables: Path, port: int, open_browser: bool) -> None:
    """Serve the pages of a folder of tables on 127.0.0.1 until interrupted; port 0 takes a free one."""
    with PageServer(tables, port) as server, suppress(KeyboardInterrupt):
        print(f"{server.address}  (Ctrl-C ends)", file=sys.stderr, flush=True)
        if open_browser:
            webbrowser.open(server.address)
        server.serve_forever()


class _Handler(BaseHTTPRequestHandler):
    """Answer of one request."""

    server: PageServer
    timeout = IDLE_S
    server_version, sys_version = "aerial-gym", ""

    def do_GET(self) -> None:
        """Answer with a page, its content as JSON, a report or the style file."""
        address = urlsplit(self.path)
        parts = [unquote(part) for part in address.path.strip("/").split("/")]
        as_json = parts[0] == "api"
        with suppress(ConnectionError, TimeoutError):  # the browser went away
            if self.headers.get("Host") not in self.server.hosts:
                # The page of another site, whose name leads here, must not read the tables (DNS rebinding)
                return self._send_problem(HTTPStatus.FORBIDDEN, f"Open {self.server.address}", as_json)
            try:
                self._answer(parts[as_json:] or ["fleet"], dict(parse_qsl(address.query)), as_json)
            except ConnectionError:
                raise
            except Exception as error:
                self._send_problem(HTTPStatus.SERVICE_UNAVAILABLE, f"The tables cannot be read: {error}", as_json)

    do_HEAD = do_GET  # noqa: N815

    def _answer(self, parts: list[str], options: contents.Options, as_json: bool) -> None:
        kind, *names = parts[0] or "fleet", *parts[1:]
        if parts == ["style.css"]:
            files = (REPORT_STYLE, TEMPLATES / "fleet.css")
            return self._send(HTTPStatus.OK, CSS, "".join(file.read_text(encoding="utf-8") for file in files))
        report, content = kind == "vehicles" and names[1:] == ["report"], None
        if kind in CONTENTS and (report or len(names) == (kind != "fleet")):
            content = CONTENTS[kind](self.server.store.snapshot(), "".join(names[:1]), options)
        if report and content:
            content = self._report(content["vehicle"])
        if content is None:
            problem = f"There is no page {'/'.join(parts)!r}: the tables hold no such vehicle, flight or report."
            return self._send_problem(HTTPStatus.NOT_FOUND, problem, as_json)
        if isinstance(content, str):
            return self._send(HTTPStatus.OK, HTML, content, REPORT_RULES)
        if as_json:
            return self._send(HTTPStatus.OK, JSON, json_text(content))
        api = f"/api/{'fleet' if parts == [''] else ''}{self.path.removeprefix('/')}"
        page = self.server.templates.get_template(f"{kind}.html.j2")
        return self._send(HTTPStatus.OK, HTML, page.render(content, content=content, options=options, api=api))

    def _report(self, vehicle: str) -> str | None:
        """Return the report of a vehicle, if it lies in the folder of reports."""
        out = self.server.store.snapshot().tables.out
        file = (report_folder(out, vehicle) / "report.html").resolve()
        inside = file.is_relative_to((out / "reports").resolve())
        return file.read_text(encoding="utf-8", errors="replace") if inside and file.is_file() else None

    def _send_problem(self, status: HTTPStatus, problem: str, as_json: bool) -> None:
        page = self.server.templates.get_template("problem.html.j2").render(problem=problem, title=status.phrase)
        self._send(status, *((JSON, json_text({"error": problem})) if as_json else (HTML, page)))

    def _send(self, status: HTTPStatus, kind: str, content: str, rules: str = PAGE_RULES) -> None:
        body = content.encode("utf-8", errors="replace")
        self.send_response(status)
        own = {"Content-Type": f"{kind}; charset=utf-8", "Content-Length": str(len(body))}
        own["Content-Security-Policy"] = rules
        for name, value in (own | HEADERS).items():
            self.send_header(name, value)
        self.end_headers()
        if self.command != "HEAD":
            self.wfile.write(body)

    def log_message(self, format: str, *args: Any) -> None:
        """Print nothing for a request."""


def json_text(content: object) -> str:
    """Return content as JSON; infinite and NaN values become null."""
    return json.dumps(map_leaves(content, finite_or_none), ensure_ascii=False, allow_nan=False)
