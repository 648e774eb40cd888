"""Stages of a training for a real vehicle: order, continuation, refusals, and the summary."""

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

import aerial_gym
from aerial_gym.cli import train_for_real
from aerial_gym.cli.train import TrainCmd
from aerial_gym.errors import ConfigError

CELL = {"label": "commands 50 ms late", "success_rate": 0.25, "flights": 48, "outcome": "fails"}
PLAN = {
    "verdict": "contradicted", "robot": "a.yaml", "settings": [], "corrections": ["The gyro is wrong."],
    "choices": [{"name": "rotor_lag", "state": "left", "low": None, "high": None, "setting": "the task draws it already"},
                {"name": "thrust", "state": "measured", "low": 0.9, "high": 0.95, "setting": "task.randomize.x"}],
}  # fmt: skip


@pytest.fixture
def calls(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """Return the stages that ran; the training is interrupted once if the list begins with ``interrupt``."""
    done: list[str] = []

    def stage(name: str, result: Any) -> None:
        def run(_cmd: TrainCmd, _record: Any) -> Any:
            done.append(name)
            interrupted = name == "training" and done[0] == "interrupt" and done.count("training") == 1
            return {"interrupted": interrupted} if name == "training" else result

        monkeypatch.setattr(train_for_real, f"_{ {'training': 'train', 'robustness': 'test'}.get(name, name) }", run)

    for name, result in (("plan", PLAN), ("training", None), ("export", {"a.onnx": True}),
                         ("robustness", {"clean": {**CELL, "success_rate": 0.9}, "cells": [CELL] * 7})):  # fmt: skip
        stage(name, result)
    return done


def test_an_interrupted_training_continues_with_the_first_missing_stage(calls: list[str], tmp_path: Path) -> None:
    cmd = TrainCmd(for_real="a.yaml", log=Path("log.csv"), out=tmp_path)
    calls.append("interrupt")
    assert train_for_real.train_for_real(cmd)["training"]["interrupted"]
    assert calls[1:] == ["plan", "training"]
    record = train_for_real.train_for_real(cmd)
    assert calls[3:] == ["training", "export", "robustness"]
    assert train_for_real.train_for_real(replace(cmd, max_time_s=9.0)) == record
    assert len(calls) == 6


def test_other_options_are_refused_in_a_folder_that_holds_a_training(calls: list[str], tmp_path: Path) -> None:
    train_for_real.train_for_real(TrainCmd(for_real="a.yaml", log=Path("log.csv"), out=tmp_path))
    with pytest.raises(ConfigError, match="holds a training with other options"):
        train_for_real.train_for_real(TrainCmd(for_real="b.yaml", log=Path("log.csv"), out=tmp_path))


def test_summary_has_ranges_corrections_success_and_the_worst_conditions(
    calls: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    cmd = TrainCmd(for_real="a.yaml", log=Path("log.csv"), out=tmp_path)
    assert cmd.run() == 0
    text = capsys.readouterr().out
    for part in ("0.95", "the task draws it already", "The gyro is wrong.", "90.0% of 48 flights", "25.0%", "a.onnx"):
        assert part in text
    assert text.count("50 ms late") == train_for_real.WORST
    assert replace(cmd, json=True).run() == 0
    assert json.loads(capsys.readouterr().out)["plan"] == PLAN


def test_an_exported_file_that_differs_fails(calls: list[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(train_for_real, "_export", lambda *_: {"a.onnx": False})
    assert TrainCmd(for_real="a.yaml", log=Path("log.csv"), out=tmp_path).run() == 1


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"for_real": "racing_quadrotor"}, "give --log LOG, or --preflight RESULT"),
        (
            {"for_real": "racing_quadrotor", "log": "a.csv", "preflight": "a.json"},
            "give --log LOG, or --preflight RESULT",
        ),
        ({"for_real": "racing_quadrotor", "log": "a.csv", "robot": "lmf2"}, "Leave --robot and --resume out"),
        ({"log": "a.csv"}, "--log: needs --for-real ROBOT"),
    ],
)
def test_wrong_requests_name_the_remedy(options: dict[str, str], message: str, tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match=message):
        aerial_gym.train(out=str(tmp_path / "run"), **options)  # type: ignore[arg-type]
    assert not (tmp_path / "run").exists()


def test_an_unusable_preflight_result_is_refused_by_its_own_name_before_anything_is_written(tmp_path: Path) -> None:
    (tmp_path / "mine.json").write_text("{}")
    with pytest.raises(ConfigError, match=r"mine\.json: is no unchanged result"):
        aerial_gym.train(out=tmp_path / "run", for_real="racing_quadrotor", preflight=tmp_path / "mine.json")
    assert not (tmp_path / "run").exists()
