"""``aerial-gym train-encoder``: the folder that it leaves, its figures, and going on after an interruption."""

import json
from contextlib import redirect_stdout
from io import StringIO
from pathlib import Path

import pytest
import torch

from aerial_gym.cli.main import main
from aerial_gym.rl_training.encoder import training
from aerial_gym.rl_training.encoder.training import EncoderFit
from aerial_gym.sensors.encoder.file import load_encoder

SMALL = [
    "train-encoder", "--envs", "env_with_obstacles", "--train-images", "96", "--test-images", "16", "--epochs", "3",
    "--batch", "32", "--channels", "4", "8", "--device", "cpu",
]  # fmt: skip
FILES = {"config.yaml", "versions.json", "curve.csv", "checkpoint.pth", "encoder.pt", "result.json", "images.png"}


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, str]:
    """Return the folder of a training that was not interrupted, and what it printed."""
    out, printed = tmp_path_factory.mktemp("whole") / "encoder", StringIO()
    with redirect_stdout(printed):
        assert main([*SMALL, "--out", str(out), "--json"]) == 0
    return out, printed.getvalue()


def test_folder_and_figures(whole: tuple[Path, str], capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    out, printed = whole
    result = json.loads(printed)
    assert {path.name for path in out.iterdir()} == FILES
    assert result == json.loads((out / "result.json").read_text())
    assert set(result["errors"]) == {"encoder", "pca_64", "mean_image"}
    assert result["errors"]["pca_64"]["rms_m"] < result["errors"]["mean_image"]["rms_m"]
    assert result["errors_by_env"]["env_with_obstacles"] == result["errors"]["encoder"]
    assert len((out / "curve.csv").read_text().splitlines()) == 4
    assert (load_encoder(out / "encoder.pt").num_latents, main([*SMALL, "--out", str(out)])) == (64, 2)
    assert "holds a training already" in capsys.readouterr().err
    assert main(["train-encoder", "--out", str(tmp_path / "none"), "--resume"]) == 2
    assert "holds no training of an encoder" in capsys.readouterr().err


def test_interrupted_training_continues(whole, tmp_path, capsys, monkeypatch) -> None:
    """As if it had never ended, bit for bit; settings other than its own are refused."""
    monkeypatch.setattr(training, "SAVE_EVERY_S", 0.0)
    whole_epoch = EncoderFit.run_epoch

    def interrupt(fit: EncoderFit) -> float:
        if fit.epochs == 2:
            raise KeyboardInterrupt
        return whole_epoch(fit)

    monkeypatch.setattr(EncoderFit, "run_epoch", interrupt)
    assert main([*SMALL, "--out", str(tmp_path / "cut")]) == 1
    assert "--resume" in capsys.readouterr().out
    monkeypatch.setattr(EncoderFit, "run_epoch", whole_epoch)
    again = ["train-encoder", "--out", str(tmp_path / "cut"), "--resume", "--device", "cpu"]
    assert main([*again, "--seed", "5"]) == 2
    assert "--seed: a resumed training keeps its own" in capsys.readouterr().err
    assert main(again) == 0
    actual, reference = (load_encoder(folder / "encoder.pt").state_dict() for folder in (whole[0], tmp_path / "cut"))
    for name, value in actual.items():
        torch.testing.assert_close(value, reference[name], atol=0.0, rtol=0.0)
