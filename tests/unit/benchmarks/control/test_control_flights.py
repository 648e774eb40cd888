"""What ``benchmarks.control.control_flights`` flies: which robots, and what the drives of those that bend are told."""

from math import inf, nan, pi

import torch

from aerial_gym.robots import ROBOTS
from benchmarks.control.control_flights import Drives, different_robots, figures, holds_shape
from benchmarks.control.robot_table import table_robots

LEVEL = {"robot_orientation": torch.tensor([[0.0, 0.0, 0.0, 1.0]]), "robot_body_angvel": torch.zeros(1, 3)}


def drive_commands(robot: str) -> list[float]:
    actions = torch.zeros(1, 9)
    Drives(ROBOTS.get(robot), 0.01).hold(LEVEL, actions)
    return actions[0].tolist()


def test_drives_hold_the_reference_pose_and_a_tail_what_turns_it_by_nothing() -> None:
    turned = [0.0, 0.0, 0.0, pi / 2, 0.0, pi / 2, 0.0, pi / 2, 0.0]
    torch.testing.assert_close(drive_commands("snakey_position"), turned, rtol=1e-6, atol=0)
    torch.testing.assert_close(drive_commands("tilt_tricopter"), [*[0.0] * 8, 0.1012477], rtol=1e-5, atol=0)
    assert drive_commands("morphy") == drive_commands("x500") == [0.0] * 9


def test_robots_that_bend_fly_beside_rigid_ones_but_not_on_a_stand() -> None:
    bend = different_robots(bend=True)
    assert not set(bend) & set(different_robots())
    assert "morphy_fixed_base" not in bend
    assert [name for name in bend if not holds_shape(ROBOTS.get(name))][:2] == ["snakey", "snakey_effort"]
    assert table_robots()[-5:] == ["tilt_tricopter", "morphy", "snakey", "snakey5", "snakey6"]


def test_a_response_with_nan_has_not_settled() -> None:
    assert figures([0.5, 1.0, 1.1, 1.0]) == (0.08, 0.10000000000000009)
    assert figures([0.5, 1.0, nan, nan]) == (inf, inf)
