"""Robots from small URDF, MJCF and SDF files against the numbers of the public vehicles, and reasons of refusals."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from aerial_gym.config.robot import RobotCfg
from aerial_gym.errors import ConfigError
from aerial_gym.physics import rotor_state_for_thrust
from aerial_gym.robots import ROBOTS
from aerial_gym.robots.check import check_robot
from aerial_gym.robots.importers import RotorHints, import_robot
from tests.unit.robots.importers.files import CF2, IRIS_MOTOR, X2, cf2x, inertial, motor, x500

pytest.importorskip("yourdfpy", reason="yourdfpy is not installed: pip install 'aerial-gym[urdf]'")


def put(folder: Path, text: str, name: str = "robot.xml") -> Path:
    path = folder / name
    path.write_text(text, encoding="utf-8")
    return path


def moments(robot: RobotCfg) -> list[float]:
    return [robot.body.inertia[i][i] for i in range(3)]


def test_x500_of_px4(tmp_path: Path) -> None:
    """Motors, lags and drag as the file says; mass by hand; the rotors, 0.06 m up, lift the centre of mass by m h / M."""
    result = import_robot(x500(tmp_path))
    robot, blades = result.robot, 4 * 0.016076923076923075
    assert robot.body.mass == pytest.approx(2.0 + blades)
    assert robot.body.com == pytest.approx((0.0, 0.0, 0.06 * blades / (2.0 + blades)))
    assert robot.rotor.thrust_map == (0.0, 0.0, 8.54858e-06)
    assert (robot.rotor.time_constant_up, robot.rotor.time_constant_down) == (0.0125, 0.025)
    assert (robot.rotor.torque_ratio, robot.rotor.thrust_range) == (0.016, (0.0, 8.54858))
    assert robot.effects == {"h_force_flapping": {"kh": 8.06428e-05, "kf": 0.0}}
    declared = ROBOTS.get(
        "x500"
    ).mounts.layout  # the same vehicle by its other source: places, and which way each turns
    assert [m.spin for m in robot.mounts.layout] == [m.spin for m in declared]
    for local, other in zip(robot.mounts.layout, declared, strict=True):
        assert local.position[:2] == pytest.approx(other.position[:2])
    assert robot.collision.boxes[0].center == pytest.approx((0.0, 0.0, 0.007))
    assert "rollingMomentCoefficient" in result.notes[0]


def test_skydio_x2_of_the_mujoco_collection_cannot_be_steered_as_it_is(tmp_path: Path) -> None:
    """Both rotors on its right have the gear -0.0201 and both on its left 0.0201: its yaw is 0.0201 / 0.18 of its roll."""
    pytest.importorskip("mujoco", reason="MuJoCo is not installed: pip install 'aerial-gym[dev]'")
    with pytest.raises(ConfigError, match="torque about x and torque about z come only together"):
        import_robot(put(tmp_path, X2), RotorHints(lag=0.03))


def test_skydio_x2_of_the_mujoco_collection_with_spins_of_a_quadrotor(tmp_path: Path) -> None:
    """Ellipsoids have m/5 (b² + c²); each rotor hovers at the 3.2495625 N of the file's own keyframe."""
    pytest.importorskip("mujoco", reason="MuJoCo is not installed: pip install 'aerial-gym[dev]'")
    robot = import_robot(put(tmp_path, X2), RotorHints(lag=0.03, spins=(1, -1, 1, -1))).robot
    assert robot.body.mass == pytest.approx(1.325)
    height = (0.25 * 2 * (0.05 + 0.08) + 0.325 * 0.02) / 1.325
    assert robot.body.com == pytest.approx((0.0, 0.0, height))
    disc, hull = 0.25 / 5.0 * (0.13**2 + 0.01**2), 0.325 / 5.0
    up = sum(0.25 * 2 * (z - height) ** 2 for z in (0.05, 0.08)) + 0.325 * (0.02 - height) ** 2
    expected = [
        4 * (disc + 0.25 * 0.18**2) + hull * (0.04**2 + 0.02**2) + up,
        4 * (disc + 0.25 * 0.14**2) + hull * (0.16**2 + 0.02**2) + up,
        4 * (0.25 / 5.0 * 2 * 0.13**2 + 0.25 * (0.14**2 + 0.18**2)) + hull * (0.16**2 + 0.04**2),
    ]
    assert moments(robot) == pytest.approx(expected)
    assert robot.body.inertia[0][2] == pytest.approx(-0.25 * 2 * 0.14 * (0.08 - 0.05))
    report = check_robot(robot, name="x2", controllers=())
    assert report.hover_thrust_n == pytest.approx((3.2495625,) * 4)
    assert report.thrust_to_weight == pytest.approx(52.0 / (1.325 * 9.81))
    assert [mount.spin for mount in robot.mounts.layout] == [1, -1, 1, -1]
    assert len(robot.collision.boxes) == 5
    assert (robot.rotor.torque_ratio, robot.rotor.time_constant_up) == (0.0201, 0.03)


