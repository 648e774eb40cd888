"""Joints of imported files, against MuJoCo's own loader of the same file: places of links and mass matrices. The
numbers of the two URDFs are those published of Morphy and Snakey of the Aerial Gym Simulator 2.0.1."""

from dataclasses import replace
from math import pi
from pathlib import Path

import numpy as np
import pytest
import torch

from aerial_gym.cli.main import main
from aerial_gym.config.robot import RobotCfg, load_robot
from aerial_gym.errors import ConfigError
from aerial_gym.physics import vehicle_from_config
from aerial_gym.physics.articulated.articulation import build_articulation
from aerial_gym.physics.articulated.dynamics import equations_of_motion
from aerial_gym.physics.articulated.tree import TreeState
from aerial_gym.robots import ROBOTS
from aerial_gym.robots.importers import RotorHints, import_robot

mujoco = pytest.importorskip("mujoco")

KEEP = '<mujoco><compiler fusestatic="false" discardvisual="false" balanceinertia="false"/></mujoco>'
SMALL = 1e-6
"""Moments of links that have none in the published files [kg m²]: MuJoCo asks for some."""


def link(name: str, mass: float, inertia: tuple[float, float, float], shape: str = "", at: str = "0 0 0") -> str:
    a, b, c = inertia
    return (
        f'<link name="{name}"><inertial><origin xyz="{at}"/><mass value="{mass}"/><inertia ixx="{a}" iyy="{b}" izz="{c}" '
        f'ixy="0" ixz="0" iyz="0"/></inertial>{shape}</link>'
    )


def joint(name: str, kind: str, parent: str, child: str, *, xyz: str, rpy: str = "0 0 0", more: str = "") -> str:
    return (
        f'<joint name="{name}" type="{kind}"><parent link="{parent}"/><child link="{child}"/>'
        f'<origin xyz="{xyz}" rpy="{rpy}"/>{more}</joint>'
    )


def morphy() -> str:
    """Return four arms of 0.07 m at 45 degrees on hinges at (0.04, 0.032) m, up and down, then sideways."""
    text = [link("base_link", 0.225, (4.225e-4, 4.225e-4, 8.45e-4))]
    limits = '<axis xyz="0 1 0"/><limit lower="-0.25" upper="0.25" effort="1" velocity="9"/><dynamics damping="0.018"/>'
    aside = '<axis xyz="0 0 1"/><limit lower="-0.1" upper="0.1" effort="1" velocity="9"/><dynamics friction="0.002"/>'
    capsule = (
        '<collision><origin xyz="0.035 0 0" rpy="0 1.5707963 0"/><geometry><cylinder radius="0.004" length="0.07"/>'
        "</geometry></collision>"
    )
    for n, (x, y) in enumerate(((1, -1), (-1, -1), (-1, 1), (1, 1))):
        yaw = np.arctan2(y, x)
        text += [
            link(f"root_{n}", 1e-4, (SMALL, SMALL, SMALL)),
            link(f"arm_{n}", 0.001, (SMALL, SMALL, SMALL), capsule),
            link(f"motor_{n}", 0.01625, (SMALL, SMALL, SMALL)),
            joint(
                f"elevation_{n}", "revolute", "base_link", f"root_{n}", xyz=f"{0.04 * x} {0.032 * y} 0",
                rpy=f"0 0 {yaw}", more=limits,
            ),
            joint(f"azimuth_{n}", "revolute", f"root_{n}", f"arm_{n}", xyz="0 0 0", more=aside),
            joint(f"tip_{n}", "fixed", f"arm_{n}", f"motor_{n}", xyz="0.07 0 0"),
        ]  # fmt: skip
    return f'<robot name="morphy">{KEEP}{"".join(text)}</robot>'


def snakey() -> str:
    """Return four rods of 1 m and 0.3 kg, yaw and roll between, drawn as a square so that it can hover; a slide at the last."""
    across, small = 0.3 / 12, (SMALL, SMALL, SMALL)
    text = []
    for n in range(4):
        text += [link(f"rod_{n}", 0.3, (SMALL, across, across)), link(f"motor_{n}", 0.00625, small)]
        text.append(joint(f"hub_{n}", "fixed", f"rod_{n}", f"motor_{n}", xyz="0 0 0"))
    wide = '<axis xyz="0 0 1"/><limit lower="-2.356" upper="2.356" effort="1.5" velocity="9"/><dynamics damping="10"/>'
    narrow = '<axis xyz="1 0 0"/><limit lower="-0.2" upper="0.3" effort="1" velocity="1"/>'
    for n in range(1, 4):
        rods, cross, kind = (f"rod_{n - 1}", f"rod_{n}"), f"cross_{n}", "prismatic" if n == 3 else "continuous"
        text.append(link(cross, 1e-3, small))
        text.append(joint(f"yaw_{n}", "revolute", rods[0], cross, xyz="0.5 0 0", rpy=f"0 0 {pi / 2}", more=wide))
        text.append(joint(f"roll_{n}", kind, cross, rods[1], xyz="0.5 0 0", more=narrow))
    return f'<robot name="snakey">{KEEP}{"".join(text)}</robot>'


