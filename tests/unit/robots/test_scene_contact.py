"""Contact as an environment asks for it: landing, walls, the force in the GTD, the IMU, and what is refused."""

from dataclasses import replace

import pytest
import torch

from aerial_gym.assets import ENVIRONMENTS
from aerial_gym.config.contact import ContactCfg
from aerial_gym.config.environment import AssetCfg, EnvironmentCfg, ShapeCfg
from aerial_gym.config.robot import CollisionCfg, RobotCfg
from aerial_gym.env_manager import EnvManager
from aerial_gym.errors import ConfigError
from aerial_gym.robots import ROBOTS
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
