"""What effects at hubs do to a vehicle that bends: as to a rigid one of its shape, and closed forms of arms that move.
On the reference engine; on the fused one in ``tests/cross/test_joints.py``."""

from dataclasses import replace
from math import sin

import numpy as np
import pytest
import torch
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation
from torch import Tensor

from aerial_gym.config.joint import JointCfg, JointsCfg, LinkCfg
from aerial_gym.config.robot import MountCfg, RobotCfg
from aerial_gym.physics import EFFECTS
from aerial_gym.physics.articulated.articulation import build_articulation
from aerial_gym.physics.articulated.flight import articulated_step, link_wrenches
from aerial_gym.physics.articulated.tree import TreeState
from aerial_gym.physics.model import Model, build_model
from aerial_gym.physics.rigid_body import append_memory_to_params, body_wrench
from aerial_gym.physics.state import ArticulatedState, BodyState, state_at_rest
from aerial_gym.physics.vehicle import vehicle_from_config
from tests.physics.vehicles import CEILING, F64, asymmetric_robot, random_state

AT_HUBS = [name for name in EFFECTS if EFFECTS.get(name).at_hubs and EFFECTS.get(name).on_joints]

ROWS = 5

LUMP = ((4e-5, 0.0, 0.0), (0.0, 5e-5, 0.0), (0.0, 0.0, 6e-5))

HINGE, ARM = (0.6, 0.0, 0.8), (0.05, -0.05, 0.0)
"""Of a joint on the base [-], [m]; it carries the first rotor."""

SLIDE, ELBOW = (0.0, 1.0, 0.0), (-0.1, 0.05, 0.01)
"""Of a slide on the base, and of a joint about x at a place of its link; this carries the second and third rotors."""


def heavy_robot(com: tuple[float, float, float]) -> RobotCfg:
    robot = asymmetric_robot(com=com)
    inertia = ((1.0, 0.02, -0.01), (0.02, 1.1, 0.03), (-0.01, 0.03, 1.2))
    return replace(robot, body=replace(robot.body, mass=5.0, inertia=inertia))


def make_bent_robot() -> RobotCfg:
    robot = heavy_robot((0.01, -0.02, 0.03))
    links = ("turned", "bent", "bent", "base")
    layout = tuple(replace(mount, link=link) for mount, link in zip(robot.mounts.layout, links, strict=True))
    lump = LinkCfg(mass=0.02, com=(0.1, -0.1, 0.0), inertia=LUMP)
    joints = (
        JointCfg(name="turned", axis=HINGE, position=ARM, link=lump),
        JointCfg(name="slid", axis=SLIDE, position=(0.0, 0.0, 0.0), kind="prismatic", link=replace(lump, mass=0.01)),
        JointCfg(name="bent", parent="slid", axis=(1.0, 0.0, 0.0), position=ELBOW, link=lump),
    )
    return replace(robot, mounts=replace(robot.mounts, layout=layout), joints=JointsCfg(layout=joints, source="test"))


def make_model(robot: RobotCfg, effects: dict[str, tuple[float, ...]], num_envs: int, **rest: float) -> Model:
    vehicle = vehicle_from_config(robot, num_envs=num_envs, dtype=F64)
    rows = [(EFFECTS.get(name), torch.tensor(row, dtype=F64).expand(num_envs, -1)) for name, row in effects.items()]
    bends = None if robot.joints is None else build_articulation(robot, like=vehicle.mass)
    model = build_model(vehicle, rows, ceiling_height=CEILING, articulation=bends, **rest)
    memory = {one.name: torch.tensor(one.memory, dtype=F64).expand(num_envs, -1) for one, _ in rows if one.remembers}
    return append_memory_to_params(model, memory)


def strong(name: str) -> tuple[float, ...]:
    effect = EFFECTS.get(name)
    return tuple(a + p.scale for a, p in zip(effect.neutral(asymmetric_robot()), effect.parameters, strict=True))


def rotate(place: NDArray[np.float64], axis: tuple[float, float, float], at: NDArray[np.float64], angle: float):
    return at + Rotation.from_rotvec(angle * np.array(axis)).apply(place - at)