def import_text(folder: Path, text: str, rotors_of: str) -> tuple[RobotCfg, Path]:
    path = folder / "robot.urdf"
    path.write_text(text)
    hints = RotorHints(rotors_of=ROBOTS.get(rotors_of), spins=(1, -1, 1, -1), joints=True)
    return import_robot(path, hints).robot, path


def package_dynamics(robot: RobotCfg, angle: np.ndarray):
    """Return mass matrix (6 + D, 6 + D), origins (L, 3) and centres of mass (L, 3) of links."""
    vehicle = vehicle_from_config(robot, num_envs=1, dtype=torch.float64)
    bends = build_articulation(robot, like=vehicle.mass)
    state = TreeState.at_rest(1, bends.num_joints, like=vehicle.mass.unsqueeze(-1))
    state = TreeState(**{**vars(state), "joint_pos": torch.from_numpy(angle).unsqueeze(0)})
    result = equations_of_motion(bends.tree, bends.links(vehicle), state, gravity=9.81)
    return result.mass[0].numpy(), result.places.com[0].numpy()


@pytest.mark.parametrize(("make", "like", "count"), [(morphy, "morphy_stiff", 8), (snakey, "snakey", 6)])
def test_mass_matrix_and_centres_are_those_of_mujoco(make, like, count, tmp_path: Path) -> None:
    """On a base that is held, as MuJoCo loads a URDF: 1e-9 at the reference pose and four others."""
    robot, path = import_text(tmp_path, make(), like)
    assert len(robot.joints.layout) == count
    model = mujoco.MjModel.from_xml_path(str(path))
    data, rng = mujoco.MjData(model), np.random.default_rng(0)
    order = [model.joint(name).qposadr[0] for name in robot.joints.names]
    for trial in range(5):
        angle = (0.0 if trial == 0 else 1.0) * rng.uniform(-0.2, 0.2, count)
        data.qpos[order] = angle
        mujoco.mj_forward(model, data)
        full = np.zeros((model.nv, model.nv))
        mujoco.mj_fullM(model, data, full)
        mass, com = package_dynamics(robot, angle)
        reference = full[np.ix_(order, order)]
        np.testing.assert_allclose(mass[6:, 6:], reference, atol=1e-9 * np.abs(reference).max())
        for k, cfg in enumerate(robot.joints.layout, 1):
            body = model.jnt_bodyid[model.joint(cfg.name).id]
            weights = [b for b in range(model.nbody) if _is_welded(model, b, body)]
            total = sum(model.body_mass[b] for b in weights)
            centre = sum(model.body_mass[b] * data.xipos[b] for b in weights) / total
            np.testing.assert_allclose(com[k], centre, atol=1e-9)


def _is_welded(model, body: int, root: int) -> bool:
    while body != root and body > 0 and model.body_jntnum[body] == 0:
        body = model.body_parentid[body]
    return body == root


def test_limits_damping_friction_rotors_and_shapes_are_imported(tmp_path: Path) -> None:
    robot, _ = import_text(tmp_path, morphy(), "morphy_stiff")
    elevation, azimuth = robot.joints.layout[0], next(j for j in robot.joints.layout if j.name == "azimuth_0")
    assert (elevation.spring.damping, elevation.ends.low, elevation.ends.high) == (0.018, -0.25, 0.25)
    assert (azimuth.spring.friction, azimuth.parent) == (0.002, "elevation_0")
    # y of an arm that points to (1, -1), and the moment of the point mass at the rotor
    np.testing.assert_allclose(elevation.axis, (0.5**0.5, 0.5**0.5, 0.0), atol=1e-9)
    assert elevation.ends.stiffness == pytest.approx(0.01625 * 0.07**2 * (2 * pi * 10) ** 2, rel=0.06)
    assert {mount.link for mount in robot.mounts.layout} == {f"azimuth_{n}" for n in range(4)}
    for mount in robot.mounts.layout:
        x, y = (1, -1, -1, 1)[int(mount.link[-1])], (-1, -1, 1, 1)[int(mount.link[-1])]
        np.testing.assert_allclose(mount.position, (0.0894975 * x, 0.0814975 * y, 0.0), atol=1e-6)
    assert [shape.link for shape in robot.collision.shapes] == [f"azimuth_{n}" for n in range(4)]
    assert robot.body.mass == pytest.approx(0.225 + 4 * (0.01625 + 0.0011))
    rigid = RotorHints(rotors_of=ROBOTS.get("morphy_stiff"), spins=(1, -1, 1, -1))
    with pytest.raises(ConfigError):  # its rotors lean in flight, and a rigid vehicle's do not
        import_robot(tmp_path / "robot.urdf", rigid)
    welded = import_robot(tmp_path / "robot.urdf", replace(rigid, accept_losses=True))
    names = [f"{kind}_{n}" for kind in ("elevation", "azimuth") for n in range(4)]
    assert all(any(name in note for note in welded.notes) for name in names)
    assert welded.robot.joints is None
    np.testing.assert_allclose(welded.robot.body.inertia, robot.body.inertia)


