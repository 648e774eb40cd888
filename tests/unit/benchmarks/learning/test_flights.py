"""Flights that are drawn: they end where their episodes do, and stand about their targets."""

from pathlib import Path

import pytest
import torch

from aerial_gym.cli.main import main as aerial_gym
from benchmarks.learning import flights


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> str:
    out = tmp_path_factory.mktemp("run") / "hover"
    given = ["--max-env-steps", "4096", "--num-envs", "64", "--device", "cpu", "--out", str(out)]
    assert aerial_gym(["train", "--task", "position_setpoint_task", *given]) == 0
    return str(out)


def test_flights_end_with_their_episodes(run: str) -> None:
    result = flights.fly(run, 8)
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