def rotor_geometry(robot: RobotCfg, pose: Tensor) -> tuple[Tensor, Tensor]:
    """Return hubs and axes of rotors for angles (and a shift) of joints, by rotations of SciPy, (R, 3)."""
    first, shift, second = pose.tolist()
    none, hubs, axes = np.zeros(3), [], []
    for mount in robot.mounts.layout:
        hub, axis = np.array(mount.position), np.array(mount.axis) / np.linalg.norm(mount.axis)
        if mount.link == "turned":
            hub, axis = rotate(hub, HINGE, np.array(ARM), first), rotate(axis, HINGE, none, first)
        if mount.link == "bent":
            way = (1.0, 0.0, 0.0)
            hub, axis = rotate(hub, way, np.array(ELBOW), second), rotate(axis, way, none, second)
            hub = hub + shift * np.array(SLIDE)
        hubs.append(hub)
        axes.append(axis)
    return torch.tensor(np.array(hubs)), torch.tensor(np.array(axes))


@pytest.mark.parametrize("name", AT_HUBS)
def test_they_see_the_shape_that_it_has(name: str) -> None:
    """Joints that stand: force and torque on the whole are those on a rigid vehicle with its hubs where they are now."""
    robot = make_bent_robot()
    effects = {"constant_wind": (2.0, -1.0, 0.5), name: strong(name)}
    pose = torch.tensor([0.4, 0.05, -0.7], dtype=F64)
    state = random_state(ROWS, seed=2)
    state = replace(state, position=state.position.clamp(-0.5, 0.5) + torch.tensor([0.0, 0.0, 1.0], dtype=F64))
    spin_up = torch.linspace(-300.0, 400.0, ROWS * 4, dtype=F64).view(ROWS, 4)
    model = make_model(robot, effects, ROWS, ground_height=0.4)
    joints = pose.expand(ROWS, -1)
    moving = {field: value for field, value in vars(state).items() if field != "rotor_speed"}
    tree_state = TreeState(**moving, joint_pos=joints, joint_vel=torch.zeros_like(joints))
    own = link_wrenches(model, model.articulation, tree_state, state.rotor_speed, spin_up)
    turns = [Rotation.identity(), Rotation.from_rotvec(0.4 * np.array(HINGE)), Rotation.identity()]
    turns.append(Rotation.from_rotvec([-0.7, 0.0, 0.0]))
    origins = np.array([np.zeros(3), ARM, 0.05 * np.array(SLIDE), np.array(ELBOW) + 0.05 * np.array(SLIDE)])
    force = np.stack([turn.apply(own[:, k, :3].numpy()) for k, turn in enumerate(turns)], axis=1)
    torque = np.stack([turn.apply(own[:, k, 3:].numpy()) for k, turn in enumerate(turns)], axis=1)
    total = np.concatenate((force.sum(1), (torque + np.cross(origins, force)).sum(1)), axis=1)

    def rigid(effects: dict[str, tuple[float, ...]]) -> Tensor:
        """Return the wrench on a rigid vehicle of this shape about its origin, which is its centre of mass."""
        plain = make_model(heavy_robot((0.0, 0.0, 0.0)), effects, ROWS, ground_height=0.4)
        hubs, axes = (rows.expand(ROWS, -1, -1) for rows in rotor_geometry(robot, pose))
        vehicle = replace(plain.vehicle, com=torch.zeros(ROWS, 3, dtype=F64), rotor_position=hubs, rotor_axis=axes)
        wrench = body_wrench(
            replace(plain, vehicle=vehicle), state.position, state.attitude, state.lin_vel, state.ang_vel,
            state.rotor_speed, spin_up,
        )  # fmt: skip
        return torch.cat(wrench, dim=1)

    reference = rigid(effects)
    assert float((reference - rigid({"constant_wind": (2.0, -1.0, 0.5)})).abs().max()) > 1e-6
    np.testing.assert_allclose(total, reference.numpy(), rtol=1e-11, atol=1e-13)


LENGTH, HEAVY, SPEED = 0.4, 0.2, 700.0
"""Of the arms below [m], [kg], and the speed of their rotors [rad/s]."""


def arm(*axes: tuple[float, float, float], first: float = 0.0) -> RobotCfg:
    """Return a stand with an arm along x with a rotor at its tip, on joints at the origin about these axes."""
    robot = heavy_robot((0.0, 0.0, 0.0))
    tip = LinkCfg(mass=HEAVY, com=(LENGTH, 0.0, 0.0), inertia=LUMP)
    names = [f"joint_{k}" for k in range(len(axes))]
    joints = tuple(
        JointCfg(
            name=names[k], parent="base" if k == 0 else names[k - 1], axis=axis, position=(0.0, 0.0, 0.0),
            link=tip if k == len(axes) - 1 else None,
        )
        for k, axis in enumerate(axes)
    )  # fmt: skip
    remaining = robot.mounts.layout[1:]
    mounts = replace(robot.mounts, layout=(MountCfg(position=(LENGTH, 0.0, 0.0), spin=1, link=names[-1]), *remaining))
    return replace(robot, mounts=mounts, joints=JointsCfg(layout=joints, floating=False, source="test"))


