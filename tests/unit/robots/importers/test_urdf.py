"""URDF files: properties of gym-pybullet-drones as effects, Gazebo's motors, and what is refused or named."""

from pathlib import Path

import pytest

from aerial_gym.cli.main import main
from aerial_gym.config.robot import load_robot
from aerial_gym.errors import ConfigError
from aerial_gym.robots import ROBOTS
from aerial_gym.robots.importers import Imported, RotorHints, import_robot
from tests.unit.robots.importers.files import cf2x, check_named_once

pytest.importorskip("yourdfpy", reason="yourdfpy is not installed: pip install 'aerial-gym[urdf]'")

HINTS = RotorHints(spins=(1, -1, 1, -1), lag=0.05)
OLD = 'drag_coeff="1" gnd_eff_coeff="1"'
NEW = (
    'gnd_eff_coeff="10" prop_radius="0.02" drag_coeff_xy="8e-7" drag_coeff_z="9e-7" dw_coeff_1="2000" dw_coeff_2="0.2" '
    'dw_coeff_3="-0.1" max_speed_kmh="30"'
)


def read(folder: Path, text: str, hints: RotorHints = HINTS) -> Imported:
    path = folder / "robot.urdf"
    path.write_text(text, encoding="utf-8")
    return import_robot(path, hints)


def test_properties_become_effects(tmp_path: Path) -> None:
    """Ground effect, drag across and along the rotors, and the downwash 1 m below: 2000 (0.02 / 4)² N, 0.1 m wide."""
    result = read(tmp_path, cf2x().replace(OLD, NEW))
    effects = result.robot.effects
    assert effects["ground_effect"] == {"k": 10.0}
    assert effects["h_force_flapping"] == {"kh": 8e-7, "kf": 0.0}
    assert effects["axial_inflow"] == {"ka": 9e-7}
    assert effects["downwash"] == pytest.approx({"force": 0.05, "sigma": 0.1})
    assert result.robot.the_rotor("a test").radius == 0.02
    assert result.robot.effects_source
    assert sum("max_speed_kmh" in note and "arm" in note for note in result.notes) == 1
    assert not any("drag_coeff" in note or "gnd_eff" in note for note in result.notes)


@pytest.mark.parametrize(("attributes", "named"), [
    (OLD, ("drag_coeff", "gnd_eff_coeff")),  # beyond the range of the effect; without a radius
    ('gnd_eff_coeff="10"', ("gnd_eff_coeff",)),
    ('gnd_eff_coeff="40" prop_radius="0.02"', ("gnd_eff_coeff",)),
    ('dw_coeff_1="2000" dw_coeff_2="0.1" prop_radius="0.02"', ("dw_coeff_1", "dw_coeff_2")),
])  # fmt: skip
def test_properties_that_are_no_effect_are_named(attributes: str, named, tmp_path: Path) -> None:
    result = read(tmp_path, cf2x().replace(OLD, attributes))
    assert result.robot.effects == {}
    for name in named:
        assert sum(name in note for note in result.notes) == 1


def test_one_drag_coefficient_counts_along_all_axes(tmp_path: Path) -> None:
    effects = read(tmp_path, cf2x().replace(OLD, 'drag_coeff="8e-7"')).robot.effects
    assert effects == {"h_force_flapping": {"kh": 8e-7, "kf": 0.0}, "axial_inflow": {"ka": 8e-7}}


def test_properties_are_named_where_another_robot_gives_the_rotors(tmp_path: Path) -> None:
    result = read(tmp_path, cf2x(), RotorHints(spins=(1, -1, 1, -1), rotors_of=ROBOTS.get("crazyflie_21")))
    assert result.robot.effects == {}
    assert sum("kf" in note and "drag_coeff" in note for note in result.notes) == 1


NUMBERS = '<inertia ixx="1e-7" iyy="1e-7" izz="1e-7" ixy="0" ixz="0" iyz="0"/>'
ARM = f'<link name="arm"><inertial><mass value="0.001"/>{NUMBERS}</inertial></link>'


def tilt_arm(kind: str = "revolute", axis: str = "0 1 0") -> str:
    """Return the Crazyflie with its first propeller on an arm that turns."""
    limit = '<limit lower="-1" upper="1" effort="1" velocity="1"/>'
    ends = f'<parent link="base_link"/><child link="arm"/><axis xyz="{axis}"/>{limit}'
    arm = f'{ARM}<joint name="tilt" type="{kind}">{ends}</joint>'
    first = '<parent link="base_link"/><child link="prop0_link"/>'
    return cf2x().replace(first, first.replace("base_link", "arm")).replace("</robot>", f"{arm}</robot>")


