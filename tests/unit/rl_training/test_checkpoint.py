"""Checkpoint files: whole or not there, checked when they are read, and the two that a run keeps."""

import errno
import logging
import os
import random
import signal
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

from aerial_gym import task_registry
from aerial_gym.config.storage import read_archive, write_archive
from aerial_gym.errors import ConfigError, StorageError, TrainingError
from aerial_gym.rl_training import load_settings, settings_for
from aerial_gym.rl_training.run.checkpoint_keeper import (
    CheckpointKeeper,
    interruptible,
    random_state,
    restore_random_state,
)
from aerial_gym.rl_training.run.progress import CURVE_COLUMNS, Progress, Report
from aerial_gym.rl_training.run.run_folder import RunFolder
from aerial_gym.rl_training.trainers.summaries import SafeEvents
from tests.refusals import assert_refused


def payload() -> dict[str, Any]:
    return {"model": {"weight": torch.arange(500.0)}, "run": {"env_steps": 3, "random": random_state()}}


def draws() -> tuple[float, float, float]:
    return float(torch.rand(())), float(np.random.rand()), random.random()


def full_disk(descriptor: int) -> None:
    raise OSError(errno.ENOSPC, "No space left on device")


def test_a_checkpoint_comes_back_with_the_random_states(tmp_path: Path) -> None:
    write_archive(tmp_path / "a.pth", payload())
    expected = draws()
    draws()
    result = read_archive(tmp_path / "a.pth", "checkpoint")
    torch.testing.assert_close(result["model"]["weight"], torch.arange(500.0), rtol=0.0, atol=0.0)
    restore_random_state(result["run"]["random"])
    assert draws() == expected


