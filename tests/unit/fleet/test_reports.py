"""Reports of changed vehicles: which flights they compare, and what becomes of them."""

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import pytest

pytest.importorskip("deltalake", reason="deltalake is not installed")

from aerial_gym.fleet.report_folder import report_folder
from aerial_gym.sim2real import loop
from tests.unit.fleet.fake_passes import write_fleet, write_log
from tests.unit.fleet.runs import run


def test_report_is_of_the_flights_since_the_change_and_is_written_once(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The change is at flight 6 of 10; five flights are left, of which the odd one is left out."""
    asked: list[tuple[list[str], list[str]]] = []

    def close_loop(_: Path, train: Sequence[Path], test: Sequence[Path], out: Path, **more: Any) -> None:
        asked.append(([path.stem for path in train], [path.stem for path in test]))
        out.mkdir()
        (out / "verdict.json").write_text(json.dumps({"verdict": "explained", "reason": "A rotor is weak."}))

    monkeypatch.setattr(loop, "close_loop", close_loop)
    write_fleet(tmp_path / "logs", vehicles=3, flights=10, changed=[1], bad=False)
    write_log(tmp_path / "logs" / "vehicle_1" / "flight_6.csv", [-1.0, 9.0], time=1e9 + 6e3)
    for _ in range(2):
        summary = run(tmp_path / "logs", tmp_path / "out", reports=5)
        assert summary.reports == {"vehicle_1": "flights 6 to 10: explained. A rotor is weak."}
    assert asked == [(["flight_5", "flight_8"], ["flight_7", "flight_9"])]
    assert (report_folder(tmp_path / "out", "vehicle_1") / "flights.json").is_file()


def test_report_that_fails_ends_no_run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def close_loop(*_: Any, **more: Any) -> None:
        raise FileNotFoundError("flight_9.csv is gone")

    monkeypatch.setattr(loop, "close_loop", close_loop)
    write_fleet(tmp_path / "logs", vehicles=3, flights=10, changed=[1], bad=False)
    summary = run(tmp_path / "logs", tmp_path / "out", reports=5)
    assert summary.reports == {"vehicle_1": "no report: flight_9.csv is gone"}