WING = '<gazebo><plugin name="wing" filename="libLiftDragPlugin.so"><link_name>base_link</link_name></plugin></gazebo>'


FIXED_WING = WING.replace("libLiftDragPlugin", "librotors_gazebo_fw_dynamics_plugin").replace("link_name", "linkName")
"""The fixed-wing plugin of rotors_simulator (Furrer and others 2016)."""


@pytest.mark.parametrize(
    "text",
    [
        tilt_arm(), tilt_arm(axis="0 0 1"), tilt_arm("prismatic", "0 0 1"),
        cf2x().replace("</robot>", f"{WING}</robot>"), cf2x().replace("</robot>", f"{FIXED_WING}</robot>"),
    ],
)  # fmt: skip
def test_wings_and_tilting_joints_are_losses(text: str, tmp_path: Path) -> None:
    path, out = tmp_path / "robot.urdf", tmp_path / "robot.yaml"
    path.write_text(text)
    given = ["robot", "import", str(path), "--out", str(out), "--lag-s", "0.05", "--spins", "1", "-1", "1", "-1"]
    assert main(given) == 2
    assert not out.exists()
    assert main([*given, "--accept-losses"]) == 0
    assert load_robot(out).joints is None


def test_a_floating_joint_to_a_world_without_mass_is_free_flight(tmp_path: Path) -> None:
    ends = '<parent link="world"/><child link="base_link"/>'
    world = f'<link name="world"/><joint name="free" type="floating">{ends}</joint>'
    assert read(tmp_path, cf2x().replace("</robot>", f"{world}</robot>")).robot.num_rotors == 4
    heavy = world.replace("world", "arm").replace('<link name="arm"/>', ARM)
    with pytest.raises(ConfigError):
        read(tmp_path, cf2x().replace("</robot>", f"{heavy}</robot>"))


def test_a_joint_that_moves_is_no_loss(tmp_path: Path) -> None:
    robot = read(tmp_path, tilt_arm(), RotorHints(spins=(1, -1, 1, -1), lag=0.05, joints=True)).robot
    assert robot.joints is not None
    assert [mount.link for mount in robot.mounts.layout] == ["tilt", "base", "base", "base"]


def test_rotors_are_in_the_order_of_the_links(tmp_path: Path) -> None:
    hints = RotorHints(spins=(1, -1, 1, -1), lag=0.05, accept_losses=True)
    flat, deep = (read(tmp_path, text, hints).robot.mounts.layout for text in (cf2x(), tilt_arm()))
    assert [mount.position for mount in deep] == [mount.position for mount in flat]


def test_a_link_without_gravity_is_carried(tmp_path: Path) -> None:
    off = '<gazebo reference="base_link"><turnGravityOff>true</turnGravityOff></gazebo>'
    with pytest.raises(ConfigError):  # nothing is left to lift, and the rotors' lowest thrust is 0
        read(tmp_path, cf2x().replace("</robot>", f"{off}{WING}</robot>"))
    arm = tilt_arm("fixed").replace("</robot>", off.replace("base_link", "arm") + "</robot>")
    robot = read(tmp_path, arm).robot
    assert robot.effects["buoyancy"]["force"] == pytest.approx(0.001 * 9.81)


def test_what_is_not_used_is_named_once(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    more = (
        '<transmission name="drive"/><material name="red"><color rgba="1 0 0 1"/></material><gazebo reference="base_link">'
        '<sensor name="eye" type="camera"/><mu1>0.3</mu1></gazebo><gazebo><plugin name="state" filename="libx.so"/></gazebo>'
    )
    skin = '<visual name="skin"><geometry><sphere radius="1"/></geometry></visual>'
    text = cf2x().replace("</robot>", f"{more}</robot>").replace("<collision>", f"{skin}<collision>")
    path, out = tmp_path / "robot.urdf", tmp_path / "robot.yaml"
    path.write_text(text)
    given = ["robot", "import", str(path), "--out", str(out), "--lag-s", "0.05", "--spins", "1", "-1", "1", "-1"]
    assert main(given) == 0
    names = ("drive", "red", "eye", "mu1", "state", "skin", "arm")
    check_named_once(out, capsys.readouterr().err, names)
