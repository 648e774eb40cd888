"""Contact as an environment asks for it: landing, walls, the force in the GTD, the IMU, and what is refused."""

from dataclasses import replace

import pytest
import torch

from aerial_gym import ENVIRONMENTS, ROBOTS, EnvManager
from aerial_gym.config.environment import AssetCfg, ContactCfg, EnvironmentCfg, ShapeCfg
from aerial_gym.config.robot import CollisionCfg, RobotCfg
from aerial_gym.errors import ConfigError
from aerial_gym.math.quaternion import euler_from_quat, quat_from_euler
from tests.builders import simulation

WALL = AssetCfg(
    name="wall", count=1, shapes=(ShapeCfg(kind="box", size=(0.2, 4.0, 4.0)),),
    position_ratio_low=(0.5, 0.5, 0.5), position_ratio_high=(0.5, 0.5, 0.5),
)  # fmt: skip
ROBOT = ROBOTS.get("base_quadrotor")


def build(
    env: EnvironmentCfg, *, robot: RobotCfg = ROBOT, backend: str = "auto", law: str = "no_control"
) -> EnvManager:
    manager = simulation(robot, law, env=env, backend=backend)
    manager.reset()
    return manager


@pytest.mark.parametrize("backend", ["warp", "torch"])
@pytest.mark.parametrize("steps", [1, 4])
def test_a_robot_at_rest_shows_its_weight_in_force_and_imu(backend: str, steps: int) -> None:
    cfg = replace(ENVIRONMENTS.get("landing_env"), physics_steps_per_env_step=steps)
    env = build(cfg, robot=replace(ROBOT, imu="base_imu"), backend=backend)
    for key, value in (("robot_linvel", 0.0), ("robot_body_angvel", 0.0), ("rotor_speed", 0.0)):
        env.gtd[key].fill_(value)
    env.gtd["robot_position"][:, 2] = 0.184
    for _ in range(40 // steps):
        env.step(torch.zeros(2, 4))
    force = env.gtd["robot_contact_force"]
    torch.testing.assert_close(force, torch.tensor([[0.0, 0.0, 0.25 * 9.81]]).repeat(2, 1), rtol=1e-4, atol=1e-4)
    assert not env.gtd["crashes"].any()
    imu = env.gtd["imu_measurement"]  # noise of 0.017 m/s² and a bias of 0.001 m/s²
    torch.testing.assert_close(imu[:, :3], torch.tensor([[0.0, 0.0, 9.81]]).repeat(2, 1), rtol=0.0, atol=0.1)


def test_walls_on_both_sides_push_back_and_hold() -> None:
    contact = ContactCfg(friction=0.2, crash_speed=5.0)
    env = build(replace(ENVIRONMENTS.get("empty_env"), assets=(WALL,), contact=contact), law="lee_velocity_control")
    side = torch.tensor([-1.0, 1.0])
    env.gtd["robot_position"].zero_()[:, 0] = 0.5 * side
    for key in ("robot_linvel", "robot_body_angvel"):
        env.gtd[key].zero_()
    actions = torch.zeros(2, 4)
    actions[:, 0] = -side
    for _ in range(150):
        env.step(actions)
        assert not env.gtd["crashes"].any()
    torch.testing.assert_close(env.gtd["robot_position"][:, 0], 0.284 * side, rtol=0.0, atol=2e-3)
    assert (env.gtd["robot_contact_force"][:, 0] * side > 0.1).all()
    assert env.gtd["robot_clearance"].abs().max() < 2e-3


def test_every_touch_is_a_crash_by_default_and_the_force_is_there_only_on_request() -> None:
    landing = ENVIRONMENTS.get("landing_env")
    for contact in (None, ContactCfg(friction=0.6)):
        env = build(replace(landing, contact=contact))
        assert ("robot_contact_force" in env.gtd) == (contact is not None)
        env.gtd["robot_position"][:, 2] = torch.tensor([0.18, 1.0])
        env.step(torch.zeros(2, 4))
        assert env.gtd["crashes"].tolist() == [True, False]


def test_contact_without_anything_to_touch_or_to_touch_with_is_refused() -> None:
    with pytest.raises(ConfigError, match="there is nothing to touch. Give ground_height or assets"):
        replace(ENVIRONMENTS.get("empty_env"), contact=ContactCfg(friction=0.5))
    with pytest.raises(ConfigError, match="asks for contact, but this robot has no collision shape"):
        build(ENVIRONMENTS.get("landing_env"), robot=replace(ROBOT, collision=CollisionCfg(source="test")))


def land(robot: str, backend: str) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
    """Return tilt [rad], speeds of body and turning after 4 s of a robot that comes down at 0.3 m/s ahead, a little tilted."""
    env = simulation(robot, env="landing_env", backend=backend)
    env.reset()
    gtd, low = env.gtd, 0.02 if robot.startswith("crazyflie") else 0.22
    gtd["robot_position"].copy_(torch.tensor([0.0, 0.0, low + 0.02]).expand(2, 3))
    gtd["robot_orientation"].copy_(quat_from_euler(torch.tensor([[0.05, -0.05, 0.4], [-0.05, 0.08, 2.0]])))
    gtd["robot_linvel"].copy_(torch.tensor([0.3, 0.1, 0.0]).expand(2, 3))
    for key in ("robot_body_angvel", "rotor_speed"):
        gtd[key].zero_()
    for _ in range(400):
        env.step(torch.zeros(2, env.robot_manager.num_actions))
    assert not gtd["crashes"].any()
    tilt = euler_from_quat(gtd["robot_orientation"])[:, :2].abs().amax(dim=1)
    return tilt, gtd["robot_linvel"].norm(dim=1), gtd["robot_body_angvel"].norm(dim=1)


@pytest.mark.parametrize(("robot", "backend"), [
    ("base_quadrotor_on_skids", "warp"),
    pytest.param("base_quadrotor_on_skids", "torch", marks=pytest.mark.slow),
    pytest.param("crazyflie_21", "warp", marks=pytest.mark.slow),
])  # fmt: skip
def test_a_robot_with_a_flat_shape_stands_where_it_lands(robot: str, backend: str) -> None:
    tilt, speed, turn = land(robot, backend)
    assert tilt.max() < 0.02
    assert speed.max() < 1e-3
    assert turn.max() < 1e-2


def test_a_sphere_keeps_rolling() -> None:
    _, speed, turn = land("base_quadrotor", "warp")
    assert speed.min() > 0.1
    assert turn.min() > 0.5


def test_skids_are_below_the_sphere() -> None:
    collision = ROBOTS.get("base_quadrotor_on_skids").collision
    sphere = collision.spheres[0]
    assert all(skid.center[2] - skid.radius < sphere.center[2] - sphere.radius - 0.01 for skid in collision.capsules)
