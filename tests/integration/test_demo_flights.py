"""Flights of the demo are where it was asked to put them, wherever it was started."""

from pathlib import Path

import pytest

from aerial_gym.cli.demo.parts import find_or_simulate_flights


@pytest.mark.usefixtures("coarser_plant")
@pytest.mark.slow
def test_flights_lie_in_a_folder_named_from_where_the_demo_was_started(tmp_path, monkeypatch) -> None:
    monkeypatch.chdir(tmp_path)
    result = find_or_simulate_flights(None, Path("demo"), 0)
    assert len(result.train) == 4
    assert len(result.test) >= 1
    assert Path(result.robot) == tmp_path / "demo" / "flights" / "robot.yaml"
