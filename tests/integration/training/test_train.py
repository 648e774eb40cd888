"""All trainers through the command: run folder, checkpoints, TensorBoard, resume, evaluation."""

import csv
import errno
import json
import os
import signal
from dataclasses import replace
from pathlib import Path

import pytest
import torch

from aerial_gym.cli.main import main
from aerial_gym.cli.record import FlightRecorder
from aerial_gym.config import dump_yaml
from aerial_gym.config.storage import read_archive, write_archive
from aerial_gym.errors import TrainingError
from aerial_gym.export.layout import Layout
from aerial_gym.rl_training import TrainingCfg, load_settings, settings_for
from aerial_gym.rl_training.run.checkpoint_keeper import CheckpointKeeper
from aerial_gym.rl_training.run.progress import Progress, Report
from aerial_gym.rl_training.run.run_folder import RunFolder
from aerial_gym.robots import ROBOTS
from tests.repetitions import rare_values
from tests.unit.sim2real.logs.foxglove_files import read_and_check

pytest.importorskip("rl_games", reason="rl-games is not installed: pip install 'aerial-gym[rl-games]'")
pytest.importorskip(
    "sample_factory", reason="Sample Factory is not installed: pip install 'aerial-gym[sample-factory]'"
)


def train(out: Path, trainer: str, *more: str) -> int:
    limits = ("--num-envs", "128", "--device", "cpu", "--seed", "3", "--max-env-steps", "10000", "--max-time-s", "40")
    return main(["train", "--trainer", trainer, "--out", str(out), *limits, "--json", *more])


@pytest.mark.parametrize("trainer", rare_values(["ppo", "apg", "rl_games", "sample_factory"], ("apg", "rl_games")))
def test_a_training_leaves_a_run_that_resumes_and_evaluates(trainer, tmp_path, capsys, monkeypatch) -> None:
    """``rl_games`` trains, goes on and is evaluated always in the navigation below."""
    out = tmp_path / "run"
    assert train(out, trainer) == 0
    first = json.loads(capsys.readouterr().out)
    assert first["env_steps"] >= 10000
    assert Path(first["checkpoint"]).is_file()
    assert list(out.rglob("events.out.tfevents*"))
    for name in ("config.yaml", "versions.json", "curve.csv", "result.json"):
        assert (out / name).is_file(), name

    status = main(["train", "--out", str(out), "--resume", "--max-env-steps", "20000", "--max-time-s", "40", "--json"])
    second = json.loads(capsys.readouterr().out)
    assert status == 0
    assert second["env_steps"] >= 20000
    with (out / "curve.csv").open() as file:
        steps = [int(row["env_steps"]) for row in csv.DictReader(file)]
    assert steps == sorted(steps)

    dump = tmp_path / "dump.csv"
    assert main(["evaluate", "--policy", str(out), "--num-envs", "16", "--json", "--watch", str(dump)]) == 0
    assert len(dump.read_text().splitlines()) == 1  # the columns: every row was finite
    results = json.loads(capsys.readouterr().out)
    assert results["num_starts"] == 16
    assert 0.0 <= results["success_rate"] <= 1.0
    assert main(["evaluate", "--policy", str(out), "--device", "tpu9"]) == 2
    assert "device 'tpu9': must be auto, cpu" in capsys.readouterr().err

    table = tmp_path / "flights.csv"
    assert main(["play", "--policy", str(out), "--num-steps", "5", "--out", str(table)]) == 0
    assert len(table.read_text().splitlines()) == 1 + 6 * 4
    stop_after_three_steps(monkeypatch)
    film, recording = tmp_path / "film.webp", tmp_path / "flights.mcap"
    outputs = ("--out", str(table), "--video", str(film), "--record", str(recording))
    assert main(["play", "--policy", str(out), "--num-steps", "500", *outputs]) == 1
    assert "interrupted" in capsys.readouterr().err
    rows = list(csv.DictReader(table.open()))
    assert len(rows) == 3 * 4
    state = read_and_check(recording)["/env_2/state"]
    assert [(at, one["p_x"]) for at, one in state] == [
        (round(1e9 * float(row["t"])), float(row["p_x"])) for row in rows if row["env"] == "2"
    ]
    assert film.stat().st_size > 0


