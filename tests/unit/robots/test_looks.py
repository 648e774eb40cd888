"""Visible shapes of vehicles whose file has none."""

from dataclasses import replace

import pytest
import torch

from aerial_gym.config.robot import RobotCfg
from aerial_gym.config.shape import PartCfg
from aerial_gym.math.quaternion import quat_from_euler, quat_rotate
from aerial_gym.robots.catalog import robot_by_name
from aerial_gym.robots.looks import arm_parts, rotor_parts, rotor_radii


def body_axis(part: PartCfg, axis: tuple[float, float, float]) -> torch.Tensor:
    """Return an axis of a part in body axes."""
    turn = quat_from_euler(torch.tensor(part.euler, dtype=torch.float64))
    return quat_rotate(turn, torch.tensor(axis, dtype=torch.float64))


@pytest.fixture(params=["base_quadrotor", "tilted_hexarotor", "omnidirectional_octarotor", "morphy", "snakey5"])
def robot(request: pytest.FixtureRequest) -> RobotCfg:
    return robot_by_name(request.param)


def test_discs_stand_across_the_axes_of_their_rotors(robot: RobotCfg) -> None:
    for part, mount in zip(rotor_parts(robot), robot.mounts.layout, strict=True):
        axis = torch.tensor(mount.axis, dtype=torch.float64)
        torch.testing.assert_close(body_axis(part, (0.0, 0.0, 1.0)), axis / axis.norm(), atol=1e-9, rtol=0.0)
        assert part.link == mount.link


def test_every_hub_is_the_end_of_a_bar_of_its_link(robot: RobotCfg) -> None:
    """Except a hub on the hinge of its link, or on the origin of the body, where a bar would have no length."""
    joints = () if robot.joints is None else robot.joints.layout
    ends = [(joint.name, torch.tensor(joint.position, dtype=torch.float64)) for joint in joints]
    ends.append(("base", torch.zeros(3, dtype=torch.float64)))
    for part in arm_parts(robot):
        assert part.shape.size is not None
        half = 0.5 * part.shape.size[0] * body_axis(part, (1.0, 0.0, 0.0))
        ends.append((part.link, torch.tensor(part.position, dtype=torch.float64) + half))
    for mount in robot.mounts.layout:
        hub = torch.tensor(mount.position, dtype=torch.float64)
        assert any(link == mount.link and torch.allclose(end, hub, atol=1e-9) for link, end in ends)


def test_radius_is_the_files_or_follows_from_the_nearest_hub() -> None:
    free = robot_by_name("base_quadrotor")
    assert free.rotor is not None
    assert rotor_radii(replace(free, rotor=replace(free.rotor, radius=0.0254))) == [0.0254] * 4
    x, y, _ = free.mounts.layout[0].position
    assert rotor_radii(free) == pytest.approx([0.45 * 2.0 * min(abs(x), abs(y))] * 4)
