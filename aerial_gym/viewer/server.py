"""The server of the page: viser on an address that is this machine's own, which refuses pages of other sites.

viser has no setting for a listening socket nor for a check of requests, so ``websockets.asyncio.server.serve`` is
wrapped while the server starts.
"""

import socket
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager, redirect_stdout
from http import HTTPStatus
from io import StringIO
from ipaddress import ip_address
from typing import TYPE_CHECKING, Any
from urllib.parse import urlsplit

from aerial_gym.errors import ConfigError, MissingDependencyError
from aerial_gym.extras import optional_import

if TYPE_CHECKING:
    from viser import ViserServer
    from websockets.asyncio.server import ServerConnection
    from websockets.http11 import Request, Response

LOOPBACK = "127.0.0.1"
LOCAL_NAMES = ("localhost", "127.0.0.1", "::1")
PAGE_RULES = (
    "default-src 'none'; script-src 'unsafe-inline' 'wasm-unsafe-eval' blob: data:; style-src 'unsafe-inline'; "
    "img-src data: blob:; font-src data:; connect-src 'self' data: blob:; worker-src blob: data:; base-uri 'none'; "
    "form-action 'none'; frame-ancestors 'none'"
)
"""Content security policy of the page: nothing from elsewhere, no evaluation of text as code, no frame around it."""


def open_server(host: str = LOOPBACK, port: int = 8080) -> "ViserServer":
    """Return a started server; raise ``ConfigError`` if the address or the port is not free.

    Args:
        host: Address to bind; any other than this machine's own is warned about on stderr.
        port: Port; 0 takes a free one (``server.get_port()``).
    """
    with optional_import("the viewer"):
        from viser import ViserServer
    listener = _listen(host, port)
    if not _is_loopback(host):
        print(f"aerial-gym: {host} is reachable from other machines; they can then control this view", file=sys.stderr)
    with _guard_start(listener, allows(host)) as guarded, redirect_stdout(StringIO()):  # without viser's own table
        server = ViserServer(host=host, port=port, verbose=False)
    if not guarded or not _close_tunnel(server):
        close_server(server)
        raise MissingDependencyError("this viser starts its server in another way: pip install viser==1.1.1")
    server.gui.configure_theme(show_logo=False, show_share_button=False)
    server.gui.main_panel.dock_right()
    return server


def page_url(server: "ViserServer") -> str:
    """Return the address of the page for a browser of this machine."""
    host = server.get_host()
    name = "localhost" if host in ("0.0.0.0", "::") else f"[{host}]" if ":" in host else host
    return f"http://{name}:{server.get_port()}"


def close_server(server: "ViserServer") -> None:
    """Stop a server at once, pages or not."""
    with redirect_stdout(StringIO()):
        server.stop()


def _listen(host: str, port: int) -> socket.socket:
    try:
        family = socket.getaddrinfo(host, port, type=socket.SOCK_STREAM)[0][0]
        return socket.create_server((host, port), family=family)
    except (OSError, OverflowError) as error:
        reason = str(getattr(error, "strerror", None) or error).rstrip(".")
        raise ConfigError(f"cannot listen on {host}, port {port}: {reason}. Choose another with --port") from None


def _is_loopback(host: str) -> bool:
    try:
        return ip_address(host).is_loopback
    except ValueError:
        return host == "localhost"


def allows(host: str) -> Callable[["Request"], bool]:
    """Return the check of a request to a server bound to ``host``.

    The name in Host must be this machine's own. On loopback that is ``localhost`` or an address of loopback; else also
    any numeric address and the machine's name. A page of another site has a name of its own, even if that name leads
    here (DNS rebinding). Origin, which browsers send, must be the page that Host names.
    """
    names, is_open = {*LOCAL_NAMES, host}, not _is_loopback(host)
    if is_open:
        names.add(socket.gethostname().lower())

    def check(request: "Request") -> bool:
        hosts, origins = request.headers.get_all("Host"), request.headers.get_all("Origin")
        if len(hosts) != 1 or len(origins) > 1:
            return False
        name = _host_name(hosts[0])
        known = name in names or (is_open and _is_address(name))
        return known and all(origin.lower() == f"http://{hosts[0].lower()}" for origin in origins)

    return check


def _host_name(host: str) -> str:
    try:
        return (urlsplit(f"//{host}").hostname or "").lower()
    except ValueError:
        return ""


def _is_address(name: str) -> bool:
    try:
        return bool(ip_address(name))
    except ValueError:
        return False


@contextmanager
def _guard_start(listener: socket.socket, check: Callable[["Request"], bool]) -> Iterator[list[bool]]:
    """Let the next server listen on ``listener`` and refuse requests that fail the check; yield a list that it fills."""
    from websockets.asyncio import server as websockets

    original, guarded = websockets.serve, list[bool]()

    def serve(handler: Any, *_: Any, process_request: Any, **options: Any) -> Any:
        def answer(connection: "ServerConnection", request: "Request") -> "Response | None":
            if not check(request):
                return connection.respond(HTTPStatus.FORBIDDEN, "only pages of this server are served\n")
            response = process_request(connection, request)
            if response is not None:
                response.headers["Content-Security-Policy"] = PAGE_RULES
            return response

        guarded.append(True)
        return original(handler, sock=listener, process_request=answer, **options)

    websockets.serve = serve  # type: ignore[assignment]
    try:
        yield guarded
    finally:
        websockets.serve = original


def _close_tunnel(server: "ViserServer") -> bool:
    """Ignore requests of a page for viser's public tunnel, which shows a view to the internet; return whether that is done."""
    from viser._messages import ShareUrlRequest

    return server._websock_server._incoming_handlers.pop(ShareUrlRequest, None) is not None
