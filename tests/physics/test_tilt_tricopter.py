"""A tricopter whose tail rotor tilts on a servo: its balance in hover by hand, its heading, and signs of the tail. With
a thrust T of the tail at the angle d, the torque k T of its rotor and the arm L: yaw is in balance at ``tan d = k /
L``, pitch where each front rotor gives ``T (cos d + k sin d / L)``; the side force leans the vehicle."""

from math import atan, cos, pi, sin, tan

import pytest
import torch

from aerial_gym.env_manager import EnvManager
from aerial_gym.errors import ConfigError
from aerial_gym.robots import ROBOTS
from aerial_gym.robots.joints.tail_servo import derive_tail_servo
from tests.builders import simulation

ARM, RATIO, GRAVITY = 0.2460732, 0.025, 9.81
TRIM = atan(RATIO / ARM)
YAW = torch.tensor([0.0, 1.5, -2.5])
LEAN = -atan(sin(TRIM) / (3.0 * cos(TRIM) + 2.0 * RATIO * sin(TRIM) / ARM))


def tricopters(controller: str, num_envs: int, backend: str = "auto") -> EnvManager:
    env = simulation("tilt_tricopter", controller, num_envs=num_envs, backend=backend)
    env.reset()
    return env


def hover(controller: str, seconds: float, backend: str = "auto") -> EnvManager:
    env, servo = tricopters(controller, 3, backend), derive_tail_servo(ROBOTS.get("tilt_tricopter"), dt=0.01)
    gtd, actions = env.gtd, torch.zeros(3, 5)
    for _ in range(round(100 * seconds)):
        actions[:, 3] = YAW
        actions[:, 4] = servo.command_angle(gtd["robot_orientation"], gtd["robot_body_angvel"], YAW)
        env.step(actions)
    torch.testing.assert_close(gtd["dof_position"][:, 0], torch.full((3,), TRIM), rtol=0.0, atol=1e-3)
    torch.testing.assert_close(gtd["robot_euler_angles"][:, 0], torch.full((3,), LEAN), rtol=0.0, atol=1e-3)
    torch.testing.assert_close(gtd["robot_euler_angles"][:, 2], YAW, rtol=0.0, atol=2e-3)
    assert gtd["robot_linvel"].norm(dim=-1).max() < 5e-3
    return env


@pytest.mark.parametrize("backend", ["warp", pytest.param("torch", marks=pytest.mark.slow)])
def test_a_law_without_an_integral_rests_where_its_error_leans_the_vehicle(backend: str) -> None:
    """After 12 s, with steps of the heading both ways: angle of the tail and lean as in balance, at rest. To the right of
    its place, in its own axes, by ``-y = g tan(lean) / kp``, as lean is asked for by distance alone; and before it: with a
    third of the weight T from each rotor the torque about y, ``T (L (cos d - 1) + k sin d)``, is that of an attitude error,
    ``K e``, and that of a distance ``x = g e / kp``."""
    env = hover("lee_position_control", 12.0, backend)
    gains = env.robot_manager.controller.gains
    place, attitude = float(gains.position[0, 0]), float(gains.attitude[0, 1])
    torque = 1.592 * GRAVITY / 3.0 * (ARM * (cos(TRIM) - 1.0) + RATIO * sin(TRIM))
    x, y = GRAVITY * torque / attitude / place, GRAVITY * tan(LEAN) / place
    expected = torch.stack((x * YAW.cos() - y * YAW.sin(), x * YAW.sin() + y * YAW.cos()), dim=-1)
    torch.testing.assert_close(env.gtd["robot_position"][:, :2], expected, rtol=0.0, atol=2e-3)
    assert -0.2 < y < -0.19


@pytest.mark.slow
def test_an_integral_takes_the_tricopter_to_its_place() -> None:
    """PX4's cascade leans it by its integral of velocity: what is left falls to less than a fifth in 10 s."""
    env = hover("px4_position_control", 30.0)
    assert env.gtd["robot_position"].norm(dim=-1).max() < 0.005


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
    servo = derive_tail_servo(ROBOTS.get("tilt_tricopter"), dt=0.01)
    assert servo.trim == pytest.approx(TRIM, rel=1e-6)
    level, still = torch.tensor([[0.0, 0.0, 0.0, 1.0]]), torch.zeros(1, 3)

    def angle(yaw: float, rate: float) -> float:
        return float(servo.command_angle(level, still + torch.tensor([0.0, 0.0, rate]), torch.tensor([yaw])))

    assert angle(0.0, 0.0) == pytest.approx(TRIM, abs=1e-6)
    assert angle(0.1, 0.0) == pytest.approx(TRIM + 0.1 * servo.heading, abs=1e-6)
    assert angle(-0.1, 0.0) == pytest.approx(TRIM - 0.1 * servo.heading, abs=1e-6)
    assert angle(0.0, 0.1) == pytest.approx(TRIM - 0.1 * servo.rate, abs=1e-6)
    assert angle(3.0, -50.0) == pytest.approx(0.7)
    assert angle(2.0 * pi - 0.1, 0.0) == pytest.approx(angle(-0.1, 0.0), abs=1e-6)


@pytest.mark.parametrize("robot", ["x500", "morphy"])
def test_only_a_tail_on_a_servo_has_such_a_law(robot: str) -> None:
    with pytest.raises(ConfigError, match="needs one rotor on a joint about body x"):
        derive_tail_servo(ROBOTS.get(robot), dt=0.01)
