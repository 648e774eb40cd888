"""Obstacles that move: straight lines, exact rotations, paths, bounds, and who is left alone."""

from dataclasses import replace
from math import sqrt

import pytest
import torch

from aerial_gym.assets import PARKED_Z, AssetManager
from aerial_gym.config import build
from aerial_gym.config.environment import AssetCfg, MotionCfg, ShapeCfg
from aerial_gym.env_manager import EnvManager
from aerial_gym.errors import ConfigError, ShapeError
from aerial_gym.math.quaternion import quat_exp, quat_multiply
from aerial_gym.registry import GlobalTensorDictionary
from tests.builders import simulation
from tests.unit.assets.managers import begin, box_environment, every, make_manager, move_obstacles

BALL = AssetCfg(
    name="ball", shapes=(ShapeCfg(kind="sphere", radius=0.1),), count=3,
    position_ratio_low=(0.2, 0.2, 0.2), position_ratio_high=(0.8, 0.8, 0.8),
    euler_low=(-3.0, -3.0, -3.0), euler_high=(3.0, 3.0, 3.0),
)  # fmt: skip
TWIST = MotionCfg(
    kind="twist", lin_vel_low=(-1.0, -1.0, -1.0), lin_vel_high=(1.0, 1.0, 1.0),
    ang_vel_low=(-2.0, -2.0, -2.0), ang_vel_high=(2.0, 2.0, 2.0),
)  # fmt: skip
EPS = 2.0**-23


def manager(
    motion: MotionCfg, num_envs: int = 5, more: tuple[AssetCfg, ...] = ()
) -> tuple[AssetManager, GlobalTensorDictionary]:
    cfg = box_environment((4.0, 3.0, 2.0), replace(BALL, motion=motion), *more)
    made, gtd, _ = make_manager(cfg, num_envs, seed=1)
    begin(made, every(num_envs))
    return made, gtd


def test_a_constant_twist_gives_a_straight_line_and_an_exact_rotation() -> None:
    made, gtd = manager(TWIST)
    start = gtd["env_asset_state_tensor"].double().clone()
    steps, dt = 200, 0.01
    assert start[..., 7:10].norm(dim=-1).min() > 0.1
    assert start[..., 10:13].norm(dim=-1).min() > 0.1
    for _ in range(steps):
        move_obstacles(made, dt)
    state = gtd["env_asset_state_tensor"].double()
    line = start[..., 0:3] + steps * dt * start[..., 7:10]
    torch.testing.assert_close(state[..., 0:3], line, rtol=0.0, atol=steps * 4.0 * EPS)
    turned = quat_multiply(quat_exp(steps * dt * start[..., 10:13]), start[..., 3:7])
    turned = turned * torch.sign((turned * state[..., 3:7]).sum(-1, keepdim=True))
    torch.testing.assert_close(state[..., 3:7], turned, rtol=0.0, atol=steps * 4.0 * EPS)
    torch.testing.assert_close(state[..., 3:7].norm(dim=-1), torch.ones(5, 3).double(), rtol=0.0, atol=2 * EPS)
    assert torch.equal(state[..., 7:], start[..., 7:])


def test_twists_are_drawn_within_their_ranges() -> None:
    _, gtd = manager(replace(TWIST, lin_vel_low=(0.5, -1.0, 0.0), lin_vel_high=(1.0, 1.0, 0.0)), 400)
    velocity = gtd["obstacle_linvel"].flatten(0, 1)
    low, high = torch.tensor([0.5, -1.0, 0.0]), torch.tensor([1.0, 1.0, 0.0])
    assert ((velocity >= low) & (velocity <= high)).all()
    torch.testing.assert_close(velocity.std(dim=0), (high - low) / sqrt(12), rtol=0.1, atol=1e-6)
    spin = gtd["obstacle_angvel"].flatten(0, 1)
    assert (spin.abs() <= 2.0).all()
    torch.testing.assert_close(spin.std(dim=0), torch.full((3,), 4.0 / sqrt(12)), rtol=0.1, atol=0.0)


