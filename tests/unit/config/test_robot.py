"""Text of a robot."""

import pytest

from aerial_gym import ROBOTS


@pytest.mark.parametrize(
    ("name", "end"),
    [
        ("x500", "; 1.656 kg; 4 rotors"),
        ("morphy", "; 0.29 kg; 4 rotors; 8 joints"),
        ("base_quadrotor_with_camera_imu", "; 4 rotors; sensors base_depth_camera, base_imu"),
        ("base_quadrotor_with_payload", "; effects slung_payload"),
    ],
)
def test_text_of_a_robot_is_one_line_with_its_parts(name: str, end: str) -> None:
    robot = ROBOTS.get(name)
    assert repr(robot).startswith(f"RobotCfg: {robot.summary}; ")
    assert repr(robot).endswith(end)
