"""The server of the page: which requests it answers, and what it says of a port that is not free."""

import http.client
import socket
from collections.abc import Iterator
from contextlib import nullcontext

import pytest

from aerial_gym.errors import ConfigError, MissingDependencyError

viser = pytest.importorskip("viser", reason="viser is not installed")

from aerial_gym.viewer.server import open_server  # noqa: E402


@pytest.fixture(scope="module")
def port() -> Iterator[int]:
    server = open_server(port=0)
    yield server.get_port()
    server.stop()


def status(port: int, **headers: str) -> int:
    """Return the status of a request with these headers; ``Host`` is this server's unless given."""
    connection = http.client.HTTPConnection("127.0.0.1", port, timeout=5.0)
    connection.putrequest("GET", "/", skip_host=True)
    for name, value in {"Host": f"127.0.0.1:{port}", **headers}.items():
        connection.putheader(name.replace("_", "-"), value.format(port=port))
    connection.endheaders()
    answer = connection.getresponse().status
    connection.close()
    return answer


SOCKET = {
    "Upgrade": "websocket", "Connection": "Upgrade", "Sec_WebSocket_Key": "dGhlIHNhbXBsZSBub25jZQ==",
    "Sec_WebSocket_Version": "13", "Sec_WebSocket_Protocol": "viser-v" + viser.__version__,
}  # fmt: skip


@pytest.mark.parametrize(
    ("headers", "served"),
    [
        ({}, True),
        ({"Host": "localhost:{port}"}, True),
        ({"Host": "localhost:9000"}, True),  # the port of a tunnel, as ssh -L opens
        ({"Host": "[::1]:{port}"}, True),
        ({"Origin": "http://127.0.0.1:{port}"}, True),
        ({"Host": "example.org"}, False),  # a foreign name that leads here
        ({"Host": "example.org", "Origin": "http://example.org"}, False),
        ({"Host": "localhost.example.org:{port}"}, False),
        ({"Host": "192.0.2.1:{port}"}, False),
        ({"Host": "localhost:x["}, False),
        ({"Host": ""}, False),
        ({"Origin": "http://example.org"}, False),
        ({"Origin": "http://127.0.0.1:1"}, False),  # another server of this machine
        ({"Origin": "https://127.0.0.1:{port}"}, False),
        ({"Origin": "null"}, False),
    ],
)
def test_only_pages_of_this_server_are_answered(port: int, headers: dict[str, str], served: bool) -> None:
    assert status(port, **headers) == (200 if served else 403)
    assert status(port, **SOCKET, **headers) == (101 if served else 403)


def test_request_without_host_is_refused(port: int) -> None:
    with socket.create_connection(("127.0.0.1", port), timeout=5.0) as line:
        line.sendall(b"GET / HTTP/1.1\r\n\r\n")
        assert line.recv(64).split()[1] == b"403"


def test_page_loads_nothing_from_elsewhere(port: int) -> None:
    connection = http.client.HTTPConnection("127.0.0.1", port, timeout=5.0)
    connection.request("GET", "/")
    rules = connection.getresponse().getheader("Content-Security-Policy") or ""
    connection.close()
    assert "default-src 'none'" in rules
    assert "frame-ancestors 'none'" in rules
    assert "unsafe-eval" not in rules.replace("wasm-unsafe-eval", "")
    assert "http" not in rules


def test_taken_port_is_reported(port: int) -> None:
    with pytest.raises(ConfigError, match=rf"port {port}.*--port"):
        open_server(port=port)


@pytest.mark.parametrize(("host", "port"), [("192.0.2.1", 0), ("no.such.host.invalid", 0), ("127.0.0.1", 70_000)])
def test_unusable_address_is_reported(host: str, port: int) -> None:
    with pytest.raises(ConfigError, match="--port"):
        open_server(host, port)


def test_loopback_is_the_default_and_only_other_addresses_warn(capsys: pytest.CaptureFixture[str]) -> None:
    for host, warns in (("127.0.0.1", False), ("0.0.0.0", True)):
        server = open_server(host, 0)
        try:
            assert status(server.get_port(), Host="example.org") == 403
            assert status(server.get_port(), Host="192.0.2.1:80") == (200 if warns else 403)
        finally:
            server.stop()
        assert bool(capsys.readouterr().err) == warns


def test_page_cannot_ask_for_a_public_tunnel() -> None:
    from viser._messages import ShareUrlRequest

    server = open_server(port=0)
    server.stop()
    assert ShareUrlRequest not in server._websock_server._incoming_handlers


def test_server_that_would_start_unguarded_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    """As if another version of viser did not call the function that is wrapped."""
    monkeypatch.setattr("aerial_gym.viewer.server._guard_start", lambda *_: nullcontext([]))
    with pytest.raises(MissingDependencyError, match="viser"):
        open_server(port=0)
