"""The demo: its flights are in the requested folder, wherever it was started, and its stages show when they begin."""

from pathlib import Path

import pytest

from aerial_gym.cli.demo.command import stage_line
from aerial_gym.cli.demo.parts import find_or_simulate_flights


@pytest.mark.usefixtures("coarser_plant")
@pytest.mark.slow
def test_flights_lie_in_a_folder_named_from_where_the_demo_was_started(tmp_path, monkeypatch) -> None:
    monkeypatch.chdir(tmp_path)
    result = find_or_simulate_flights(None, Path("demo"), 0)
    assert len(result.train) == 4
    assert len(result.test) >= 1
    assert Path(result.robot) == tmp_path / "demo" / "flights" / "robot.yaml"


def test_a_stage_shows_when_it_begins_and_no_total() -> None:
    assert stage_line("3/3 measure", 77.4) == "at 77 s: 3/3 measure"
