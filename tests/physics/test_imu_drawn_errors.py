"""What a reset draws of the robot's own errors of inertial sensors, seen in what the IMU measures. ``measured = R^T
(true + bias)`` with R from sensors to body, by the draws of each environment. The effects do not change the flight:
what is true stands in the same simulation without draws. Tolerances are float32 round-off: 8 ulp of 16 m/s²."""

from dataclasses import replace
from pathlib import Path

import pytest
import torch
from torch import Tensor

from aerial_gym.config.randomize import RandomizeCfg
from aerial_gym.config.sensor_mount import SensorMountCfg
from aerial_gym.env_manager import EnvManager
from aerial_gym.robots import ROBOTS
from tests.builders import simulation

ROUND_OFF = 8.0 * 2.0**-20
AXES = ("ax", "ay", "az", "gx", "gy", "gz")
TURNS = ("roll", "pitch", "yaw")
BIAS = {f"effects.imu_bias.{name}": RandomizeCfg(how="value", low=-0.5, high=1.0) for name in AXES}
TURN = {f"effects.imu_misalignment.{name}": RandomizeCfg(how="value", low=-0.1, high=0.4) for name in TURNS}
BIAS_THEN_TURN = BIAS | TURN
IDEAL = """
summary: without errors
accel_noise_density: [0.0, 0.0, 0.0]
gyro_noise_density: [0.0, 0.0, 0.0]
accel_bias_walk: [0.0, 0.0, 0.0]
gyro_bias_walk: [0.0, 0.0, 0.0]
accel_initial_bias: [0.0, 0.0, 0.0]
gyro_initial_bias: [0.0, 0.0, 0.0]
accel_range: 1000.0
gyro_range: 1000.0
source: test
"""


@pytest.fixture
def ideal(tmp_path: Path) -> str:
    path = tmp_path / "ideal.yaml"
    path.write_text(IDEAL)
    return str(path)


def build(
    sensor: str, num_envs: int, randomize: dict[str, RandomizeCfg], *, backend: str = "warp", effects=None
) -> EnvManager:
    robot = replace(ROBOTS.get("base_quadrotor"), sensors=(SensorMountCfg(sensor=sensor, name="imu"),))
    if effects:
        robot = replace(robot, effects=effects, effects_source="test")
    env = simulation(robot, "lee_velocity_control", num_envs=num_envs, seed=2, randomize=randomize, backend=backend)
    env.reset()
    return env


def fly(env: EnvManager, steps: int = 4) -> Tensor:
    number, results = torch.arange(env.num_envs), [env.gtd["imu_measurement"].clone()]
    for k in range(steps):
        env.step(torch.tensor([[0.3, -0.2, 0.1, 0.5]]).expand(env.num_envs, 4))
        results.append(env.gtd["imu_measurement"].clone())
        env.reset(number % 3 == k)
        results.append(env.gtd["imu_measurement"].clone())
    return torch.stack(results)


def read_draws(env: EnvManager, effect: str, names: tuple[str, ...]) -> Tensor:
    return torch.stack([env.draws()[f"effects.{effect}.{name}"] for name in names], dim=-1).double()


def rotation(roll: Tensor, pitch: Tensor, yaw: Tensor) -> Tensor:
    one, zero = torch.ones_like(roll), torch.zeros_like(roll)

    def matrix(*entries: Tensor) -> Tensor:
        return torch.stack(entries, dim=-1).view(-1, 3, 3)

    about_z = matrix(yaw.cos(), -yaw.sin(), zero, yaw.sin(), yaw.cos(), zero, zero, zero, one)
    about_y = matrix(pitch.cos(), zero, pitch.sin(), zero, one, zero, -pitch.sin(), zero, pitch.cos())
    about_x = matrix(one, zero, zero, zero, roll.cos(), -roll.sin(), zero, roll.sin(), roll.cos())
    return about_z @ about_y @ about_x


def rotate_inverse(turn: Tensor, vector: Tensor) -> Tensor:
    return (rotation(*turn.unbind(-1)).transpose(1, 2) @ vector.unsqueeze(-1)).squeeze(-1)


