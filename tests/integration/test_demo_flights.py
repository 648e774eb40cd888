"""Flights of the demo are where it was asked to put them, wherever it was started."""

from pathlib import Path

import pytest

from aerial_gym.cli.demo.parts import find_flights


@pytest.mark.usefixtures("coarser_plant")
@pytest.mark.slow
def test_flights_lie_in_a_folder_named_from_where_the_demo_was_started(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    found = find_flights(None, Path("demo"), 0)
    assert len(found.train) == 4
    assert len(found.test) >= 1
    assert Path(found.robot) == tmp_path / "demo" / "flights" / "robot.yaml"