def test_crazyflie_2_of_the_mujoco_collection_takes_rotors_of_another_file(tmp_path: Path) -> None:
    pytest.importorskip("mujoco", reason="MuJoCo is not installed: pip install 'aerial-gym[dev]'")
    path = put(tmp_path, CF2)
    with pytest.raises(ConfigError, match=r"actuator 'x_moment': gives a torque and no force.*--rotors-of ROBOT"):
        import_robot(path, RotorHints(lag=0.03))
    declared = ROBOTS.get("crazyflie_21")
    robot = import_robot(path, RotorHints(rotors_of=declared)).robot
    assert (robot.rotor, robot.mounts) == (declared.rotor, declared.mounts)
    assert moments(robot) == pytest.approx([2.3951e-5, 2.3951e-5, 3.2347e-5])
    assert 4 * check_robot(robot, name="cf2", controllers=()).hover_thrust_n[0] == pytest.approx(0.26487, rel=1e-4)


NO_INERTIA = '<inertia ixx="0" iyy="0" izz="0" ixy="0" ixz="0" iyz="0"/>'


def urdf(mass: float = 0.321) -> str:
    """Return a base with 1e-3 kg m² about each axis and four point masses in the places of tinyprop, each on an arm."""
    motors = "".join(
        f'<link name="motor_{i}"><inertial><mass value="0.013"/>{NO_INERTIA}</inertial></link><joint name="j{i}" type="fixed">'
        f'<parent link="base"/><child link="motor_{i}"/><origin xyz="{x} {y} 0"/></joint><link name="arm_motor_{i}"/>'
        f'<joint name="a{i}" type="fixed"><parent link="base"/><child link="arm_motor_{i}"/></joint>'
        for i, (x, y) in enumerate(((0.16, -0.16), (-0.16, -0.16), (-0.16, 0.16), (0.16, 0.16)))
    )
    own = NO_INERTIA.replace('ixx="0" iyy="0" izz="0"', 'ixx="1e-3" iyy="1e-3" izz="1e-3"')
    return f'<robot name="r"><link name="base"><inertial><mass value="{mass}"/>{own}</inertial></link>{motors}</robot>'


def test_links_of_a_urdf_take_the_rotor_type_of_another_robot(tmp_path: Path) -> None:
    """Four point masses of 13 g at ±0.16 m add 4 m a² about x and y, twice that about z. Arms are no rotors."""
    path, like = put(tmp_path, urdf()), ROBOTS.get("tinyprop")
    with pytest.raises(ConfigError, match=r"how its rotors turn. Give --spins.*motor_0, motor_1, motor_2, mo"):
        import_robot(path, RotorHints(rotors_of=like))
    with pytest.raises(ConfigError, match=r"have no thrust, torque and lag: motor_0.*--rotors-of ROBOT"):
        import_robot(path, RotorHints(spins=(1, -1, 1, -1)))
    robot = import_robot(path, RotorHints(rotors_of=like, spins=(1, -1, 1, -1))).robot
    assert robot.rotor == like.rotor
    assert robot.mounts.layout == like.mounts.layout
    ring = 4 * 0.013 * 0.16**2
    assert moments(robot) == pytest.approx([1e-3 + ring, 1e-3 + ring, 1e-3 + 2 * ring])


def test_cf2x_of_gym_pybullet_drones(tmp_path: Path) -> None:
    """As published: 27 g, 0.0397 m from the middle to a rotor, 14,476 rpm at hover (theirs, with g = 9.8: 14,468), 21,714 at
    most."""
    result = import_robot(put(tmp_path, cf2x()), RotorHints(spins=(1, -1, 1, -1), lag=0.05))
    robot = result.robot
    assert robot.body.mass == 0.027
    assert moments(robot) == pytest.approx([1.4e-5, 1.4e-5, 2.17e-5])
    places = [mount.position for mount in robot.mounts.layout]
    assert [np.hypot(x, y) for x, y, _ in places] == pytest.approx([0.0397] * 4, rel=3e-3)
    assert places[2] == pytest.approx((-0.028, -0.028, 0.0))
    rotor = robot.the_rotor("a test")
    rpm = 30.0 / np.pi
    assert rotor_state_for_thrust(rotor, 0.25 * 0.027 * 9.8) * rpm == pytest.approx(14468.4, abs=0.1)
    assert rotor_state_for_thrust(rotor, 0.25 * 0.027 * 9.81) * rpm == pytest.approx(14475.8, abs=0.1)
    assert rotor_state_for_thrust(rotor, rotor.thrust_range[1]) * rpm == pytest.approx(1.5 * 14475.8, abs=0.2)
    assert rotor.torque_ratio == pytest.approx(7.94 / 316.0)
    report = check_robot(robot, name="cf2x", controllers=())
    assert report.rank == 4
    assert report.thrust_to_weight == pytest.approx(2.25)


