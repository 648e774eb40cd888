"""Alerts: one for each failure of a vehicle. It is delivered, then recorded in ``alerts``, so that none is lost."""

import hashlib
import json
import sys
from collections import defaultdict
from collections.abc import Collection, Mapping, Sequence
from http.client import HTTPException
from ipaddress import ip_address
from typing import Any
from urllib.parse import urlsplit
from urllib.request import HTTPRedirectHandler, ProxyHandler, Request, build_opener

from aerial_gym.errors import ConfigError
from aerial_gym.fleet.schemas import SCHEMAS
from aerial_gym.fleet.sources import ORDER, sort_by_time
from aerial_gym.fleet.tables import FleetTables, Row

TIMEOUT_S = 5.0  # Of one delivery


def new_alerts(tables: FleetTables, robots: Collection[str], model_version: str) -> list[Row]:
    """Return the alerts of changed vehicles that the table ``alerts`` does not hold.

    A change is another failure than an earlier one of the same cause, such as one after a repair, if the interval of its onset
    lies behind the flight that raised the earlier alert. The number of the failure is part of the id, so an id is the same
    until the alert is in the table.
    """
    known = defaultdict[tuple[str, ...], list[str]](list)
    for row in tables.rows("alerts", ("verdict", "first_seen")):
        known[_failure(json.loads(row["verdict"]))].append(row["first_seen"])
    key = {"robot_hash": list(robots), "model_version": model_version}
    names = [name for name in SCHEMAS["verdicts"].names if name != "written_at"]
    changed = list(tables.rows("verdicts", names, rejected=True, **key))
    flown = defaultdict[tuple[str, str], list[dict[str, Any]]](list)
    key |= {"status": "ok", "vehicle": [verdict["vehicle"] for verdict in changed]}
    for row in tables.rows("flights", ("vehicle", "robot_hash", "log_hash", *ORDER), **key):
        flown[row["vehicle"], row["robot_hash"]].append(row)
    new = list[Row]()
    for verdict in changed:
        logs = [row["log_hash"] for row in sort_by_time(flown[verdict["vehicle"], verdict["robot_hash"]])]
        failure, onset = _failure(verdict), verdict["onset_low"] or 1
        earlier = known[failure]
        if logs and not set(earlier) & set(logs[onset - 1 :]):
            content = json.dumps([*failure, *([len(earlier) + 1] if earlier else [])])
            new.append({
                "id": hashlib.sha256(content.encode()).hexdigest()[:32], "vehicle": verdict["vehicle"],
                "text": verdict["text"], "verdict": json.dumps(verdict), "first_seen": logs[-1],
            })  # fmt: skip
    return new


def _failure(verdict: Mapping[str, Any]) -> tuple[Any, ...]:
    """Return the vehicle, the robot file and the most probable cause of a verdict."""
    cause = json.loads(verdict["causes"])[0]
    return verdict["vehicle"], verdict["robot_hash"], cause["effect"], cause["rotor"]


class Webhook:
    """Sender of alerts as JSON by POST."""

    def __init__(self, url: str, *, allow_remote: bool) -> None:
        parts = urlsplit(url)
        if parts.scheme not in ("http", "https") or not parts.hostname:
            raise ConfigError(f"--webhook {url}: give a URL that begins with http:// or https://")
        if not allow_remote and not _is_loopback(parts.hostname):
            raise ConfigError(f"--webhook {url}: is another machine; add --allow-remote-webhook to send alerts there")
        self._url, self._is_failing = url, False
        self._opener = build_opener(ProxyHandler({}), _NoRedirect())

    def send(self, alerts: Sequence[Row]) -> list[Row]:
        """Send alerts until one fails; return those that the receiver has taken."""
        taken = list[Row]()
        try:
            for alert in alerts:
                body = json.dumps(alert).encode()
                request = Request(self._url, body, {"Content-Type": "application/json"}, method="POST")
                self._opener.open(request, timeout=TIMEOUT_S).close()
                taken.append(alert)
        except (OSError, HTTPException) as error:
            if not self._is_failing:
                count = len(alerts) - len(taken)
                print(f"--webhook {self._url}: {count} alerts wait, tried again and again ({error})", file=sys.stderr)
        self._is_failing = len(taken) < len(alerts)
        return taken


class _NoRedirect(HTTPRedirectHandler):
    """Refuses redirects, which could lead to another machine."""

    def redirect_request(self, *args: Any, **kwargs: Any) -> None:
        """Return no request."""


def _is_loopback(host: str) -> bool:
    try:
        return host == "localhost" or ip_address(host).is_loopback
    except ValueError:
        return False
