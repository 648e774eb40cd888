"""SDF files: masses by default and by density, frames and nested models, and what a multirotor would lose."""

import re
from collections.abc import Callable
from math import pi
from pathlib import Path

import numpy as np
import pytest
import trimesh
from scipy.integrate import quad

from aerial_gym.cli.main import main
from aerial_gym.config.robot import RobotCfg, load_robot
from aerial_gym.errors import ConfigError
from aerial_gym.robots.importers import Imported, RotorHints, import_robot, read_robot
from tests.unit.robots.importers.files import IRIS_MOTOR, PLACES, PX4_TURNING, check_named_once, inertial, motor, write

ACCEPT = RotorHints(accept_losses=True)


def vehicle(
    base: str = inertial(1.0, 0.01, 0.01, 0.02), more: str = "", *, rotor_more: str = "", axis: str = "0 0 1",
    parent: str = "base", attributes: str = "",
) -> str:  # fmt: skip
    """Return a quadrotor of a base, whose content is given, and four rotors of 10 g."""
    blade = inertial(0.01, 1e-5, 1e-5, 2e-5)
    rotors = "".join(
        f'<link name="rotor_{i}"><pose>{place} 0 0 0</pose>{blade}</link><joint name="rotor_{i}_joint" type="revolute">'
        f"<parent>{parent}</parent><child>rotor_{i}</child><axis><xyz>{axis}</xyz>{rotor_more}</axis></joint>"
        f"{motor(i, PX4_TURNING[i], IRIS_MOTOR)}"
        for i, place in enumerate(PLACES)
    )
    return (
        f'<sdf version="1.11"><model name="m" {attributes}><link name="base">{base}</link>{more}{rotors}</model></sdf>'
    )


def read(folder: Path, text: str, hints: RotorHints = ACCEPT) -> Imported:
    return read_robot(write(folder, model=text), hints)


def body_alone(folder: Path, base: str, **kwargs) -> tuple[float, np.ndarray, np.ndarray]:
    """Return mass, centre of mass and inertia of the base, without the rotors' 10 g each."""
    body = read(folder, vehicle(base, **kwargs)).robot.body
    weights = [(0.01, np.array([float(x) for x in place.split()]), np.diag((1e-5, 1e-5, 2e-5))) for place in PLACES]
    mass = body.mass - 0.04
    com = (body.mass * np.array(body.com) - sum(m * r for m, r, _ in weights)) / mass

    def shift_inertia(m: float, r: np.ndarray) -> np.ndarray:
        lever = r - np.array(body.com)
        return m * (lever @ lever * np.eye(3) - np.outer(lever, lever))

    part_inertia = sum(j + shift_inertia(m, r) for m, r, j in weights) + shift_inertia(mass, com)
    return mass, com, np.array(body.inertia) - part_inertia


def shape(kind: str, more: str = "", density: float | None = None, pose: str = "") -> str:
    told = "" if density is None else f"<density>{density}</density>"
    return f'<collision name="c">{pose}{told}<geometry><{kind}>{more}</{kind}></geometry></collision>'


def revolution_solid(radius: Callable[[float], float], low: float, high: float) -> tuple[float, float, float, float]:
    """Return volume, height of the centre, and moments across and along of a solid of revolution, slice by slice."""

    def slice_integral(height: Callable[[float], float]) -> float:
        return quad(lambda z: pi * radius(z) ** 2 * height(z), low, high, epsabs=1e-14, limit=400)[0]

    volume = slice_integral(lambda z: 1.0)
    middle = slice_integral(lambda z: z) / volume
    across = slice_integral(lambda z: 0.25 * radius(z) ** 2 + (z - middle) ** 2)
    return volume, middle, across, slice_integral(lambda z: 0.5 * radius(z) ** 2)


R, L = 0.06, 0.25
ROD = f"<radius>{R}</radius><length>{L}</length>"
REVOLVED = {
    "sphere": (f"<radius>{R}</radius>", lambda z: (R * R - z * z) ** 0.5, R),
    "cylinder": (ROD, lambda z: R, L / 2),
    "cone": (ROD, lambda z: R * (0.5 - z / L), L / 2),
    "capsule": (ROD, lambda z: (R * R - max(abs(z) - L / 2, 0.0) ** 2) ** 0.5, L / 2 + R),
    "ellipsoid": (f"<radii>{R} {R} {L}</radii>", lambda z: R * (1.0 - (z / L) ** 2) ** 0.5, L),
}