def joint_accelerations(
    robot: RobotCfg, name: str, row: tuple[float, ...], pos: tuple[float, ...], vel: tuple[float, ...], height: float
) -> Tensor:
    result = []
    for effects in ({}, {name: row}):
        model = replace(make_model(robot, effects, 1, ground_height=0.0), gravity=0.0)
        body = state_at_rest(1, 4, device=torch.device("cpu"), dtype=F64)
        speeds = torch.tensor([[SPEED, 0.0, 0.0, 0.0]], dtype=F64)
        place = torch.tensor([[0.0, 0.0, height]], dtype=F64)
        body = BodyState(**{**vars(body), "rotor_speed": speeds, "position": place})
        joints = torch.tensor([pos, vel], dtype=F64)
        state = ArticulatedState(**vars(body), joint_pos=joints[:1], joint_vel=joints[1:])
        after = articulated_step(model, state, speeds, torch.zeros(1, 0, dtype=F64), 1e-6)
        result.append((after.joint_vel - state.joint_vel)[0] / 1e-6)
    return result[1] - result[0]


def test_inflow_damps_an_arm_that_flaps() -> None:
    """A tip that goes down meets its air from below: ``J q'' = -ka w l² q'``."""
    ka, rate = 2e-4, 1.5
    result = joint_accelerations(arm((0.0, 1.0, 0.0)), "axial_inflow", (ka,), (0.0,), (rate,), 5.0)
    expected = -ka * SPEED * LENGTH**2 * rate / (HEAVY * LENGTH**2 + LUMP[1][1])
    assert float(result) == pytest.approx(expected, rel=1e-6)


def test_the_force_in_the_plane_of_a_rotor_damps_an_arm_that_sweeps() -> None:
    """``J q'' = -kh w l² q'``, and nothing by the moment at the hub, which is across."""
    kh, rate = 3e-5, -2.0
    result = joint_accelerations(arm((0.0, 0.0, 1.0)), "h_force_flapping", (kh, 1e-6), (0.3,), (rate,), 5.0)
    expected = -kh * SPEED * LENGTH**2 * rate / (HEAVY * LENGTH**2 + LUMP[2][2])
    assert float(result) == pytest.approx(expected, rel=1e-6)


def test_the_moment_of_blades_that_flap_lifts_an_arm_that_sweeps() -> None:
    """About y and z: a tip that moves with ``v`` along y feels ``kf w v`` about x of its link, 90° on about -y."""
    kf, rate = 2e-5, 2.0
    robot = arm((0.0, 0.0, 1.0), (1.0, 0.0, 0.0))
    result = joint_accelerations(robot, "h_force_flapping", (0.0, kf), (0.0, 0.0), (rate, 0.0), 5.0)
    assert float(result[1]) == pytest.approx(kf * SPEED * LENGTH * rate / LUMP[0][0], rel=1e-6)
    assert abs(float(result[0])) < 1e-9


def test_a_rotor_that_is_rolled_pitches_its_arm() -> None:
    """``-w x h`` of momentum ``jr w`` along z, rolled with p about x: ``jr w p`` about y."""
    jr, rate = 2e-6, 3.0
    robot = arm((0.0, 1.0, 0.0), (1.0, 0.0, 0.0))
    result = joint_accelerations(robot, "rotor_inertia", (jr,), (0.0, 0.0), (0.0, rate), 5.0)
    assert float(result[0]) == pytest.approx(jr * SPEED * rate / (HEAVY * LENGTH**2 + LUMP[1][1]), rel=1e-6)


@pytest.mark.parametrize("angle", [0.5, -0.5])
def test_an_arm_that_hangs_is_nearer_to_the_ground(angle: float) -> None:
    """Cheeseman and Bennett's gain at the height of the tip, which is ``l sin q`` below the stand."""
    height, radius = 0.45, 0.1
    thrust = 1e-4 * SPEED + 3e-6 * SPEED**2
    share = (0.25 * radius / (height - LENGTH * sin(angle))) ** 2
    result = joint_accelerations(arm((0.0, 1.0, 0.0)), "ground_effect", (1.0,), (angle,), (0.0,), height)
    expected = -thrust * LENGTH * share / (1.0 - share) / (HEAVY * LENGTH**2 + LUMP[1][1])
    assert float(result) == pytest.approx(expected, rel=1e-6)
