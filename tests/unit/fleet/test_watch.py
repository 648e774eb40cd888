"""Watching a store: verdicts of new logs, interruptions, one alert for each failure, files of tables, and webhooks."""

import json
import threading
from collections.abc import Iterator
from http.server import BaseHTTPRequestHandler, HTTPServer
from pathlib import Path
from typing import Any

import pytest
from deltalake import DeltaTable

from aerial_gym.errors import ConfigError
from aerial_gym.fleet import watch
from aerial_gym.fleet.alerts import Webhook
from aerial_gym.fleet.tables import FleetTables
from aerial_gym.fleet.watch import watch_fleet
from benchmarks.fleet.kills import table_contents
from tests.unit.fleet.fake_passes import write_fleet, write_log
from tests.unit.fleet.runs import request, run


def start_watch(logs: Path, out: Path, delivered: list[Any]) -> Iterator[None]:
    """Return a watch that adds its alerts to a list."""
    return watch_fleet(request(logs, out), lambda alerts: delivered.extend(alerts) or alerts, lambda _: None)


def test_watch_judges_complete_logs_and_raises_each_alert_once(tmp_path: Path) -> None:
    logs, out = tmp_path / "logs", tmp_path / "out"
    write_fleet(logs, vehicles=4, flights=8, bad=False)
    run(logs, out)
    alerts, told = list[Any](), list[str]()
    looks = watch_fleet(request(logs, out), lambda some: alerts.extend(some) or some, told.append)
    next(looks)
    assert told == [f"watching {logs}; known from {out}: 32 logs, verdicts of 4 vehicles"]
    for flight in range(8, 17):
        write_log(logs / "vehicle_1" / f"flight_{flight}.csv", [-1.0, 0.0], time=1e9 + 1e3 * flight)
        assert FleetTables(out).dataset("flights").count_rows() == max(32, 24 + flight - 1)
        next(looks)
    next(looks)
    assert [alert["text"][:28] for alert in alerts] == ["vehicle vehicle_1, rotor 1: "]
    assert told[-2:] == ["reading logs 1 to 1 of 1", "judging 1 vehicles"]
    looks.close()
    run(logs, tmp_path / "calm")
    same = ("flights", "evidence", "vehicles")
    both = [{name: table_contents(folder)[name] for name in same} for folder in (out, tmp_path / "calm")]
    assert [len(both[0][name]) for name in same] == [len(both[1][name]) for name in same]


def test_webhook_repeats_a_failed_delivery_and_follows_no_redirect(capsys: pytest.CaptureFixture[str]) -> None:
    received, answers = [], [500, 302, 200]

    class Receiver(BaseHTTPRequestHandler):
        def do_POST(self) -> None:
            received.append(json.loads(self.rfile.read(int(self.headers["Content-Length"]))))
            self.send_response(answers[len(received) - 1])
            self.send_header("Location", "http://192.0.2.1/")
            self.end_headers()

        def log_message(self, *args: object) -> None:
            """Print nothing."""

    server = HTTPServer(("127.0.0.1", 0), Receiver)
    threading.Thread(target=server.serve_forever, daemon=True).start()
    webhook = Webhook(f"http://127.0.0.1:{server.server_port}/", allow_remote=False)
    alert = {"id": "1", "text": "changed"}
    assert [webhook.send([alert]) for _ in answers] == [[], [], [alert]]
    server.shutdown()
    server.server_close()
    assert received == 3 * [alert]
    assert capsys.readouterr().err.count("1 alerts wait") == 1


@pytest.mark.parametrize(
    "url", ["http://example.com/", "http://127.0.0.1.example.com/", "file:///etc/passwd", "http://"]
)
def test_webhook_to_another_machine_is_refused(url: str) -> None:
    with pytest.raises(ConfigError, match="--webhook"):
        Webhook(url, allow_remote=False)


@pytest.mark.parametrize("after", [False, True])
@pytest.mark.parametrize(
    ("method", "table"),
    [
        ("append", "evidence"), ("append", "flights"), ("replace", "vehicles"), ("replace", "verdicts"),
        ("append", "alerts"),
    ],
)  # fmt: skip
def test_interrupted_watch_loses_no_alert_and_repeats_no_row(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, method: str, table: str, after: bool
) -> None:
    """Broken off before or after any change of a table, a watch that starts again ends as an undisturbed run."""
    change, delivered = getattr(FleetTables, method), list[Any]()

    def break_off(self: FleetTables, name: str, *rows: Any) -> None:
        if name != table or after:
            change(self, name, *rows)
        if name == table:
            raise KeyboardInterrupt

    write_fleet(tmp_path / "logs", vehicles=3, flights=10, changed=[1])
    run(tmp_path / "logs", tmp_path / "calm")
    with monkeypatch.context() as patch:
        patch.setattr(FleetTables, method, break_off)
        with pytest.raises(KeyboardInterrupt):
            [*zip(range(3), start_watch(tmp_path / "logs", tmp_path / "out", delivered), strict=False)]
    looks = start_watch(tmp_path / "logs", tmp_path / "out", delivered)
    for _ in range(3):
        next(looks)
    assert table_contents(tmp_path / "out") == table_contents(tmp_path / "calm")
    assert len({alert["id"] for alert in delivered}) == 1


def test_alert_that_does_not_arrive_is_delivered_again(tmp_path: Path) -> None:
    write_fleet(tmp_path / "logs", vehicles=3, flights=10, changed=[1])
    offered = list[str]()
    looks = watch_fleet(
        request(tmp_path / "logs", tmp_path / "out"),
        lambda alerts: offered.extend(alert["id"] for alert in alerts) or alerts[: len(offered) // 3],
        lambda _: None,
    )
    for _ in range(7):
        next(looks)
    assert offered == 3 * offered[:1]


def test_second_failure_of_a_repaired_motor_raises_an_alert_of_its_own(tmp_path: Path) -> None:
    """The cheap pass 2 compares the halves: flights 1 to 8, then flights 9 to 16, of which the last four are worse."""
    logs, delivered = tmp_path / "logs", list[Any]()
    write_fleet(logs, vehicles=3, flights=8, changed=[1], bad=False)
    looks = start_watch(logs, tmp_path / "out", delivered)
    for count, value in ((8, -1.0), (8, -1.0), (24, -4.0)):
        for _ in range(2):
            next(looks)
        first = len(list((logs / "vehicle_1").iterdir()))
        for flight in range(first, first + count):
            write_log(logs / "vehicle_1" / f"flight_{flight}.csv", [value, 0.0], time=1e9 + 1e3 * flight)
    for _ in range(2):
        next(looks)
    onsets = [json.loads(alert["verdict"])["onset_flight"] for alert in delivered]
    assert onsets == [5, 25]
    assert len({alert["id"] for alert in delivered}) == 2
    assert len({alert["first_seen"] for alert in delivered}) == 2


def test_tables_of_a_watched_folder_keep_few_files(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(watch, "MOST_FILES", 4)
    write_fleet(tmp_path / "logs", vehicles=1, flights=4, bad=False)
    looks = start_watch(tmp_path / "logs", tmp_path / "out", [])
    for flight in range(4, 16):
        next(looks)
        write_log(tmp_path / "logs" / "vehicle_0" / f"flight_{flight}.csv", [0.0, 0.0], time=1e9 + 1e3 * flight)
    assert FleetTables(tmp_path / "out").dataset("flights").count_rows() == 14
    assert max(len(DeltaTable(tmp_path / "out" / name).file_uris()) for name in ("flights", "evidence")) <= 4