@pytest.mark.parametrize("kind", REVOLVED)
def test_solids_weigh_what_their_slices_weigh(kind: str, tmp_path: Path) -> None:
    sizes, radius, half = REVOLVED[kind]
    volume, height, across, along = revolution_solid(radius, -half, half)
    mass, com, inertia = body_alone(tmp_path, '<inertial auto="true"/>' + shape(kind, sizes, 300.0))
    assert mass == pytest.approx(300.0 * volume, rel=1e-7)
    np.testing.assert_allclose(com, (0.0, 0.0, height), atol=1e-7)
    np.testing.assert_allclose(inertia, 300.0 * np.diag((across, across, along)), rtol=1e-6, atol=1e-9)


BOX = "<size>0.3 0.3 0.1</size>"


@pytest.mark.parametrize(("inertial_tag", "density", "mass"), [
    ('<inertial auto="true"/>', 500.0, 4.5),
    ('<inertial auto="true"/>', None, 9.0),
    ('<inertial auto="1"><density>200</density></inertial>', None, 1.8),
    ('<inertial auto="true"><density>200</density></inertial>', 500.0, 4.5),
    ('<inertial auto="true"><mass>0.7</mass></inertial>', 500.0, 0.7),
    ('<inertial auto="true"><mass>0.7</mass><pose>1 1 1 0 0 0</pose></inertial>', None, 0.7),
])  # fmt: skip
def test_an_automatic_inertial_takes_density_and_mass(inertial_tag, density, mass, tmp_path) -> None:
    """A box of 9 litres: of its own density, else of the inertial's, else of water; a given mass scales it."""
    result = body_alone(tmp_path, inertial_tag + shape("box", BOX, density))
    assert result[0] == pytest.approx(mass)
    np.testing.assert_allclose(result[1], 0.0, atol=1e-12)
    np.testing.assert_allclose(result[2], mass / 12.0 * np.diag((0.1, 0.1, 0.18)), atol=1e-9)


def test_an_automatic_inertial_of_a_mesh_in_its_own_unit(tmp_path: Path) -> None:
    box = trimesh.creation.box((300.0, 300.0, 100.0))
    box.apply_translation((150.0, 150.0, 50.0))
    (tmp_path / "model").mkdir()
    box.export(tmp_path / "model" / "box.stl")
    mesh = shape("mesh", "<uri>{}</uri><scale>0.001 0.001 0.001</scale>", 500.0)
    absolute = f"file://{tmp_path / 'model' / 'box.stl'}"
    for uri in ("box.stl", "model://model/box.stl", "model://box.stl", absolute):
        mass, com, inertia = body_alone(tmp_path, '<inertial auto="true"/>' + mesh.format(uri))
        assert mass == pytest.approx(4.5, rel=1e-6)
        np.testing.assert_allclose(com, (0.15, 0.15, 0.05), rtol=1e-6)
        np.testing.assert_allclose(inertia, 4.5 / 12.0 * np.diag((0.1, 0.1, 0.18)), rtol=1e-5, atol=1e-8)


@pytest.mark.parametrize(
    "content",
    [
        "", shape("plane"), shape("polyline", "<point>0 0</point>"), shape("box", BOX, 0.0),
        shape("mesh", "<uri>gone.dae</uri>"), shape("box", BOX, -5.0),
    ],
)  # fmt: skip
def test_an_automatic_inertial_without_a_volume_is_refused(content: str, tmp_path: Path) -> None:
    with pytest.raises(ConfigError):
        read(tmp_path, vehicle('<inertial auto="true"/>' + content))


