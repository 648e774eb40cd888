"""What a session leaves in a run folder, and the progress of a training as lines."""

import time
from dataclasses import replace
from pathlib import Path

import pytest

from aerial_gym.rl_training import load_settings, settings_for
from aerial_gym.rl_training.run.progress import Progress, Report
from aerial_gym.rl_training.run.run_folder import RunFolder


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
