"""From a training to C on the command line."""

import json
from pathlib import Path
from shutil import which

import pytest

from aerial_gym.cli.main import main
from aerial_gym.config import dump_yaml
from aerial_gym.rl_training import load_settings, settings_for


@pytest.mark.skipif(which("gcc") is None and which("cc") is None, reason="needs a C compiler")
def test_a_training_is_exported_and_flies_as_it_did(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    run, settings = tmp_path / "run", tmp_path / "small.yaml"
    cfg = load_settings(settings_for("ppo", "position_setpoint_task"))
    settings.write_text(dump_yaml(cfg))
    train = ["train", "--config", str(settings), "--num-envs", "32", "--max-env-steps", "2048", "--device", "cpu"]
    assert main([*train, "--out", str(run)]) == 0
    assert main(["export", "--policy", str(run), "--to", "c99", "torchscript", "--name", "hover", "--json"]) == 0
    rows = [json.loads(line) for line in capsys.readouterr().out.splitlines() if line.startswith("{")]
    assert [row["to"] for row in rows[-2:]] == ["c99", "torchscript"]
    assert all(row["agrees"] for row in rows[-2:])
    returns = []
    for policy in (run, run / "export" / "hover.c", run / "export" / "hover.pt"):
        assert main(["evaluate", "--policy", str(policy), "--num-envs", "8", "--json"]) == 0
        returns.append(json.loads(capsys.readouterr().out.splitlines()[-1])["return_mean"])
    assert returns[1:] == pytest.approx(returns[:1] * 2, rel=1e-4)
    assert main(["evaluate", "--policy", str(tmp_path / "no.onnx"), "--num-envs", "8"]) == 2
