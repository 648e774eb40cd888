"""Benchmarks of learning: flights that end with their episodes, and curves of trainings."""

import json
from pathlib import Path

import pytest
import torch

from aerial_gym.cli.main import main as aerial_gym
from benchmarks.learning import curves, flights


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


def test_flights_are_drawn_in_a_row_for_each_run(run: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(flights, "SHOWN", 2)
    flights.main([str(tmp_path / "out.png"), f"A={run}", f"B={run}", "--flights", "3"])
    assert (tmp_path / "out.png").read_bytes().startswith(b"\x89PNG")


ROWS = """time_s,env_steps,reward_per_step,episode_return,episode_length,env_steps_per_s
1.0,1000000,,,,0
2.0,2000000,0.1,5.5,50,10
3.0,4000000,0.1,7.5,50,10
"""


def test_curves_begin_with_the_first_episode_that_ended_and_have_a_panel(tmp_path: Path) -> None:
    (tmp_path / "curve.csv").write_text(ROWS)
    assert curves.run_curve(tmp_path) == ([2.0, 4.0], [5.5, 7.5])
    row = {"training_s": 1.5, "env_steps": 10, "final_error_mean_m": 0.2}
    lines = ({**row, "final_error_mean_m": None}, row, {"steps_per_s": 9.0}, row)
    file = tmp_path / "cpu.jsonl"
    file.write_text("\n".join(map(json.dumps, lines)))
    assert curves.error_curves(file) == [([1.5], [0.2]), ([1.5], [0.2])]
    curves.main(str(tmp_path / "out.png"), f"CPU={file}", *(f"{name}={tmp_path} {tmp_path}" for name in "abc"))
    assert (tmp_path / "out.png").read_bytes().startswith(b"\x89PNG")


def test_a_return_far_from_all_others_does_not_set_the_scale() -> None:
    rising = [-20.0 + 0.1 * step for step in range(401)]
    assert curves.return_span(rising) == (rising[0], rising[-1])
    assert curves.return_span([*rising, -2400.0]) == (rising[0], rising[-1])
