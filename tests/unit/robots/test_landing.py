"""Registered robots on the ground of ``landing_env``: what stands on a flat shape stays where it landed."""

import pytest
import torch

from aerial_gym.math.quaternion import euler_from_quat, quat_from_euler
from aerial_gym.robots import ROBOTS
from tests.builders import simulation


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


@pytest.mark.parametrize(
    ("robot", "backend"),
    [
        ("base_quadrotor_on_skids", "warp"),
        pytest.param("base_quadrotor_on_skids", "torch", marks=pytest.mark.slow),
        pytest.param("crazyflie_21", "warp", marks=pytest.mark.slow),
    ],
)
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
