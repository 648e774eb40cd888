"""The command as a whole: its table, files and JSON are of one result."""

import json
from pathlib import Path

import pytest

from aerial_gym.cli.main import main
from tests.refusals import assert_refused

HOVER = "pretrained/position_setpoint_task"


@pytest.mark.slow
def test_a_quick_run_lists_all_conditions_worst_first(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["robustness", "--policy", HOVER, "--quick", "--flights", "12", "--out", str(tmp_path), "--json"]) == 0
    printed = json.loads(capsys.readouterr().out)
    assert printed == json.loads((tmp_path / "robustness.json").read_text())
    assert (tmp_path / "robustness.png").is_file()
    assert printed["complete"]
    cells = {each["name"]: each for each in printed["cells"]}
    rates = [each["success_rate"] for each in printed["cells"]]
    assert rates == sorted(rates)
    for number in (1, 2):  # neutral effects change nothing
        assert cells[f"neutral/{number}"]["successes"] == printed["clean"]["successes"]
    assert cells["motor_failure/large"]["outcome"] == cells["delay/50 ms"]["outcome"] == "fails"
    assert "task.action.delay_steps" in cells["delay/50 ms"]["advice"]


def test_a_number_of_flights_below_one_is_refused() -> None:
    from aerial_gym import robustness
    from aerial_gym.errors import ConfigError

    assert_refused(ConfigError, "flights = 0: must be >= 1", robustness, HOVER, flights=0)
