"""MJCF files: limits, dynamics and gravity compensation of actuators and bodies, and what is refused or named."""

import re
from pathlib import Path

import numpy as np
import pytest

from aerial_gym.cli.main import main
from aerial_gym.config.robot import load_robot
from aerial_gym.errors import ConfigError
from aerial_gym.robots import ROBOTS
from aerial_gym.robots.importers import Imported, RotorHints, read_robot
from tests.unit.robots.importers.files import check_named_once

pytest.importorskip("mujoco", reason="MuJoCo is not installed: pip install 'aerial-gym[dev]'")

PLACES = ("0.14 -0.18 0", "-0.14 0.18 0", "0.14 0.18 0", "-0.14 -0.18 0")
LAG = RotorHints(lag=0.04)


def vehicle(actuator: str = 'ctrlrange="0 6"', more: str = "", head: str = "", tail: str = "", kind="general") -> str:
    sites = "".join(f'<site name="s{n}" pos="{place}"/>' for n, place in enumerate(PLACES))
    turns = zip(range(4), (-0.02, -0.02, 0.02, 0.02), strict=True)
    rotors = "".join(f'<{kind} name="m{n}" site="s{n}" gear="0 0 1 0 0 {turn}" {actuator}/>' for n, turn in turns)
    return (
        f'<mujoco><compiler autolimits="true"/>{head}<worldbody><body name="hull"><freejoint/><inertial pos="0 0 0" mass="1" '
        f'diaginertia="0.01 0.01 0.02"/>{sites}{more}</body></worldbody><actuator>{rotors}</actuator>{tail}</mujoco>'
    )


def read(folder: Path, text: str, hints: RotorHints = LAG) -> Imported:
    path = folder / "robot.xml"
    path.write_text(text, encoding="utf-8")
    return read_robot(path, hints)


@pytest.mark.parametrize(
    ("kind", "actuator", "limits"),
    [
        ("general", 'ctrlrange="0 1" gaintype="affine" gainprm="7 3 2"', (0.0, 7.0)),
        ("general", 'ctrlrange="-8 -1"', (1.0, 8.0)), ("general", 'ctrlrange="1 8" gainprm="-1"', (1.0, 8.0)),
        ("velocity", 'ctrlrange="0 2" kv="3"', (0.0, 6.0)),
        ("general", 'ctrlrange="-9 9" dyntype="integrator" actrange="0 6" gainprm="0.5" forcerange="0 2"', (0.0, 2.0)),
    ],
)  # fmt: skip
def test_the_thrust_range_is_what_all_limits_leave(kind: str, actuator: str, limits, tmp_path: Path) -> None:
    rotor = read(tmp_path, vehicle(actuator, kind=kind)).robot.the_rotor("a test")
    assert rotor.thrust_range == pytest.approx(limits)
    assert rotor.torque_ratio == pytest.approx(0.02)


@pytest.mark.parametrize(("actuator", "lag"), [
    ('ctrlrange="0 6"', 0.04),
    ('ctrlrange="0 6" dyntype="filter" dynprm="0.07"', 0.07),
    ('ctrlrange="0 6" dyntype="filterexact" dynprm="0.07"', 0.07),
    ('ctrlrange="0 6" dyntype="filterexact" dynprm="0"', 0.04),
    ('ctrlrange="-1 6" dyntype="integrator" actrange="0 6"', 0.04),
])  # fmt: skip
def test_the_lag_is_that_of_the_file_or_the_given_one(actuator: str, lag: float, tmp_path: Path) -> None:
    rotor = read(tmp_path, vehicle(actuator)).robot.the_rotor("a test")
    assert (rotor.time_constant_up, rotor.time_constant_down) == (lag, lag)