def test_obstacles_on_waypoints_go_back_and_forth() -> None:
    made, gtd = manager(MotionCfg(kind="waypoints", speed=(0.5, 2.0)), 30)
    a, b = gtd["obstacle_waypoints"].double().unbind(2)
    length = (b - a).norm(dim=-1)
    speed = gtd["obstacle_linvel"].double().norm(dim=-1)
    assert ((speed >= 0.5 - 1e-6) & (speed <= 2.0 + 1e-6)).all()
    assert torch.equal(gtd["obstacle_position"].double(), a)
    dt, steps = 0.02, 500
    turned = torch.zeros_like(length)
    for i in range(1, steps + 1):
        before = gtd["obstacle_linvel"].clone()
        move_obstacles(made, dt)
        turned += ((before * gtd["obstacle_linvel"]).sum(-1) < 0).double()
        phase = (i * dt * speed) % (2.0 * length)
        along = torch.minimum(phase, 2.0 * length - phase)
        expected = a + along.unsqueeze(-1) * (b - a) / length.unsqueeze(-1)
        error = (gtd["obstacle_position"].double() - expected).norm(dim=-1)
        assert error.max() < 8.0 * EPS * (i + 5)  # a step rounds lengths below 8 m; the phase adds up
    torch.testing.assert_close(gtd["obstacle_linvel"].double().norm(dim=-1), speed, rtol=1e-4, atol=0.0)
    assert (turned == torch.floor(steps * dt * speed / length + 1e-4)).all()
    assert turned.max() > 2


def test_obstacles_bounce_off_the_bounds() -> None:
    made, gtd = manager(replace(TWIST, at_bounds="bounce"), 20)
    start = gtd["env_asset_state_tensor"].double().clone()
    low, high = torch.tensor([-4.0, -3.0, -2.0]).double(), torch.tensor([4.0, 3.0, 2.0]).double()
    for i in range(1, 401):
        move_obstacles(made, 0.05)
        phase = (start[..., 0:3] + i * 0.05 * start[..., 7:10] - low) % (2.0 * (high - low))
        expected = low + torch.minimum(phase, 2.0 * (high - low) - phase)
        torch.testing.assert_close(gtd["obstacle_position"].double(), expected, rtol=0.0, atol=8.0 * EPS * (i + 5))
    assert torch.equal(gtd["obstacle_linvel"].abs().double(), start[..., 7:10].abs())
    assert (gtd["obstacle_linvel"].double() != start[..., 7:10]).any()
    assert torch.equal(gtd["obstacle_angvel"].double(), start[..., 10:])


def test_obstacles_wrap_to_the_other_side() -> None:
    made, gtd = manager(replace(TWIST, at_bounds="wrap"), 20)
    start = gtd["env_asset_state_tensor"].double().clone()
    low, span = torch.tensor([-4.0, -3.0, -2.0]).double(), torch.tensor([8.0, 6.0, 4.0]).double()
    for i in range(1, 301):
        move_obstacles(made, 0.05)
        expected = (start[..., 0:3] + i * 0.05 * start[..., 7:10] - low) % span
        difference = (gtd["obstacle_position"].double() - low - expected).abs()
        difference = torch.minimum(difference, span - difference)  # the same place on a ring
        assert difference.max() < 8.0 * EPS * (i + 5)
        assert ((gtd["obstacle_position"] >= low - 1e-6) & (gtd["obstacle_position"] <= low + span)).all()
    assert torch.equal(gtd["obstacle_linvel"].double(), start[..., 7:10])


def test_assets_without_motion_stay_bit_for_bit_whatever_twist_they_have() -> None:
    made, gtd = manager(TWIST, 3, (replace(BALL, name="still", count=2, keep=True),))
    gtd["obstacle_linvel"][:, :2] = 1.0
    before = gtd["env_asset_state_tensor"].clone()
    made.take_actions(torch.full((3, 5, 6), 2.0))
    move_obstacles(made, 0.1)
    state = gtd["env_asset_state_tensor"]
    assert torch.equal(state[:, :2], before[:, :2])
    assert (state[:, 2:, 7:] == 2.0).all()
    torch.testing.assert_close(state[:, 2:, :3], before[:, 2:, :3] + 0.2)


def test_parked_obstacles_stay_parked() -> None:
    made, gtd = manager(TWIST)
    made.set_num_obstacles(1)
    begin(made, every(5))
    before = gtd["env_asset_state_tensor"].clone()
    made.take_actions(torch.ones(5, 3, 6))
    move_obstacles(made, 0.1)
    assert (gtd["obstacle_position"][:, 1:, 2] == PARKED_Z).all()
    assert torch.equal(gtd["obstacle_position"][:, 1:], before[:, 1:, :3])
    assert (gtd["obstacle_position"][:, 0] != before[:, 0, :3]).all()


@pytest.mark.parametrize("motion", [TWIST, MotionCfg(kind="waypoints", speed=(0.5, 1.0))])
def test_reset_by_mask_leaves_moving_obstacles_of_others_bit_for_bit(motion: MotionCfg) -> None:
    made, gtd = manager(motion, 6)
    for _ in range(10):
        move_obstacles(made, 0.01)
    keys = [key for key in gtd.keys() if key.startswith(("env_asset", "obstacle_"))]  # noqa: SIM118
    before = {key: gtd[key].clone() for key in keys}
    mask = torch.tensor([True, False, True, False, False, True])
    begin(made, mask)
    for key in keys:
        assert torch.equal(gtd[key][~mask], before[key][~mask]), key
    assert (gtd["env_asset_state_tensor"][mask][..., :3] != before["env_asset_state_tensor"][mask][..., :3]).all()


