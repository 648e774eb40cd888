"""The promise of the README: a hover policy from scratch within minutes on two CPU cores (``make test-slow``).
Environment i of 4 is environment i of 8,192, bit for bit.
"""

import json

import pytest

from aerial_gym.cli.main import main
from tests.unit.env_manager.test_batch_independence import FEW, RANDOMIZE, assert_same, build, fly, snapshot

pytestmark = pytest.mark.slow


@pytest.mark.parametrize(("trainer", "time_s"), [("ppo", "60"), ("rl_games", "172"), ("sample_factory", "172")])
def test_minutes_lead_to_a_hover_within_ten_centimetres(trainer, time_s, tmp_path, capsys) -> None:
    """Mean distance in the last second of 512 fresh starts below 0.10 m, and no crash."""
    run = str(tmp_path / "run")
    argv = ("--task", "position_setpoint_task", "--trainer", trainer, "--seed", "11", "--max-time-s", time_s)
    assert main(["train", *argv, "--out", run]) == 0
    capsys.readouterr()
    assert main(["evaluate", "--policy", run, "--num-envs", "512", "--json"]) == 0
    result = json.loads(capsys.readouterr().out)
    assert result["crash_rate"] == 0.0
    assert result["final_error_mean_m"] < 0.10


@pytest.mark.parametrize("backend", ["torch", "warp"])
@pytest.mark.parametrize(
    ("env", "robot"), [("env_with_obstacles", "base_quadrotor_with_imu"), ("empty_env", "tinyprop")]
)
def test_an_environment_is_the_same_among_few_and_8192(env: str, robot: str, backend: str) -> None:
    result = []
    for num_envs in (FEW, 8192):
        built = build(env, robot, num_envs, backend=backend, randomize=RANDOMIZE)
        fly(built)
        result.append(snapshot(built.gtd, slice(FEW)))
    assert_same(*result)
