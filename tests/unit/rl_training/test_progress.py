"""The progress of a training as lines, where stderr is no terminal."""

import time
from dataclasses import replace
from pathlib import Path

import pytest

from aerial_gym.rl_training import load_settings, settings_for
from aerial_gym.rl_training.run.progress import Progress, Report


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