MJCF = """<mujoco><option gravity="0 0 -9.81"/><compiler angle="radian"/><worldbody><body name="core" pos="0 0 1"><freejoint/>
<inertial pos="0.01 0 0" mass="0.5" diaginertia="0.002 0.002 0.003"/>
<site name="r0" pos="0.1 -0.1 0"/><site name="r1" pos="-0.1 -0.1 0"/>
<site name="r2" pos="-0.1 0.1 0"/><site name="r3" pos="0.1 0.1 0"/>
<body name="tail" pos="-0.05 0 -0.02" euler="0 0.3 0.2"><joint name="swing" axis="0 1 0" pos="0.01 0 0" stiffness="0.4"
 springref="0.1" damping="0.02" frictionloss="0.003" range="-0.5 0.6" limited="true"/>
<joint name="turn" axis="0 0 1" ref="0.2"/>
<inertial pos="0 0 -0.04" mass="0.03" diaginertia="1e-5 2e-5 3e-5"/><geom type="sphere" size="0.02" pos="0 0 -0.08" mass="0"/>
<body name="end" pos="0 0.02 -0.1"><inertial pos="0 0 0" mass="0.01" diaginertia="1e-6 1e-6 1e-6"/></body>
<body name="tip" pos="0 0 -0.1"><joint name="slide" type="slide" axis="0 0 1" damping="0.5"/>
<inertial pos="0.01 0 0" mass="0.02" diaginertia="1e-6 2e-6 2e-6"/></body></body></body></worldbody><actuator>
<motor name="m0" site="r0" gear="0 0 1 0 0 0.01" ctrllimited="true" ctrlrange="0 4"/>
<motor name="m1" site="r1" gear="0 0 1 0 0 -0.01" ctrllimited="true" ctrlrange="0 4"/>
<motor name="m2" site="r2" gear="0 0 1 0 0 0.01" ctrllimited="true" ctrlrange="0 4"/>
<motor name="m3" site="r3" gear="0 0 1 0 0 -0.01" ctrllimited="true" ctrlrange="0 4"/>
<motor name="servo" joint="turn" ctrllimited="true" ctrlrange="-1 1"/></actuator></mujoco>"""


def test_an_mjcf_with_two_joints_on_a_body_a_slide_and_a_spring(tmp_path: Path) -> None:
    """The whole mass matrix of a base that flies, level, to 1e-9; springs, ends and friction as in the file."""
    path = tmp_path / "robot.xml"
    path.write_text(MJCF)
    result = import_robot(path, RotorHints(lag=0.03, joints=True))
    robot = result.robot
    assert robot.joints.names == ("swing", "turn", "slide")
    swing, turn, slide = robot.joints.layout
    assert swing.link is None
    assert (swing.spring.stiffness, swing.spring.rest, swing.spring.friction) == (0.4, 0.1, 0.003)
    assert (swing.ends.low, swing.ends.high, turn.reference, slide.kind) == (-0.5, 0.6, 0.2, "prismatic")
    assert any("servo" in note for note in result.notes)
    assert [shape.link for shape in robot.collision.shapes] == ["turn"]
    model = mujoco.MjModel.from_xml_path(str(path))
    data, rng = mujoco.MjData(model), np.random.default_rng(1)
    for _ in range(4):
        angle = np.array((0.0, 0.2, 0.0)) + rng.uniform(-0.3, 0.3, 3)
        data.qpos[7:] = angle
        mujoco.mj_forward(model, data)
        full = np.zeros((model.nv, model.nv))
        mujoco.mj_fullM(model, data, full)
        np.testing.assert_allclose(package_dynamics(robot, angle)[0], full, atol=1e-9 * np.abs(full).max())


def test_what_cannot_be_taken_over_is_said(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "robot.urdf"
    path.write_text(morphy().replace('type="revolute"', 'type="planar"', 1))
    with pytest.raises(ConfigError, match="is planar"):
        import_robot(path, RotorHints(rotors_of=ROBOTS.get("morphy_stiff"), spins=(1, -1, 1, -1), joints=True))
    path.write_text(morphy())
    out = tmp_path / "mine.yaml"
    given = ["robot", "import", str(path), "--joints", "--rotors-of", "morphy_stiff", "--spins", "1", "-1", "1", "-1"]
    assert main([*given, "--out", str(out)]) == 0
    assert len(load_robot(out).joints.layout) == 8
    assert capsys.readouterr().out == f"{out}\n"