def simulate(env_name: str, num_envs: int = 4, *, robot_name: str = "base_quadrotor") -> EnvManager:
    env = simulation(robot_name, "lee_velocity_control", env=env_name, num_envs=num_envs)
    env.reset()
    return env


def test_env_actions_move_the_obstacles_of_dynamic_env_within_the_step() -> None:
    env = simulate("dynamic_env")
    gtd = env.gtd
    before = gtd["obstacle_position"].clone()
    twists = 0.5 * torch.randn(4, 40, 6, generator=torch.Generator().manual_seed(0))
    env.step(torch.zeros(4, 4), env_actions=twists)
    torch.testing.assert_close(gtd["obstacle_position"], before + env.dt * twists[..., :3], rtol=0.0, atol=1e-5)
    assert torch.equal(gtd["env_actions"], twists)
    assert (gtd["prev_env_actions"] == 0.0).all()
    env.step(torch.zeros(4, 4))  # the twists stay
    torch.testing.assert_close(gtd["obstacle_position"], before + 2 * env.dt * twists[..., :3], rtol=0.0, atol=1e-5)
    env.step(torch.zeros(4, 4), env_actions=-twists)
    assert torch.equal(gtd["prev_env_actions"], twists)
    assert torch.equal(gtd["env_actions"], -twists)
    torch.testing.assert_close(gtd["obstacle_position"], before + env.dt * twists[..., :3], rtol=0.0, atol=1e-5)
    env.reset(torch.tensor([True, False, False, False]))
    assert (gtd["env_actions"][0] == 0.0).all()
    assert torch.equal(gtd["env_actions"][1:], -twists[1:])


def test_an_obstacle_that_flies_into_the_robot_is_a_crash_in_the_same_step() -> None:
    """An obstacle 15 m away comes in ten strides of 1.5 m and is at the robot after the last one alone."""
    env = simulate("dynamic_env")
    gtd = env.gtd
    assert (gtd["robot_clearance"] > 0.39).all()
    gtd["obstacle_position"][0, 7] = gtd["robot_position"][0] + torch.tensor([0.0, 0.0, 15.0])
    twists = torch.zeros(4, 40, 6)
    twists[0, 7, 2] = -15.0 / env.dt
    env.step(torch.zeros(4, 4), env_actions=twists)
    assert gtd["crashes"].tolist() == [True, False, False, False]
    assert gtd["robot_clearance"][0] < 0.0


def test_wrong_env_actions_are_refused() -> None:
    env = simulate("dynamic_env", 2)
    with pytest.raises(ShapeError, match=r"env_actions has shape \(2, 40, 3\), expected \(E, A, 6\) = \(2, 40, 6\)"):
        env.step(torch.zeros(2, 4), env_actions=torch.zeros(2, 40, 3))
    still = simulate("env_with_obstacles", 2)
    with pytest.raises(ConfigError, match=r"env_actions: no obstacle of this environment moves"):
        still.step(torch.zeros(2, 4), env_actions=torch.zeros(2, 44, 6))


@pytest.mark.parametrize(("fields", "message"), [
    ({"kind": "twisted"}, r"MotionCfg.kind = 'twisted': must be one of none, twist, waypoints"),
    ({"kind": "twist", "at_bounds": "stop"}, r"at_bounds = 'stop': must be one of pass, bounce, wrap"),
    ({"kind": "twist", "speed": [1.0, 2.0]}, r"speed = \(1.0, 2.0\): motion 'twist' ignores it"),
    ({"lin_vel_high": [1.0, 0.0, 0.0]}, r"lin_vel_high = .*: motion 'none' ignores it"),
    ({"kind": "waypoints", "speed": [2.0, 1.0]}, r"speed = \(2.0, 1.0\): needs 0 <= low <= high"),
    ({"kind": "twist", "ang_vel_low": [1.0, 0.0, 0.0]}, r"ang_vel_low = .* must not exceed ang_vel_high"),
    ({"kind": "twist", "lin_vel_high": [float("nan"), 0.0, 0.0]}, r"lin_vel_high = .*: must be finite"),
    ({"kindd": "twist"}, r"unknown field 'kindd'. Did you mean 'kind'"),
])  # fmt: skip
def test_impossible_motions_are_refused(fields: dict, message: str) -> None:
    with pytest.raises(ConfigError, match=message):
        build(MotionCfg, fields, where="test")
