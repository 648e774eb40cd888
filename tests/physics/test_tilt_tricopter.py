"""A tricopter whose tail rotor tilts on a servo: its balance in hover by hand, its heading, and signs of the tail.

With a thrust T of the tail at the angle d, the torque k T of its rotor and the arm L: yaw is in balance at ``tan d = k / L``,
pitch where each front rotor gives ``T (cos d + k sin d / L)``; the side force leans the vehicle.
"""

from dataclasses import replace
from math import atan, cos, pi, sin

import pytest
import torch

from aerial_gym.assets import ENVIRONMENTS
from aerial_gym.control import CONTROLLERS
from aerial_gym.env_manager import SIMS, EnvManager
from aerial_gym.errors import ConfigError
from aerial_gym.robots import ROBOTS
from aerial_gym.robots.joints.tail_servo import tail_servo

ARM, RATIO, GRAVITY = 0.2460732, 0.025, 9.81
TRIM = atan(RATIO / ARM)
LEAN = -atan(sin(TRIM) / (3.0 * cos(TRIM) + 2.0 * RATIO * sin(TRIM) / ARM))


def tricopters(controller: str, num_envs: int, backend: str = "auto") -> EnvManager:
    env = EnvManager(
        sim=replace(SIMS.get("base_sim"), backend=backend),
        env=ENVIRONMENTS.get("empty_env"),
        robot=ROBOTS.get("tilt_tricopter"),
        controller=CONTROLLERS.get(controller),
        num_envs=num_envs,
        device=torch.device("cpu"),
        seed=0,
    )
    env.reset()
    return env


@pytest.mark.parametrize("backend", ["warp", pytest.param("torch", marks=pytest.mark.slow)])
def test_a_tricopter_hovers_at_the_heading_that_its_servo_holds(backend: str) -> None:
    """After 12 s, with steps of the heading both ways: angle of the tail and lean as in balance, at rest.

    A law without an integral is 0.27 m aside: by the side force, and by a roll torque of 0.015 N m that the allocation, which
    looks for no yaw in rotors that have none, gives away (``aerial-gym check``).
    """
    env, servo = tricopters("lee_position_control", 3, backend), tail_servo(ROBOTS.get("tilt_tricopter"), dt=0.01)
    gtd, yaw, actions = env.gtd, torch.tensor([0.0, 1.5, -2.5]), torch.zeros(3, 5)
    for _ in range(1200):
        actions[:, 3] = yaw
        actions[:, 4] = servo.angle(gtd["robot_orientation"], gtd["robot_body_angvel"], yaw)
        env.step(actions)
    torch.testing.assert_close(gtd["dof_position"][:, 0], torch.full((3,), TRIM), rtol=0.0, atol=1e-3)
    torch.testing.assert_close(gtd["robot_euler_angles"][:, 0], torch.full((3,), LEAN), rtol=0.0, atol=1e-3)
    torch.testing.assert_close(gtd["robot_euler_angles"][:, 2], yaw, rtol=0.0, atol=2e-3)
    assert gtd["robot_linvel"].norm(dim=-1).max() < 5e-3
    assert gtd["robot_position"].norm(dim=-1).max() < 0.3


@pytest.mark.parametrize("angle", [0.4, -0.4])
def test_a_tail_that_leans_turns_the_vehicle(angle: float) -> None:
    """``J r' = T (L sin d - k cos d)`` with equal thrusts T, k of the front rotors in balance: to the left for d > 0."""
    env = tricopters("no_control", 1)
    gtd, thrust = env.gtd, 1.592 * GRAVITY / 3.0
    for key in ("robot_linvel", "robot_body_angvel", "dof_velocity"):
        gtd[key][:] = 0.0
    gtd["dof_position"][:] = angle
    actions = torch.tensor([[thrust, thrust, thrust, angle]])
    for _ in range(10):
        env.step(actions)
    expected = 0.1 * thrust * (ARM * sin(angle) - RATIO * cos(angle)) / 0.036228984
    assert gtd["robot_body_angvel"][0, 2].item() == pytest.approx(expected, rel=0.02)


def test_the_law_of_the_servo() -> None:
    """Left of the wanted heading the tail leans to the right, and it brakes; the range ends both."""
    servo = tail_servo(ROBOTS.get("tilt_tricopter"), dt=0.01)
    assert servo.trim == pytest.approx(TRIM, rel=1e-6)
    level, still = torch.tensor([[0.0, 0.0, 0.0, 1.0]]), torch.zeros(1, 3)

    def angle(yaw: float, rate: float) -> float:
        return float(servo.angle(level, still + torch.tensor([0.0, 0.0, rate]), torch.tensor([yaw])))

    assert angle(0.0, 0.0) == pytest.approx(TRIM, abs=1e-6)
    assert angle(0.1, 0.0) == pytest.approx(TRIM + 0.1 * servo.heading, abs=1e-6)
    assert angle(-0.1, 0.0) == pytest.approx(TRIM - 0.1 * servo.heading, abs=1e-6)
    assert angle(0.0, 0.1) == pytest.approx(TRIM - 0.1 * servo.rate, abs=1e-6)
    assert angle(3.0, -50.0) == pytest.approx(0.7)
    assert angle(2.0 * pi - 0.1, 0.0) == pytest.approx(angle(-0.1, 0.0), abs=1e-6)


@pytest.mark.parametrize("robot", ["x500", "morphy"])
def test_only_a_tail_on_a_servo_has_such_a_law(robot: str) -> None:
    with pytest.raises(ConfigError, match="needs one rotor on a joint about body x"):
        tail_servo(ROBOTS.get(robot), dt=0.01)
