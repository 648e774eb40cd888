"""The protocol of the racing benchmark: what is printed of 20 runs, and of more."""

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path

import pytest

from aerial_gym import Task, task_registry
from aerial_gym.rl_training import load_settings, settings_for
from benchmarks.learning.racing import BenchRacing, _line
from tests.unit.export.policies import random_policy


def make_short(make: Callable[..., Task], level: str, **options: int | str) -> Task:
    """Make a task, with the kernels of whole episodes, that is evaluated for 1.5 s: random weights crash much earlier."""
    task = make(level, **options)
    task.cfg = replace(task.cfg, episode_len_steps=150)
    return task


@pytest.fixture
def bench(monkeypatch: pytest.MonkeyPatch) -> BenchRacing:
    result = (random_policy(56), load_settings(settings_for("ppo", "racing_task")))
    monkeypatch.setattr("aerial_gym.rl_training.policies.load.load_policy", lambda source, device: result)
    monkeypatch.setattr(task_registry, "make_task", partial(make_short, task_registry.make_task))
    return BenchRacing(policy=Path("nowhere"), levels=("racing_task",), num_envs=21)


@pytest.mark.slow
def test_a_level_is_flown_20_times_and_as_often_as_wanted(bench, capsys) -> None:
    """Random weights complete nothing: of 20 runs 0 to 1 - 0.025^(1/20) = 16.8 % (Clopper and Pearson)."""
    assert bench.run() == 0
    header, _, twenty, more = capsys.readouterr().out.splitlines()
    assert header == "| level | runs | complete | 95 % interval | gates passed | crashed | time of a complete run |"
    assert twenty == "| racing_task | 20 | 0 | 0.0% to 16.8% | 0.00 | 100.0% | - |"
    assert more == "| racing_task | 21 | 0 | 0.0% to 16.1% | 0.00 | 100.0% | - |"


def test_a_row_tells_share_and_time() -> None:
    row = {"level": "level2", "runs": 20, "complete": 19, "complete_low": 0.751, "complete_high": 0.999}
    row |= {"gates_passed_mean": 3.9, "crash_rate": 0.05, "lap_time_mean_s": 4.125}
    assert _line(row) == "| level2 | 20 | 19 | 75.1% to 99.9% | 3.90 | 5.0% | 4.12 s |"