def test_an_integrator_asks_for_a_lag_and_takes_it(tmp_path: Path) -> None:
    text = vehicle('ctrlrange="-30 60" dyntype="integrator" actrange="0 6" gainprm="0.5"')
    path, out = tmp_path / "robot.xml", tmp_path / "robot.yaml"
    path.write_text(text)
    assert main(["robot", "import", str(path), "--out", str(out)]) == 2
    assert main(["robot", "import", str(path), "--out", str(out), "--lag-s", "0.05"]) == 0
    rotor = load_robot(out).the_rotor("a test")
    assert (rotor.time_constant_up, rotor.thrust_range) == (0.05, (0.0, 3.0))
    assert (rotor.slew_rate, rotor.slew_rate_down) == (30.0, 15.0)
    growing = read(tmp_path, vehicle('ctrlrange="0 6" dyntype="integrator" actrange="0 6"')).robot.the_rotor("a test")
    assert (growing.slew_rate, growing.slew_rate_down) == (None, None)


POD = '<body name="pod{}" gravcomp="{}" pos="{}"><inertial pos="0 0 0" mass="0.5" diaginertia="1e-4 1e-4 1e-4"/></body>'


def test_gravity_compensation_on_a_joint_stays_on_its_link(tmp_path: Path) -> None:
    arm = POD.format("", 1, "0 0 -0.1").replace("<inertial", '<joint name="swing" axis="0 1 0"/><inertial')
    robot = read(tmp_path, vehicle(more=arm + POD.format(1, 1, "0 0.3 0")), RotorHints(lag=0.04, joints=True)).robot
    params = robot.effects["link_buoyancy"]
    assert params["swing.force"] == pytest.approx(0.5 * 9.81)
    assert params["base.force"] == pytest.approx(0.5 * 9.81)
    np.testing.assert_allclose([params[f"swing.{a}"] for a in "xyz"], 0.0, atol=1e-12)
    np.testing.assert_allclose([params[f"base.{a}"] for a in "xyz"], (0.0, 0.2, 0.0), atol=1e-12)


def test_equal_delays_are_an_effect(tmp_path: Path) -> None:
    result = read(tmp_path, vehicle('ctrlrange="0 6" delay="0.01" nsample="10"'))
    assert result.robot.effects["actuation_delay"] == {"delay": 0.01}


@pytest.mark.parametrize(
    "text",
    [
        vehicle('ctrlrange="0 6" refsite="s0"'), vehicle('ctrlrange="0 6" dyntype="muscle"'),
        vehicle('ctrlrange="0 6" gaintype="user"'), vehicle('ctrlrange="0 6" biastype="user"'),
        vehicle('ctrlrange="0 6" gainprm="0"'), vehicle(""),
        vehicle('ctrlrange="0 6"', head='<option><flag clampctrl="disable"/></option>'),
        vehicle('ctrlrange="0 8" forcerange="9 10"'), vehicle('dyntype="integrator" ctrlrange="0 6"'),
        vehicle('kv="2" ctrlrange="0 1"', kind="damper"),
        vehicle('ctrlrange="0 6"').replace('site="s0"', 'joint="free"').replace("<freejoint", '<freejoint name="free"'),
        vehicle('ctrlrange="0 6" group="3"', head='<option actuatorgroupdisable="3"/>'),
    ],
)  # fmt: skip
def test_what_is_no_rotor_is_refused(text: str, tmp_path: Path) -> None:
    with pytest.raises(ConfigError):
        read(tmp_path, text)


def on_arm(joint: str, **kwargs) -> str:
    site = f'<site name="s0" pos="{PLACES[0]}"/>'
    arm = f'<body name="arm">{joint}<inertial pos="0 0 0" mass="0.1" diaginertia="1e-4 1e-4 1e-4"/>{site}</body>'
    return vehicle(more=arm, **kwargs).replace(site, "", 1)