def test_a_link_without_gravity_is_carried(tmp_path: Path) -> None:
    pod = f'<link name="pod"><pose>0 0.1 0 0 0 0</pose><gravity>false</gravity>{inertial(0.5, 1e-3, 1e-3, 1e-3)}</link>'
    robot = read(tmp_path, vehicle(more=pod)).robot
    assert robot.body.mass == pytest.approx(1.54)
    assert robot.effects["buoyancy"] == pytest.approx({"force": 0.5 * 9.81, "x": 0.0, "y": 0.1, "z": 0.0})
    assert robot.control.buoyancy == pytest.approx(0.5 * 9.81)


SMALL = inertial(0.2, 1e-4, 1e-4, 1e-4)


P = '<link name="p"><pose {}>.1 0 0 0 0 0</pose>' + SMALL + "</link>"
HEAVY = '<link name="q"><pose>0 0 9 0 0 0</pose><inertial><mass>0</mass></inertial></link>'


def frame(pose: str, more: str = "", degrees: str = "") -> str:
    return f'<frame name="f" {more}><pose {degrees}>{pose}</pose></frame>'


def nest_model(content: str, more: str = "") -> str:
    return f'<model name="n" {more}><pose>0 .2 0 0 0 0</pose>{content}</model>'


@pytest.mark.parametrize(("more", "place"), [
    (frame("0 0 0 0 0 90", degrees='degrees="true"') + P.format('relative_to="f"'), (0.0, 0.1, 0.0)),
    (nest_model(P.format(""), 'placement_frame="p"'), (0.0, 0.2, 0.0)),
    (nest_model(frame("0 0 .3 0 0 0") + HEAVY) + P.format('relative_to="n::f"'), (0.1, 0.2, 0.3)),
])  # fmt: skip
def test_a_link_stands_where_its_frames_put_it(more: str, place, tmp_path: Path) -> None:
    """The centre of mass of base, rotors (0.06 m up) and a link of 0.2 kg: the first moments over 1.24 kg."""
    body = read(tmp_path, vehicle(more=more)).robot.body
    assert body.mass == pytest.approx(1.24)
    np.testing.assert_allclose(1.24 * np.array(body.com), 0.2 * np.array(place) + (0.0, 0.0, 0.0024), atol=1e-9)


@pytest.mark.parametrize("merge", [False, True])
@pytest.mark.parametrize("motors_in_it", [False, True])
def test_an_included_vehicle_keeps_motors_and_poses(merge: bool, motors_in_it: bool, tmp_path: Path) -> None:
    inner = vehicle(attributes='placement_frame="rotor_0"')
    motors = "".join(motor(i, turning, IRIS_MOTOR) for i, turning in enumerate(PX4_TURNING))
    if not motors_in_it:
        for i, turning in enumerate(PX4_TURNING):
            inner = inner.replace(motor(i, turning, IRIS_MOTOR), "")
        if not merge:
            motors = motors.replace("Name>rotor", "Name>inner::rotor")
    address = "<uri>model://inner</uri><name>inner</name><pose>1 2 3 0 0 0.5</pose>"
    include = f'<include merge="{str(merge).lower()}">{address}</include>'
    outer = f'<sdf version="1.11"><model name="outer">{include}{"" if motors_in_it else motors}</model></sdf>'
    robot = import_robot(write(tmp_path, inner=inner, outer=outer)).robot
    alone = import_robot(write(tmp_path, alone=vehicle())).robot
    assert robot.body.mass == pytest.approx(alone.body.mass)
    np.testing.assert_allclose(robot.body.com, alone.body.com, atol=1e-9)
    for one, other in zip(robot.mounts.layout, alone.mounts.layout, strict=True):
        assert one.position == pytest.approx(other.position)
        assert one.spin == other.spin


def test_the_vehicle_of_a_world_is_the_model_with_motors(tmp_path: Path) -> None:
    ground = '<model name="ground"><static>true</static><link name="l"/></model>'
    sun = "<include><uri>https://server/sun</uri></include>"
    model = vehicle().removeprefix('<sdf version="1.11">').removesuffix("</sdf>")
    world = f'<sdf version="1.9"><world name="w">{ground}{sun}{model}</world></sdf>'
    result = import_robot(write(tmp_path, world=world))
    assert result.robot.body.mass == pytest.approx(1.04)
    assert any("ground" in note for note in result.notes)