def stop_after_three_steps(monkeypatch: pytest.MonkeyPatch) -> None:
    """Press Ctrl-C when the third step of a recording is written."""
    write_step = FlightRecorder.write_step

    def write_and_stop(recorder: FlightRecorder, begins: torch.Tensor) -> None:
        write_step(recorder, begins)
        if recorder._step == 3:
            raise KeyboardInterrupt

    monkeypatch.setattr(FlightRecorder, "write_step", write_and_stop)


def test_a_navigation_training_resumes_at_its_level_and_its_evaluation_tells_how_flights_end(tmp_path, capsys) -> None:
    out, robot = tmp_path / "run", tmp_path / "robot.yaml"
    robot.write_text(dump_yaml(replace(ROBOTS.get("base_quadrotor"), sensors=("depth_camera_64",))), encoding="utf-8")
    limits = ("--max-env-steps", "512", "--max-time-s", "40", "--json")
    where = ("--out", str(out), "--num-envs", "8", "--device", "cpu", "--seed", "3", "--robot", str(robot))
    assert main(["train", "--task", "navigation_task", "--trainer", "rl_games", *where, *limits]) == 0
    assert json.loads(capsys.readouterr().out)["env_steps"] >= 512
    last = RunFolder(out).last_checkpoint()
    payload = read_archive(last, "checkpoint")
    kept = payload["run"]["curriculum"]
    assert kept["level"] == 15
    assert kept["finished"] > 0
    payload["run"]["curriculum"] = kept | {"level": 21}
    write_archive(last, payload)
    assert main(["train", "--out", str(out), "--resume", "--max-env-steps", "768", "--max-time-s", "40"]) == 0
    resumed = read_archive(RunFolder(out).last_checkpoint(), "checkpoint")["run"]["curriculum"]
    assert resumed["level"] == 21
    assert resumed["finished"] >= kept["finished"]

    capsys.readouterr()
    assert main(["evaluate", "--policy", str(out), "--num-envs", "2", "--level", "20", "--json"]) == 0
    results = json.loads(capsys.readouterr().out)
    assert results["success_rate"] + results["crash_rate"] + results["timeout_rate"] == pytest.approx(1.0)
    assert results["success_radius_m"] == 1.0
    assert main(["evaluate", "--policy", str(out), "--num-envs", "2", "--level", "50"]) == 2
    assert "must lie in 15 to 44" in capsys.readouterr().err


def test_a_run_is_neither_overwritten_nor_resumed_from_nothing(tmp_path, capsys) -> None:
    (tmp_path / "config.yaml").write_text("")
    assert train(tmp_path, "rl_games") == 2
    assert "holds a run already" in capsys.readouterr().err
    assert main(["train", "--out", str(tmp_path / "new"), "--resume"]) == 2
    assert "holds no run" in capsys.readouterr().err


@pytest.mark.parametrize(("more", "message"), [
    (("--trainer", "rlgames"), "no trainer 'rlgames'. Did you mean 'rl_games'? Known: apg, distill, other_library, ppo"),
    (("--task", "hover"), "no task 'hover'"),
    (("--robot", "tinyprp"), "no robot 'tinyprp'"),
    (("--num-envs", "0"), "num_envs"),
    (("--trainer", "rl_games", "--config", str(settings_for("ppo", "tracking_task"))), "are of ppo. Leave one out"),
    (("--task", "navigation_task", "--encoder", "collision_40x24", "--device", "cpu"), "Choose the robot of its"),
    (("--set", "ppo.horizn=8", "--set", "robot.body.mas=1", "--device", "cpu"), "2 faults:\n  ppo.horizn: no"),
    (("--set", "task.num_envs=8", "--device", "cpu"), "task.num_envs: it is given as num_envs already"),
])  # fmt: skip
def test_wrong_trainings_end_with_status_2_and_leave_nothing(more, message, tmp_path, capsys) -> None:
    out = tmp_path / "run"
    assert main(["train", "--out", str(out), *more]) == 2
    assert message in capsys.readouterr().err
    assert not out.exists()