@pytest.mark.parametrize(("joint", "tilts"), [
    ('<joint name="j" axis="1 0 0"/>', True),
    ('<joint name="j" axis="0 0 1"/>', True),
    ('<joint name="j" axis="0 0 1" pos="0.14 -0.18 0.3"/>', False),  # spins about its own axis
    ('<joint name="j" type="slide" axis="0 0 1"/>', True),
    ('<joint name="j" type="ball"/>', True),
    ("", False),
])  # fmt: skip
def test_a_joint_that_moves_a_thrust_line_is_a_loss(joint: str, tilts: bool, tmp_path: Path) -> None:
    text = on_arm(joint)
    if tilts:
        with pytest.raises(ConfigError):
            read(tmp_path, text)
    result = read(tmp_path, text, RotorHints(lag=0.04, accept_losses=True))
    assert result.robot.num_rotors == 4
    assert sum("j" in re.split(r"\W+", note) for note in result.notes) == (joint != "")
    if "ball" not in joint and joint:
        bent = read(tmp_path, text, RotorHints(lag=0.04, joints=True)).robot
        assert bent.joints is not None
        assert bent.mounts.layout[0].link == "j"


def test_a_joint_counts_also_where_another_robot_gives_the_rotors(tmp_path: Path) -> None:
    text, like = on_arm('<joint name="j" axis="1 0 0"/>'), ROBOTS.get("x500")
    with pytest.raises(ConfigError):
        read(tmp_path, text, RotorHints(rotors_of=like))
    assert read(tmp_path, text, RotorHints(rotors_of=like, accept_losses=True)).robot.mounts == like.mounts


def test_a_fan_beside_the_vehicle_is_no_rotor_of_it(tmp_path: Path) -> None:
    text = vehicle().replace("<worldbody>", '<worldbody><site name="fan" pos="3 0 0"/>')
    blower = '<motor name="blower" site="fan" gear="1 0 0 0 0 0" ctrlrange="0 9"/>'
    text = text.replace("</actuator>", f"{blower}</actuator>")
    result = read(tmp_path, text)
    assert result.robot.num_rotors == 4
    assert any("blower" in note for note in result.notes)


def test_lifting_bodies_are_a_loss(tmp_path: Path) -> None:
    wing = '<geom name="wing" type="ellipsoid" size="0.3 0.1 0.01" mass="0" {}/>'
    air = '<option density="1.2"/>'
    with pytest.raises(ConfigError):
        read(tmp_path, vehicle(more=wing.format('fluidshape="ellipsoid"'), head=air))
    assert read(tmp_path, vehicle(more=wing.format('fluidshape="ellipsoid"'))).robot.num_rotors == 4
    assert read(tmp_path, vehicle(more=wing.format(""), head=air)).robot.num_rotors == 4


def test_what_is_not_used_is_named_once(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    gimbal = (
        '<camera name="eye"/><light name="lamp"/><geom name="skin" size="0.1" mass="0" contype="0" conaffinity="0"/>'
        '<body name="g"><joint name="pan" axis="0 0 1"/><inertial pos="0 0 0" mass="0.1" diaginertia="1e-4 1e-4 1e-4"/></body>'
    )
    tail = '<sensor><gyro name="gyro" site="s0"/></sensor><keyframe><key name="hover"/></keyframe>'
    text = vehicle('ctrlrange="0 6" gainprm="2" biastype="affine" biasprm="0 0 -0.3"', more=gimbal, tail=tail)
    text = text.replace("</actuator>", '<position name="servo" joint="pan" kp="1"/></actuator>')
    text = text.replace("<freejoint/>", '<joint type="free" damping="0.1"/><site name="spare"/>')
    text = text.replace("<worldbody>", '<worldbody><geom name="floor" type="plane" size="1 1 1"/>')
    path, out = tmp_path / "robot.xml", tmp_path / "robot.yaml"
    path.write_text(text)
    assert main(["robot", "import", str(path), "--out", str(out), "--lag-s", "0.05"]) == 0
    names = ("eye", "lamp", "skin", "pan", "gyro", "hover", "servo", "damping", "biasprm[2]", "floor", "spare")
    check_named_once(out, capsys.readouterr().err, names)