def test_a_missing_vehicle_is_named_and_not_what_stands_beside_it(tmp_path: Path) -> None:
    gone = "<include><uri>model://gone</uri></include>"
    text = f'<sdf version="1.9"><world name="w"><model name="ground"><link name="l"/></model>{gone}</world></sdf>'
    with pytest.raises(ConfigError, match="gone"):
        import_robot(write(tmp_path, world=text))


def test_rotors_with_axes_down_push_up(tmp_path: Path) -> None:
    """As Gazebo: along z of the link; the sense of turning is that of turningDirection about it."""
    up, down = (import_robot(write(tmp_path, m=vehicle(axis=axis))).robot for axis in ("0 0 1", "0 0 -1"))
    assert up.mounts.layout == down.mounts.layout
    assert [mount.axis for mount in down.mounts.layout] == [(0.0, 0.0, 1.0)] * 4


def test_numbers_that_a_motor_does_not_give_are_the_plugins(tmp_path: Path) -> None:
    """MulticopterMotorModel: 8.54858e-6 N s²/rad², 0.016 m, 838 rad/s, 12.5 and 25 ms, 1e-4 N s²/(m rad)."""
    text = vehicle()
    for name, value in IRIS_MOTOR.items():
        text = text.replace(f"<{name}>{value}</{name}>", "")
    result = read(tmp_path, text)
    rotor = result.robot.the_rotor("a test")
    assert rotor.thrust_map == (0.0, 0.0, 8.54858e-06)
    assert rotor.torque_ratio == 0.016
    assert (rotor.time_constant_up, rotor.time_constant_down) == (0.0125, 0.025)
    assert rotor.thrust_range[1] == pytest.approx(8.54858e-06 * 838.0**2)
    assert result.robot.effects["h_force_flapping"]["kh"] == 1e-4
    assert len([line for line in result.assumed if "plugin" in line]) == len(IRIS_MOTOR) - 1


ARM = '<link name="arm"><inertial><mass>0.1</mass></inertial></link>'
TILT = f'{ARM}<joint name="tilt" type="revolute"><parent>base</parent><child>arm</child><axis><xyz>{{}}</xyz></axis></joint>'
WING = '<plugin name="{}" filename="gz-sim-lift-drag-system"><link_name>base</link_name></plugin>'
GIMBAL = (
    '<link name="camera"><inertial><mass>0.1</mass></inertial></link><joint name="gimbal" type="revolute"><parent>base</parent>'
    "<child>camera</child><axis><xyz>0 1 0</xyz></axis></joint>"
)


@pytest.mark.parametrize(("more", "parent"), [
    (TILT.format("0 1 0"), "arm"),
    (TILT.format("0 0 1"), "arm"),  # a rotor off its axis goes round it
    (TILT.format("0 0 1").replace("revolute", "prismatic"), "arm"),
    (TILT.format("0 1 0").replace("<parent>base</parent><child>arm", "<parent>arm</parent><child>base"), "arm"),
    (WING.format("gz::sim::systems::LiftDrag"), "base"),
    (WING.format("left_wing").replace("gz-sim-lift-drag-system", "libLiftDragPlugin.so"), "base"),
    (WING.format("gz::sim::systems::AdvancedLiftDrag"), "base"),
    (WING.format("gz::sim::systems::Thruster").replace("lift-drag", "thruster"), "base"),
    (WING.format("gz::sim::systems::LighterThanAir").replace("lift-drag", "lighter_than_air"), "base"),
])  # fmt: skip
def test_wings_and_tilting_joints_are_losses(more, parent, tmp_path, capsys) -> None:
    """Refused with status 2 and nothing written, unless the loss is accepted."""
    path, out = write(tmp_path, m=vehicle(more=more, parent=parent)), tmp_path / "m.yaml"
    assert main(["robot", "import", str(path), "--out", str(out)]) == 2
    assert not out.exists()
    capsys.readouterr()
    assert main(["robot", "import", str(path), "--out", str(out), "--accept-losses"]) == 0
    assert isinstance(load_robot(out), RobotCfg)
    name = "tilt" if "tilt" in more else re.findall(r'name="([^"]*)"', more)[0]
    assert sum(name in line for line in capsys.readouterr().err.splitlines()) == 1