def test_bad_files_are_refused_without_the_advice_of_torch(tmp_path: Path) -> None:
    path = tmp_path / "a.pth"
    write_archive(path, payload())
    good = path.read_bytes()
    torch.save({"model": Path}, tmp_path / "code.pth")
    for name, content in (("torn", good[: len(good) // 2]), ("empty", b""), ("text", b"weights")):
        (tmp_path / name).write_bytes(content)
    for name in ("torn", "empty", "text", "code.pth", "missing"):
        with pytest.raises(ConfigError) as error:
            read_archive(tmp_path / name, "checkpoint")
        assert str(error.value).startswith(f"checkpoint {tmp_path / name}: ")
        assert "weights_only" not in str(error.value)
        assert "\n" not in str(error.value)
    path = tmp_path / "a.pth"
    write_archive(path, {"model": {"weight": torch.arange(8.0)}})
    good = path.read_bytes()
    # Each byte that belongs to the weights is damaged once: torch itself would load most of them.
    start = good.index(torch.arange(8.0).numpy().tobytes())
    for position in range(start, start + 32):
        path.write_bytes(good[:position] + bytes([good[position] ^ 1]) + good[position + 1 :])
        assert_refused(ConfigError, r"a.pth: is damaged, the check sum", read_archive, path, "checkpoint")


def test_a_full_disk_leaves_the_old_checkpoints_and_is_said(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    folder = RunFolder(tmp_path)
    kept = folder.write_checkpoint(10, payload())
    monkeypatch.setattr(os, "fsync", full_disk)
    assert_refused(StorageError, r"disk is full.*last checkpoint is .*10.pth", folder.write_checkpoint, 20, payload())
    assert list(folder.checkpoint_folder.iterdir()) == [kept]


def test_two_checkpoints_are_kept_and_a_damaged_one_gives_way_to_the_earlier_one(tmp_path, caplog) -> None:
    folder = RunFolder(tmp_path)
    assert folder.newest_readable_checkpoint() is None
    (tmp_path / "checkpoints").mkdir()
    (tmp_path / "checkpoints" / ".checkpoint_7.pth.partial").write_bytes(b"torn by a kill")
    first, second, third = (folder.write_checkpoint(steps, payload()) for steps in (9, 10, 11))
    assert folder.checkpoints() == [second, third]
    assert sorted(folder.checkpoint_folder.iterdir()) == [second, third]
    assert not first.exists()
    third.write_bytes(third.read_bytes()[:100])
    with caplog.at_level(logging.WARNING):
        result = folder.newest_readable_checkpoint()
    assert result[0] == second
    assert "damaged" in caplog.text
    assert third.with_name(third.name + ".damaged").exists()
    second.write_bytes(b"")
    assert_refused(ConfigError, "Start a new run in another --out", folder.newest_readable_checkpoint)


def test_a_resumed_curve_has_no_line_beyond_the_checkpoint_nor_a_torn_one(tmp_path: Path) -> None:
    curve = tmp_path / "curve.csv"
    curve.write_text(",".join(CURVE_COLUMNS) + "\r\n1.5,100,,,,9\r\n2.5,200,,,,9\r\n3.5,300,,,,9\r\n4.5,40")
    cfg = load_settings(settings_for("rl_games", "position_setpoint_task"))
    with Progress(cfg, curve, started=0.0, show=False, resumed_steps=200):
        pass
    assert curve.read_text().split() == [",".join(CURVE_COLUMNS), "1.5,100,,,,9", "2.5,200,,,,9"]


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_swallowed_signal_is_remembered(number: signal.Signals) -> None:
    before = signal.getsignal(number)
    with interruptible() as interruption:
        interruption.check()
        with pytest.raises(KeyboardInterrupt):
            signal.raise_signal(number)
        with pytest.raises(KeyboardInterrupt):
            interruption.check()
    assert signal.getsignal(number) is before


def test_a_signal_waits_for_what_cannot_be_left_half_done() -> None:
    done = []
    with interruptible() as interruption:

        def iterate() -> None:
            with interruption.defer():
                signal.raise_signal(signal.SIGTERM)
                done.append("the rest")

        with pytest.raises(KeyboardInterrupt):
            iterate()
        with pytest.raises(KeyboardInterrupt):
            signal.raise_signal(signal.SIGTERM)
    assert done == ["the rest"]


class EventsStub:
    def __init__(self) -> None:
        self.calls: list[object] = []

    def write_event(self, event: object) -> None:
        self.calls.append(event)
        if len(self.calls) == 2:
            full_disk(0)

    def flush(self) -> None:
        pass

    close = flush


def test_a_writer_of_summaries_outlives_a_full_disk_and_says_so() -> None:
    writer = EventsStub()
    events = SafeEvents(writer, "summaries")
    events.write_event(1)
    events.check()
    events.write_event(2)
    events.write_event(3)
    assert writer.calls == [1, 2]
    assert_refused(StorageError, "summaries: cannot be written, the disk is full", events.check)


def test_a_training_that_diverged_ends_and_keeps_what_was_good(tmp_path: Path) -> None:
    cfg, folder = load_settings(settings_for("rl_games", "position_setpoint_task")), RunFolder(tmp_path)
    task = task_registry.make_task("position_setpoint_task", num_envs=2, device="cpu")
    keeper = CheckpointKeeper(cfg, folder, task, resumed=None)
    keeper.save({"model": {"weight": torch.ones(3)}}, env_steps=5)
    good = folder.last_checkpoint()
    told = f"diverged: weight is NaN or infinite. The last checkpoint before that is {good}"
    with pytest.raises(TrainingError, match=told):
        keeper.save({"model": {"weight": torch.tensor([1.0, float("nan")])}}, env_steps=9)
    assert folder.checkpoints() == [good]


def test_a_session_keeps_the_curves_of_one_of_the_same_second(tmp_path: Path) -> None:
    while time.time() % 1.0 > 0.5:
        time.sleep(0.05)
    now = int(time.time())
    before = tmp_path / "ppo" / "summaries" / f"events.out.tfevents.{now}.host"
    before.parent.mkdir(parents=True)
    before.touch()
    RunFolder(tmp_path).add_session(load_settings(settings_for("ppo", "position_setpoint_task")), "cpu")
    assert time.time() >= now + 1
    assert (tmp_path / "versions.json").exists()


@pytest.mark.parametrize("show", [True, False])
def test_lines_say_how_far_it_is(show: bool, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    cfg = load_settings(settings_for("rl_games", "position_setpoint_task"))
    cfg = replace(cfg, max_env_steps=1000, max_time_s=None)
    reports = [Report(env_steps=steps, episode_return=12.6, episode_length=50.0) for steps in (100, 200, 1000)]
    with Progress(cfg, tmp_path / "curve.csv", started=time.perf_counter(), show=show) as progress:
        ends = [progress.update(report) for report in reports]
    assert ends == [False, False, True]
    lines = capsys.readouterr().err.splitlines()
    assert len(lines) == (2 if show else 0)
    if show:
        assert lines[0].startswith("rl_games  10%  100 steps  return 13  ")
        assert lines[1].startswith("rl_games 100%  1,000 steps  return 13  ")