def test_a_run_that_was_killed_before_its_first_checkpoint_starts_anew(tmp_path, caplog) -> None:
    cfg = load_settings(settings_for("rl_games", "position_setpoint_task"))
    RunFolder(tmp_path).create(replace(cfg, num_envs=128, device="cpu"))
    assert main(["train", "--out", str(tmp_path), "--resume", "--max-env-steps", "1", "--max-time-s", "40"]) == 0
    assert "ended before its first checkpoint; the training starts anew in the same folder" in caplog.text
    assert RunFolder(tmp_path).newest_readable_checkpoint() is not None


@pytest.mark.parametrize("trainer", ["ppo", "rl_games", "sample_factory"])
def test_sigterm_saves_and_a_full_disk_ends_with_a_sentence(trainer, tmp_path, capsys, monkeypatch) -> None:
    out, update = tmp_path / "run", Progress.update
    updates = []

    def and_then_signal(self: Progress, report: Report) -> bool:
        updates.append(report.env_steps)
        if len(updates) == 2:
            signal.raise_signal(signal.SIGTERM)
        return update(self, report)

    monkeypatch.setattr(Progress, "update", and_then_signal)
    assert train(out, trainer) == 1
    result = json.loads(capsys.readouterr().out)
    assert result["interrupted"]
    saved = RunFolder(out).newest_readable_checkpoint()
    assert saved[1]["run"]["env_steps"] >= updates[-1]

    def full(descriptor: int) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(CheckpointKeeper, "due", property(lambda self: monkeypatch.setattr(os, "fsync", full) or True))
    assert main(["train", "--out", str(out), "--resume", "--max-env-steps", "20000", "--max-time-s", "40"]) == 1
    said = capsys.readouterr().err.strip().splitlines()[-1]
    assert "disk is full" in said
    assert f"The last checkpoint is {saved[0]}" in said


@pytest.mark.parametrize(("more", "message"), [
    (("--task", "tracking_task"), "--task tracking_task: the run in {out} is of position_setpoint_task"),
    (("--trainer", "rl_games"), "--trainer rl_games: the run in {out} is of ppo"),
])  # fmt: skip
def test_a_resumed_run_refuses_another_task_and_trainer(more, message, tmp_path, capsys) -> None:
    RunFolder(tmp_path).create(load_settings(settings_for("ppo", "position_setpoint_task", device="cpu")))
    again = ("train", "--out", str(tmp_path), "--resume", "--num-envs", "7")
    assert main([*again, *more]) == 2
    assert message.format(out=tmp_path) in capsys.readouterr().err
    assert main([*again, "--task", "position_setpoint_task", "--trainer", "ppo"]) == 2
    assert "--num-envs: a resumed run keeps its own" in capsys.readouterr().err


@pytest.mark.parametrize("trainer", ["ppo", "rl_games"])
def test_a_resumed_run_refuses_a_checkpoint_of_another_network(trainer, tmp_path, capsys) -> None:
    folder = RunFolder(tmp_path)
    cfg = load_settings(settings_for(trainer, "position_setpoint_task"))
    folder.create(replace(cfg, num_envs=128, device="cpu"))
    path = folder.write_checkpoint(5, {"model": {}, "run": {"trainer": trainer, "env_steps": 5}})
    assert main(["train", "--out", str(tmp_path), "--resume", "--max-env-steps", "1"]) == 2
    assert f"checkpoint {path}: does not fit the settings of its run" in capsys.readouterr().err


@pytest.fixture
def trainings(monkeypatch: pytest.MonkeyPatch) -> list[TrainingCfg]:
    """The settings of trainings, which end at once."""
    seen: list[TrainingCfg] = []

    def train(cfg: TrainingCfg, out: Path, **_: object) -> None:
        seen.append(cfg)
        raise TrainingError("stopped here")

    monkeypatch.setattr("aerial_gym.rl_training.training.train", train)
    return seen


