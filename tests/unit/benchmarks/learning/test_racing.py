"""Benchmarks of learning: the racing protocol, flights that end with their episodes, and curves of trainings."""

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path

import pytest
import torch

from aerial_gym import Task, task_registry
from aerial_gym.cli.main import main as aerial_gym
from aerial_gym.rl_training import load_settings, settings_for
from benchmarks.learning import flights, run_curves
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


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> str:
    out = tmp_path_factory.mktemp("run") / "hover"
    given = ["--max-env-steps", "4096", "--num-envs", "64", "--device", "cpu", "--out", str(out)]
    assert aerial_gym(["train", "--task", "position_setpoint_task", *given]) == 0
    return str(out)


def test_flights_end_with_their_episodes(run: str) -> None:
    result = flights.fly_policy(run, 8)
    known = ~result.offset[..., 0].isnan()
    assert bool((known[:, 1:] <= known[:, :-1]).all())
    assert torch.equal(known, ~result.speed.isnan())
    assert result.dt == pytest.approx(0.01)
    assert bool((known.sum(1)[result.crashed] < 500).all())
    assert float(result.offset[:, 0].norm(dim=-1).max()) < 8.0


def test_a_row_for_each_run(run: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(flights, "SHOWN", 2)
    flights.main([str(tmp_path / "out.png"), f"A={run}", f"B={run}", "--flights", "3"])
    assert (tmp_path / "out.png").read_bytes().startswith(b"\x89PNG")


ROWS = """time_s,env_steps,reward_per_step,episode_return,episode_length,env_steps_per_s
1.0,1000000,,,,0
2.0,2000000,0.1,5.5,50,10
3.0,4000000,0.1,7.5,50,10
"""


def test_a_curve_begins_with_the_first_episode_that_ended_and_has_a_panel(tmp_path: Path) -> None:
    (tmp_path / "curve.csv").write_text(ROWS)
    assert run_curves.run_curve(tmp_path) == ([2.0, 4.0], [5.5, 7.5])
    (tmp_path / "curve.csv").write_text(ROWS)
    run_curves.main(str(tmp_path / "out.png"), *(f"{name}={tmp_path} {tmp_path}" for name in "abcd"))
    assert (tmp_path / "out.png").read_bytes().startswith(b"\x89PNG")


def test_a_return_far_from_all_others_does_not_set_the_scale() -> None:
    rising = [-20.0 + 0.1 * step for step in range(401)]
    assert run_curves.return_span(rising) == (rising[0], rising[-1])
    assert run_curves.return_span([*rising, -2400.0]) == (rising[0], rising[-1])