def test_properties_without_a_lag_are_refused(tmp_path: Path) -> None:
    path, spins = put(tmp_path, cf2x()), (1, -1, 1, -1)
    with pytest.raises(ConfigError, match="properties tell thrust and torque of rotors, and no lag. Give one .--lag-s"):
        import_robot(path, RotorHints(spins=spins))
    like = ROBOTS.get("crazyflie_21")
    assert import_robot(path, RotorHints(spins=spins, rotors_of=like)).robot.rotor == like.rotor


def sdf(link: str) -> str:
    return f'<sdf><model name="m"><link name="a">{link}{inertial(1.0, 1.0, 1.0, 1.0)}</link></model></sdf>'


XACRO = '<robot name="r"><xacro:a xmlns:xacro="http://www.ros.org/wiki/xacro"/></robot>'
INCLUDES = '<sdf><model name="m"><include><uri>model://gone</uri></include></model></sdf>'


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("<robot", "not valid XML"), ("<html/>", "first tag is <html>: must be <robot>"),
        (XACRO, "is a xacro. Expand it first: xacro robot.xml >"),
        ('<robot name="r"><link name="base"/></robot>', "no link has a mass"),
        ('<sdf version="1.7"/>', "must hold a <model>"), (INCLUDES, "includes 'model://gone', which is not in"),
        (sdf('<pose relative_to="b"/>'), "frame 'b' is not there"),
        (sdf('<pose relative_to="a"/>'), "is placed in itself: a -> a"),
        (sdf("<pose>1 2</pose>"), "must be 6 numbers"), (sdf("<pose>1 2 3 4 5 one</pose>"), "must be numbers"),
        (sdf(""), "there are no rotors in it"), (urdf(mass=9.0), "must give 22.2 N, but its limits"),
        (urdf().replace('izz="1e-3"', 'izz="9e-3"'), "triangle inequality"),
    ],
)  # fmt: skip
def test_what_cannot_be_imported_is_refused_with_the_reason(text: str, message: str, tmp_path: Path) -> None:
    hints = RotorHints(rotors_of=ROBOTS.get("tinyprop"), spins=(1, -1, 1, -1)) if "motor_0" in text else None
    with pytest.raises(ConfigError, match=message):
        import_robot(put(tmp_path, text), hints)


def test_motors_of_another_kind_are_refused(tmp_path: Path) -> None:
    base = f'<link name="rotor_0">{inertial(1.0, 1, 1, 1)}</link>'
    both = motor(0, "bidirectional", IRIS_MOTOR)
    with pytest.raises(ConfigError, match="turningDirection 'bidirectional': only motors"):
        import_robot(put(tmp_path, f'<sdf><model name="m">{base}{both}</model></sdf>'))
    twice = motor(0, "cw", IRIS_MOTOR) * 2
    with pytest.raises(ConfigError, match="have the same motorNumber 0"):
        import_robot(put(tmp_path, f'<sdf><model name="m">{base}{twice}</model></sdf>'))


def test_a_thrust_that_follows_at_once_asks_for_a_lag_unless_the_file_has_one(tmp_path: Path) -> None:
    pytest.importorskip("mujoco", reason="MuJoCo is not installed: pip install 'aerial-gym[dev]'")
    with pytest.raises(ConfigError, match="--lag-s"):
        import_robot(put(tmp_path, X2))
    gear = 'ctrlrange="0 13" gear="0 0 1 0 0 '
    diagonal = X2.replace(f'thrust3" {gear}', f'thrust3" {gear}-').replace(f'thrust4" {gear}-', f'thrust4" {gear}')
    lagging = diagonal.replace("<motor ", '<general dyntype="filterexact" dynprm="0.07" biastype="none" ')
    robot = import_robot(put(tmp_path, lagging)).robot
    assert [mount.spin for mount in robot.mounts.layout] == [1, -1, 1, -1]  # the body feels the opposite of the turning
    assert robot.rotor.time_constant_up == 0.07


def test_one_rotor_unlike_the_others_makes_two_types(tmp_path: Path) -> None:
    pytest.importorskip("mujoco", reason="MuJoCo is not installed: pip install 'aerial-gym[dev]'")
    weaker = put(tmp_path, X2.replace('ctrlrange="0 13"', 'ctrlrange="0 12"', 1))
    robot = import_robot(weaker, RotorHints(lag=0.03, spins=(1, -1, 1, -1))).robot
    assert [mount.rotor for mount in robot.mounts.layout] == ["type_1", "type_2", "type_2", "type_2"]
    assert replace(robot.rotors["type_1"], thrust_range=(0.0, 13.0)) == robot.rotors["type_2"]