@pytest.mark.parametrize(("given", "limits"), [
    ((), (120.0, None)),
    (("--max-env-steps", "5000"), (None, 5000)),
    (("--max-time-s", "7"), (7.0, None)),
    (("--max-env-steps", "5000", "--max-time-s", "7"), (7.0, 5000)),
])  # fmt: skip
def test_limits_on_the_command_line_replace_those_of_the_settings(given, limits, tmp_path, trainings) -> None:
    settings = tmp_path / "settings.yaml"
    cfg = load_settings(settings_for("ppo", "position_setpoint_task", device="cpu"))
    settings.write_text(dump_yaml(replace(cfg, max_time_s=120.0, max_env_steps=None)))
    assert main(["train", "--config", str(settings), "--out", str(tmp_path / "run"), *given]) != 0
    assert (trainings[0].max_time_s, trainings[0].max_env_steps) == limits


def test_a_partial_training_file_extends_the_settings_of_its_task(tmp_path, trainings) -> None:
    file, out = tmp_path / "partial.yaml", str(tmp_path / "run")
    file.write_text("task: racing_task\nnum_envs: 64\nppo: {learning_rate: 3.0e-4}\n")
    main(["train", "--config", str(file), "--device", "cpu", "--out", out, "--set", "ppo.gae_lambda=0.9"])
    own = load_settings(settings_for("ppo", "racing_task", device="cpu"))
    ppo = replace(own.ppo, learning_rate=3e-4, gae_lambda=0.9)
    assert trainings == [replace(own, num_envs=64, device="cpu", ppo=ppo)]
    file.write_text("trainer: apg\nappg: {}\n")
    assert main(["train", "--config", str(file), "--out", out]) == 2


def test_a_complete_training_file_stands_alone_and_keeps_its_task(tmp_path, trainings) -> None:
    file, cfg = tmp_path / "whole.yaml", load_settings(settings_for("ppo", "racing_task"))
    file.write_text(dump_yaml(cfg))
    main(["train", "--config", str(file), "--out", str(tmp_path / "run")])
    main(["train", "--config", str(file), "--out", str(tmp_path / "run"), "--task", "tracking_task"])
    assert trainings == [cfg, replace(cfg, task="tracking_task")]


def test_settings_are_stored_with_the_run_and_hold_in_its_evaluation(tmp_path, capsys) -> None:
    out, heavy = tmp_path / "run", ("--set", "robot.body.mass=0.3", "--set", "ppo.horizon=16")
    limits = ("--num-envs", "32", "--device", "cpu", "--max-env-steps", "512", "--set", "task.episode_len_steps=20")
    assert main(["train", "--out", str(out), *limits, *heavy]) == 0
    assert f"curves: tensorboard --logdir {out}" in capsys.readouterr().out
    cfg = load_settings(out / "config.yaml")
    assert cfg.settings == ("task.episode_len_steps=20", "robot.body.mass=0.3")
    assert cfg.ppo.horizon == 16
    assert main(["train", "--out", str(out), "--resume", *heavy]) == 2
    assert "--set: a resumed run keeps its own settings" in capsys.readouterr().err
    changed = ("--num-envs", "4", "--json", "--set", "task.rewards.near.weight=0")
    assert main(["evaluate", "--policy", str(out), *changed]) == 0
    result = json.loads(capsys.readouterr().out)
    assert (result["episode_s"], result["reward_terms"]["near"]) == (0.2, 0.0)
    assert result["ended_by"]["time_out"] == 1.0
    assert main(["export", "--policy", str(out), "--to", "torchscript", "--no-check"]) == 0
    assert Layout.read(out / "export").settings == cfg.settings
    capsys.readouterr()
    assert main(["play", "--policy", str(out), "--num-envs", "1", "--num-steps", "1", "--set", "env.bonds=1"]) == 2
    assert "env.bonds: no setting 'bonds' here" in capsys.readouterr().err
