"""Alerts: one for each change of a vehicle, once, as a row of ``alerts`` and to a webhook."""

import hashlib
import json
import sys
import time
from collections.abc import Iterable, Mapping
from ipaddress import ip_address
from queue import Queue
from threading import Thread
from typing import Any
from urllib.parse import urlsplit
from urllib.request import HTTPRedirectHandler, ProxyHandler, Request, build_opener

from aerial_gym.errors import ConfigError
from aerial_gym.fleet.tables import FleetTables, Row

TIMEOUT_S, ATTEMPTS, WAIT_S = 5.0, 4, 1.0  # Of one delivery; the wait [s] doubles after each failed attempt


def add_alerts(tables: FleetTables, verdicts: Iterable[Mapping[str, Any]]) -> list[Row]:
    """Append and return the alerts of rejected verdicts that are not yet in the table."""
    known = {row["id"] for row in tables.rows("alerts", ["id"])}
    new = [alert for alert in map(_alert, (one for one in verdicts if one["rejected"])) if alert["id"] not in known]
    tables.append("alerts", new)
    return new


def _alert(verdict: Mapping[str, Any]) -> Row:
    """Return the alert of a verdict; its id is that of the vehicle, the robot file and the most probable cause."""
    cause = json.loads(verdict["causes"])[0]
    name = json.dumps([verdict["vehicle"], verdict["robot_hash"], cause["effect"], cause["rotor"]])
    content = {name: value for name, value in verdict.items() if name != "last_hash"}
    return {
        "id": hashlib.sha256(name.encode()).hexdigest()[:32], "vehicle": verdict["vehicle"], "text": verdict["text"],
        "verdict": json.dumps(content), "first_seen": verdict["last_hash"],
    }  # fmt: skip


class Webhook:
    """Sender of alerts as JSON by POST, in a thread of its own, so that nothing waits for the receiver."""

    def __init__(self, url: str, *, allow_remote: bool) -> None:
        parts = urlsplit(url)
        if parts.scheme not in ("http", "https") or not parts.hostname:
            raise ConfigError(f"--webhook {url}: give a URL that begins with http:// or https://")
        if not allow_remote and not _is_loopback(parts.hostname):
            raise ConfigError(f"--webhook {url}: is another machine; add --allow-remote-webhook to send alerts there")
        self._url, self._queue = url, Queue[Row | None]()
        self._opener = build_opener(ProxyHandler({}), _NoRedirect())
        self._thread = Thread(target=self._send_all, daemon=True)
        self._thread.start()

    def send(self, alert: Row) -> None:
        """Queue an alert."""
        self._queue.put(alert)

    def close(self, wait_s: float = TIMEOUT_S) -> None:
        """Send what is queued, for a limited time [s]."""
        self._queue.put(None)
        self._thread.join(wait_s)

    def _send_all(self) -> None:
        while (alert := self._queue.get()) is not None:
            body = json.dumps(alert).encode()
            for attempt in range(ATTEMPTS):
                try:
                    request = Request(self._url, body, {"Content-Type": "application/json"}, method="POST")
                    self._opener.open(request, timeout=TIMEOUT_S).close()
                    break
                except OSError as error:
                    if attempt == ATTEMPTS - 1:
                        print(f"--webhook {self._url}: alert {alert['id']} not delivered ({error})", file=sys.stderr)
                    else:
                        time.sleep(WAIT_S * 2**attempt)


class _NoRedirect(HTTPRedirectHandler):
    """Refuses redirects, which could lead to another machine."""

    def redirect_request(self, *args: Any, **kwargs: Any) -> None:
        """Return no request."""


def _is_loopback(host: str) -> bool:
    try:
        return host == "localhost" or ip_address(host).is_loopback
    except ValueError:
        return False
