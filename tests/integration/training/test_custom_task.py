"""A task of a user's own file is trained and evaluated from the command line, from any folder."""

import json
from pathlib import Path

from aerial_gym.cli.main import main

EXAMPLE = Path(__file__).parents[3] / "examples" / "custom_task.py"


def test_the_example_is_trained_and_evaluated(tmp_path, monkeypatch, capsys) -> None:
    monkeypatch.chdir(EXAMPLE.parent)
    out = str(tmp_path / "run")
    asked = ["--trainer", "ppo", "--num-envs", "256", "--max-env-steps", "9000", "--max-time-s", "120", "--out", out]
    assert main(["train", "--task", "custom_task.py:FIGURE_EIGHT", *asked, "--device", "cpu"]) == 0
    monkeypatch.chdir(tmp_path)
    capsys.readouterr()
    assert main(["evaluate", "--policy", out, "--num-envs", "4", "--device", "cpu", "--json"]) == 0
    result = json.loads(capsys.readouterr().out)
    assert result["num_starts"] == 4