def test_a_gimbal_and_a_fixed_arm_are_no_losses(tmp_path: Path) -> None:
    fixed = TILT.format("0 1 0").replace("revolute", "fixed")
    assert import_robot(write(tmp_path, m=vehicle(more=fixed, parent="arm"))).robot.num_rotors == 4
    result = import_robot(write(tmp_path, m=vehicle(more=GIMBAL)))
    assert any("gimbal" in note for note in result.notes)


def test_what_is_not_used_is_named_once_on_stderr_and_in_the_file(tmp_path, capsys) -> None:
    sensors = '<sensor name="front" type="camera"/><sensor name="gyro" type="imu"/><visual name="skin"/>'
    base = inertial(1.0, 0.01, 0.01, 0.02) + sensors + shape("polyline").replace('"c"', '"skirt"')
    system = 'name="gz::sim::systems::JointPositionController" filename="x"'
    control = f"<plugin {system}><joint_name>gimbal</joint_name></plugin>"
    text = vehicle(base, GIMBAL + control + '<link name="pod"/>', rotor_more="<limit><effort>3</effort></limit>")
    path, out = write(tmp_path, m=text), tmp_path / "m.yaml"
    assert main(["robot", "import", str(path), "--out", str(out)]) == 0
    said = capsys.readouterr().err
    names = ("front", "gyro", "skin", "skirt", "JointPositionController", "gimbal", "limit", "rollingMomentCoefficient")
    check_named_once(out, said, names)
    assert "pod" in said  # its mass, its inertia, and that no joint holds it
    assert load_robot(out).num_rotors == 4


INCLUDE = '<sdf version="1.9"><model name="{}"><include><uri>model://{}</uri></include></model></sdf>'


@pytest.mark.parametrize("models", [
    {"one": INCLUDE.format("one", "one")},
    {"one": INCLUDE.format("one", "two"), "two": INCLUDE.format("two", "one")},
    {"two": "<sdf", "one": INCLUDE.format("one", "two")},
    {"two": '<?xml version="1.0" encoding="none"?><sdf/>', "one": INCLUDE.format("one", "two")},
    {"one": vehicle().replace("<motorNumber>0", "<motorNumber>nan")},
    {"one": vehicle().replace("<motorNumber>0", "<motorNumber>0.5")},
    {"one": vehicle("<inertial><mass>-1</mass></inertial>")},
    {"one": vehicle("<inertial><mass>nan</mass></inertial>")},
    {"one": vehicle("<pose>0 0 inf 0 0 0</pose>")},
    {"one": vehicle().replace("0.174", "1e300")},
    {"one": vehicle('<pose rotation_format="quat_xyzw">0 0 0 0 0 0 0</pose>')},
    {"one": vehicle('<pose rotation_format="quat_xyzw" degrees="true">0 0 0 0 0 0 1</pose>')},
    {"one": vehicle('<pose rotation_format="other">0 0 0 0 0 0</pose>')},
    {"one": vehicle(attributes='canonical_link="none"')},
])  # fmt: skip
def test_broken_files_are_refused(models: dict[str, str], tmp_path: Path) -> None:
    path = write(tmp_path, **models)
    if "two" in models:
        path = tmp_path / "one" / "model.sdf"
    assert main(["robot", "import", str(path), "--out", str(tmp_path / "out.yaml")]) == 2


def test_the_frame_of_the_canonical_link_is_that_of_the_body(tmp_path: Path) -> None:
    more = f'<link name="low"><pose>0 0 -0.1 0 0 0</pose>{SMALL}</link>'
    plain, moved = (read(tmp_path, vehicle(more=more, attributes=a)).robot for a in ("", 'canonical_link="low"'))
    np.testing.assert_allclose(np.array(moved.body.com) - plain.body.com, (0.0, 0.0, 0.1), atol=1e-9)


def test_a_joint_with_an_axis_of_zero_that_carries_a_rotor_is_a_loss(tmp_path: Path) -> None:
    with pytest.raises(ConfigError):
        read(tmp_path, vehicle(more=TILT.format("0 0 0"), parent="arm"), RotorHints())