def close(result: Tensor, expected: Tensor) -> None:
    torch.testing.assert_close(result.double(), expected, rtol=0.0, atol=ROUND_OFF)


@pytest.mark.parametrize("backend", ["warp", "torch"])
def test_each_imu_measures_what_its_environment_has_drawn(ideal: str, backend: str) -> None:
    """``R^T (f + b)`` and ``R^T (w + b)``, at rest and in flight, in environments that were reset on the way or not."""
    env, plain = (build(ideal, 8, cfg, backend=backend) for cfg in (BIAS_THEN_TURN, {}))
    for steps in (0, 4):
        true, results = fly(plain, steps)[-1].double(), fly(env, steps)[-1]
        bias, turn = read_draws(env, "imu_bias", AXES), read_draws(env, "imu_misalignment", TURNS)
        assert (bias.std(0) > 0.2).all()
        close(results[:, :3], rotate_inverse(turn, true[:, :3] + bias[:, :3]))
        close(results[:, 3:], rotate_inverse(turn, true[:, 3:] + bias[:, 3:]))


def test_effects_act_in_their_order(ideal: str) -> None:
    """Turned first, then biased: ``R^T f + b``."""
    env, plain = build(ideal, 4, TURN | BIAS), build(ideal, 4, {})
    true, results = fly(plain)[-1].double(), fly(env)[-1]
    bias, turn = read_draws(env, "imu_bias", AXES), read_draws(env, "imu_misalignment", TURNS)
    close(results[:, :3], rotate_inverse(turn, true[:, :3]) + bias[:, :3])


def test_a_drawn_offset_adds_to_the_declared_bias(ideal: str) -> None:
    """A declared 0.2 m/s² and a drawn +3 m/s² along body z: 3.2 m/s² too much; the declared gyro bias stays."""
    effects = {"imu_bias": dict(zip(AXES, (0.0, 0.0, 0.2, 0.0, -0.1, 0.0), strict=True))}
    cfg = {"effects.imu_bias.az": RandomizeCfg(how="offset", low=3.0, high=3.0)}
    env, plain = build(ideal, 3, cfg, effects=effects), build(ideal, 3, {})
    true = fly(plain)[-1].double()
    close(fly(env)[-1], true + torch.tensor([0.0, 0.0, 3.2, 0.0, -0.1, 0.0], dtype=torch.float64))


def test_a_reset_by_mask_leaves_other_rows(ideal: str) -> None:
    one, other = (build(ideal, 6, BIAS_THEN_TURN) for _ in range(2))
    mask = torch.tensor([True, False, False, True, False, False])
    before = one.gtd["imu_measurement"].clone()
    one.reset(mask)
    assert torch.equal(one.gtd["imu_measurement"][~mask], before[~mask])
    assert (one.gtd["imu_measurement"][mask] != before[mask]).any(-1).all()
    for env in (one, other):
        env.step(torch.zeros(6, 4))
    assert torch.equal(one.gtd["imu_measurement"][~mask], other.gtd["imu_measurement"][~mask])


def test_a_loaded_state_measures_on_the_same(ideal: str) -> None:
    flown = build(ideal, 4, BIAS_THEN_TURN)
    fly(flown)
    state = flown.save_state()
    expected = fly(flown)
    new = build(ideal, 4, BIAS_THEN_TURN)
    for env in (flown, new):
        env.load_state(state)
        assert torch.equal(fly(env), expected)


def test_parameters_that_were_written_are_measured(ideal: str) -> None:
    effects = {"imu_bias": dict.fromkeys(AXES, 0.0)}
    env, plain = build(ideal, 3, {}, effects=effects), build(ideal, 3, {})
    bias = torch.arange(18.0).view(3, 6) * 0.05
    env.gtd["effect_imu_bias"][:] = bias
    env.robot_manager.refresh_model()
    close(fly(env)[-1], fly(plain)[-1].double() + bias.double())


def test_a_robot_without_such_effects_has_no_rows(ideal: str) -> None:
    assert "robot_imu_errors" not in build(ideal, 2, {"body.mass": RandomizeCfg(low=0.9, high=1.1)}).gtd
