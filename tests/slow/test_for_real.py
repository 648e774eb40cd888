"""The link of the hidden vehicle, its log, and a whole training for a real vehicle."""

import json
from pathlib import Path

import pytest
import torch

from aerial_gym.cli.main import main
from benchmarks.for_real.vehicle import JITTER_S, LATENCY_S, LinkFirmwareEnv, fly_log, make_hidden_task

pytestmark = pytest.mark.slow
RESULT = Path(__file__).parents[2] / "benchmarks" / "for_real" / "preflight.json"


def test_motors_react_after_the_latency_and_within_the_width_of_the_jitter() -> None:
    """A command for more thrust moves the motors of each environment 35 to 46 ms later, in a physics step of 1 ms."""
    with make_hidden_task(4, seed=3) as task:
        env = task.env
        assert isinstance(env, LinkFirmwareEnv)
        env.reset()
        for _ in range(20):
            env.step(torch.zeros(4, 4))
        sent, before = env._now, env.group.replies["pulses"].copy()
        reacted = torch.full((4,), -1)

        def watch(step: int) -> None:
            moved = torch.from_numpy(env.group.replies["pulses"] - before)[:, :4].amin(dim=-1) > 100.0
            reacted[moved & (reacted < 0)] = step - sent

        env.on_physics_step = watch
        for _ in range(6):
            env.step(torch.tensor([[1.0, 0.0, 0.0, 0.0]]).expand(4, 4))
        late = 1e-3 * reacted.double()
        assert (late >= LATENCY_S - 1e-3).all()
        assert (late <= LATENCY_S + 12.0**0.5 * JITTER_S + 3e-3).all()


def test_the_log_of_the_hidden_vehicle_is_the_same_twice(tmp_path: Path) -> None:
    for name in "ab":
        fly_log(tmp_path / name, seed=1, duration=2.0)
    assert (tmp_path / "a").read_bytes() == (tmp_path / "b").read_bytes()


def test_a_training_for_a_real_vehicle_runs_all_stages(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    options = ["--task", "position_setpoint_task", "--device", "cpu", "--num-envs", "64", "--max-env-steps", "4096"]
    given = [
        "train",
        "--for-real",
        "racing_quadrotor",
        "--preflight",
        str(RESULT),
        "--out",
        str(tmp_path / "run"),
        "--json",
    ]
    assert main([*given, *options]) == 0
    record = json.loads(capsys.readouterr().out.splitlines()[-1])
    assert record["robustness"]["complete"]
    assert record["plan"]["verdict"] == "contradicted"
    assert all(record["export"].values())
    assert "preflight" in json.loads((tmp_path / "run" / "export" / "policy.json").read_text())
