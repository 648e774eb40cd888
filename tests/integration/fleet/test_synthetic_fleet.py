"""Fleet analysis of synthetic flights: a tenth of the fleet on which it is scored, with each cause as a step and as a drift."""

import json
from pathlib import Path

import pytest

pytest.importorskip("ray", reason="ray is not installed")
pytest.importorskip("deltalake", reason="deltalake is not installed")

from deltalake import DeltaTable

from aerial_gym.cli.main import main
from benchmarks.fleet.flights import FleetCmd
from benchmarks.fleet.score import score_fleet


@pytest.mark.slow
def test_changed_vehicles_are_found_with_cause_and_onset_and_no_other_one(tmp_path: Path) -> None:
    logs, tables = tmp_path / "logs", tmp_path / "tables"
    assert FleetCmd(out=logs, vehicles=50, changed=0.2, seed=61000).run() == 0
    command = ["fleet", "run", "--logs", str(logs), "--pattern", "*.ulg", "--out", str(tables), "--reports", "0"]
    assert main([*command, "--robots", str(logs / "robot.yaml")]) == 0
    truth = json.loads((logs / "truth.json").read_text(encoding="utf-8"))
    score = score_fleet(truth, DeltaTable(tables / "verdicts").to_pyarrow_table().to_pylist(), "moderate")
    assert (score.vehicles, score.changed) == (50, 10)
    assert score.recall >= 0.95
    assert score.false == 0
    assert score.median_onset_error <= 2.0
