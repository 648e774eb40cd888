"""A fleet analysis whose processes are killed writes the tables of an undisturbed run."""

import random
import sys
from pathlib import Path

import pytest

pytest.importorskip("ray", reason="ray is not installed")
pytest.importorskip("deltalake", reason="deltalake is not installed")

from benchmarks.fleet.kills import run_with_kills, table_contents
from tests.unit.fleet.fake_passes import write_fleet
from tests.unit.fleet.runs import run


@pytest.mark.slow
def test_kills_of_workers_and_of_the_program_change_no_table(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    write_fleet(tmp_path / "logs", vehicles=30, flights=20, changed=[4])
    run(tmp_path / "logs", tmp_path / "calm")
    monkeypatch.setenv("FAKE_SLOW", "0.1")
    command = [sys.executable, "-m", "tests.unit.fleet.runs", str(tmp_path / "logs"), str(tmp_path / "disturbed")]
    assert run_with_kills(command, 10, 3, random.Random(0), pause_s=1.0) == (10, 3)
    assert table_contents(tmp_path / "disturbed") == table_contents(tmp_path / "calm")
