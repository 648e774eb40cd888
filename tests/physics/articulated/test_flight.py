"""Vehicles that bend, in the air: against the rigid engine, closed forms of arms on springs, and what drives do."""

from collections.abc import Callable
from dataclasses import replace
from math import cos, sqrt

import numpy as np
import pytest
import torch
from torch import Tensor

from aerial_gym.config.joint import CreepCfg, JointsCfg, SpringCfg
from aerial_gym.config.robot import RobotCfg
from aerial_gym.config.sim import SimCfg
from aerial_gym.env_manager import SIMS, EnvManager
from aerial_gym.errors import CapabilityError
from aerial_gym.physics.articulated.articulation import Articulation, build_articulation
from aerial_gym.physics.articulated.dynamics import equations_of_motion
from aerial_gym.physics.articulated.flight import articulated_step
from aerial_gym.physics.articulated.tree import Tree, TreeState
from aerial_gym.physics.integrators import semi_implicit_euler, to_body_state, to_mass_state
from aerial_gym.physics.model import Model, build_model, robot_effects
from aerial_gym.physics.state import ArticulatedState, BodyState, state_at_rest
from aerial_gym.physics.vehicle import vehicle_from_config
from aerial_gym.robots import ROBOTS
from aerial_gym.sim2real.teststand.joints.record import ReleaseRecord, law_angle
from tests.builders import simulation

G = 9.81
F64 = torch.float64


def make_model(robot: RobotCfg, articulation: Articulation | None = None, num_envs: int = 3) -> Model:
    vehicle = vehicle_from_config(robot, num_envs=num_envs, dtype=F64)
    effects = robot_effects(robot, num_envs=num_envs, device=torch.device("cpu"), dtype=F64)
    return build_model(vehicle, effects, articulation=articulation or build_articulation(robot, like=vehicle.mass))


def at_rest(model: Model) -> ArticulatedState:
    body = state_at_rest(model.vehicle.num_envs, model.vehicle.num_rotors, device=torch.device("cpu"), dtype=F64)
    joints = model.articulation.reference.repeat(model.vehicle.num_envs, 1)
    return ArticulatedState(**vars(body), joint_pos=joints, joint_vel=torch.zeros_like(joints))


def throw(state: ArticulatedState) -> ArticulatedState:
    gen = torch.Generator().manual_seed(3)

    def draw(like: Tensor) -> Tensor:
        return torch.randn(like.shape, generator=gen, dtype=F64)

    return replace(state, lin_vel=draw(state.lin_vel), ang_vel=2.0 * draw(state.ang_vel))


def make_rod(articulation: Articulation) -> Articulation:
    """Return an articulation without joints: all on one link."""
    some = {n: v[..., :0] for n, v in vars(articulation).items() if n in ("link_mass", "reference")}
    laws = {
        n: type(law)(**{name: rows[:, :0] for name, rows in vars(law).items()})
        for n, law in (("spring", articulation.spring), ("ends", articulation.ends))
    }
    return replace(
        articulation, tree=Tree(joints=()), origins=articulation.origins[:1], link_com=articulation.link_com[:0],
        link_inertia=articulation.link_inertia[:0], rotor_links=(0,) * len(articulation.rotor_links), names=(),
        **some, **laws,
    )  # fmt: skip


def with_drag(robot: RobotCfg) -> RobotCfg:
    effects = {
        "quadratic_drag": {"dx": 0.02, "dy": 0.03, "dz": 0.01},
        "constant_wind": {"x": 1.0, "y": -2.0, "z": 0.3},
        "axial_inflow": {"ka": 0.02},
    }
    return replace(robot, effects=effects, effects_source="test")


def plain(robot: RobotCfg) -> RobotCfg:
    return replace(robot, rotor=ROBOTS.get("tinyprop").rotor)


@pytest.mark.parametrize("change", [lambda robot: robot, lambda robot: with_drag(plain(robot))])
def test_a_tree_of_one_link_flies_as_the_rigid_vehicle(change: Callable[[RobotCfg], RobotCfg]) -> None:
    """Its centre of mass is the body origin, where both integrate the same quantities: rounding is left."""
    robot = change(ROBOTS.get("morphy_stiff"))
    bending = build_articulation(ROBOTS.get("morphy"), like=torch.zeros(1, dtype=F64))
    tree, rigid = make_model(robot, make_rod(bending)), make_model(robot)
    state = throw(at_rest(tree))
    state = replace(state, rotor_speed=torch.rand(3, 4, dtype=F64) + 0.2)
    command = state.rotor_speed * torch.tensor([1.3, 0.8, 1.1, 0.9], dtype=F64)
    other = to_mass_state(rigid, BodyState(**{n: v for n, v in vars(state).items() if not n.startswith("joint")}))
    for _ in range(200):
        state = articulated_step(tree, state, command, command[:, :0], 2e-3)
        other = semi_implicit_euler(rigid, other, command, 2e-3)
    for own, reference in zip(state.tensors(), to_body_state(rigid, other).tensors(), strict=False):
        torch.testing.assert_close(own, reference, rtol=1e-9, atol=1e-10)


@pytest.mark.parametrize("name", ["morphy", "snakey", "snakey5", "snakey6"])
def test_all_links_together_weigh_what_the_robot_file_says(name: str) -> None:
    robot = ROBOTS.get(name)
    model = make_model(robot, num_envs=1)
    state = at_rest(model)
    tree = TreeState(**{n: v for n, v in vars(state).items() if n != "rotor_speed"})
    mass = equations_of_motion(
        model.articulation.tree, model.articulation.links(model.vehicle), tree, gravity=0.0
    ).mass[0, :6, :6]
    m, c = robot.body.mass, torch.tensor(robot.body.com, dtype=F64)
    inertia = torch.tensor(robot.body.inertia, dtype=F64) + m * (c @ c * torch.eye(3, dtype=F64) - torch.outer(c, c))
    torch.testing.assert_close(mass[:3, :3], m * torch.eye(3, dtype=F64))
    torch.testing.assert_close(mass[3:, 3:], inertia, rtol=1e-9, atol=1e-12)
    cross = m * torch.linalg.cross(torch.eye(3, dtype=F64), c.expand(3, 3), dim=-1)
    torch.testing.assert_close(mass[:3, 3:], -cross, rtol=1e-9, atol=1e-12)  # a push at the origin turns about it


def stiffen(robot: RobotCfg, stiffness: float) -> RobotCfg:
    layout = tuple(
        replace(
            joint, drive=None, spring=SpringCfg(stiffness=stiffness, damping=0.02 * stiffness, rest=joint.reference)
        )
        for joint in robot.joints.layout
    )
    return replace(robot, joints=JointsCfg(layout=layout, source="test"))


def test_stiff_joints_are_the_rigid_vehicle_in_its_reference_pose() -> None:
    """A snake in a ring, with rotors that differ: how far it is from the rigid one falls with the stiffness."""
    robot = ROBOTS.get("snakey5")
    mounts = replace(robot.mounts, layout=tuple(replace(mount, link="base") for mount in robot.mounts.layout))
    shapes = replace(robot.collision, spheres=(), boxes=(), capsules=(), between_links=False)
    expected = make_model(replace(robot, joints=None, mounts=mounts, collision=shapes))
    command = torch.tensor([2.0, 4.0, 3.0, 3.5, 2.5], dtype=F64).expand(3, 5)
    bending = [build_articulation(stiffen(robot, each), like=torch.zeros(1, dtype=F64)) for each in (1e3, 1e4, 1e5)]
    springs = [vars(each.spring) for each in bending if each is not None]
    spring = {name: torch.cat([rows[name] for rows in springs]) for name in springs[0]}
    model = make_model(robot, replace(bending[0], spring=type(bending[0].spring)(**spring)))
    state = replace(at_rest(model), ang_vel=torch.tensor([0.3, -0.2, 0.5], dtype=F64).expand(3, 3))
    other = to_mass_state(expected, BodyState(**{n: v for n, v in vars(state).items() if not n.startswith("joint")}))
    for _ in range(200):
        state = articulated_step(model, state, command, command[:, :0], 1e-4)
        other = semi_implicit_euler(expected, other, command, 1e-4)
    both = zip(state.tensors()[:4], to_body_state(expected, other).tensors()[:4], strict=True)
    apart = torch.cat([(a - b).abs() for a, b in both], dim=1).amax(dim=1).tolist()
    assert apart[1] < 0.2 * apart[0]
    assert apart[2] < 0.2 * apart[1] or apart[2] < 1e-4  # the step itself is of order 1
    assert apart[2] < 1e-3


def test_morphy_hovers_on_arms_where_thrust_and_spring_balance() -> None:
    """``k2 (q - q0)² = T l + weight of the arm - what the spring holds of it at rest``, with the thrust T at the end."""
    env = simulation("morphy", "lee_position_control", sim="base_sim_2ms", env="empty_env_2ms")
    env.reset()
    for _ in range(400):
        env.step(torch.zeros(2, env.robot_manager.num_actions))
    assert float(env.gtd["robot_position"].norm(dim=1).max()) < 0.06  # leaning rotors lift 2 % less
    angle, thrust = env.gtd["dof_position"][0, ::2], env.gtd["rotor_speed"][0]
    assert 4.0 * float(thrust.mean() * torch.cos(angle.mean())) == pytest.approx(0.29 * G, rel=2e-3)
    mass, length = 0.01625, 0.07
    spring = 5834.85 * mass * length**2
    left = thrust * length - mass * G * length * torch.cos(angle) + mass * G * length * torch.cos(torch.tensor(0.125))
    expected = 0.125 - torch.sqrt(left / spring)
    torch.testing.assert_close(angle, expected, rtol=0.0, atol=1e-3)
    torch.testing.assert_close(env.gtd["dof_state_tensor"][..., 0], env.gtd["dof_position"])


def test_an_arm_on_a_stand_falls_back_by_the_published_law() -> None:
    """``q'' = -k |q - q0| (q - q0) - c q'`` per inertia about the hinge, whatever the arm weighs; a fine step, 1e-4 rad."""
    robot = ROBOTS.get("morphy_fixed_base")
    model = make_model(robot, num_envs=1)
    state = replace(throw(at_rest(model)), joint_pos=torch.tensor([[0.24, 0.0] * 4], dtype=F64))
    angle, rate, dt = 0.24, 0.0, 2.5e-4
    off = torch.zeros(1, 4, dtype=F64)
    for k in range(300):
        state = articulated_step(model, state, off, off[:, :0], dt)
        away = angle - 0.125
        weight = G / 0.07 * (cos(angle) - cos(0.125))
        rate += dt * (-5834.85 * abs(away) * away - 229.24 * rate + weight)
        angle += dt * rate
        if k % 25 == 0:
            assert float(state.joint_pos[0, 0]) == pytest.approx(angle, abs=1e-4)
    assert float(state.position.norm() + state.ang_vel.norm()) == 0.0  # the stand holds


def build(robot: str | RobotCfg, *, sim: str | SimCfg = "base_sim_2ms") -> EnvManager:
    return simulation(robot, sim=sim, env="empty_env_2ms", num_envs=3)


def test_commands_of_drives_stand_behind_those_of_the_rotors() -> None:
    env = build("snakey")
    names = env.robot_manager.action_names
    assert len(names) == 10
    assert names[4:] == tuple(f"{how}_{k} velocity" for k in (1, 2, 3) for how in ("yaw", "roll"))
    env.reset()
    actions = torch.zeros(3, 10)
    actions[:, :4] = 1.225 * G / 4
    actions[:, 4] = 0.5
    for _ in range(10):
        env.step(actions)
    torch.testing.assert_close(env.gtd["dof_velocity"][:, 0], torch.full((3,), 0.5), rtol=0.05, atol=0.0)
    remaining = env.gtd["dof_velocity"][:, 1:].abs().max()
    assert float(remaining) < 0.1


def test_a_position_drive_folds_a_snake_and_a_reset_unfolds_one_alone() -> None:
    env = build("snakey_position")
    env.reset()
    start = env.gtd["dof_position"].clone()
    actions = torch.zeros(3, 10)
    actions[:, 4:] = start + 0.2
    actions[:, [5, 7, 9]] = 0.0
    for _ in range(60):
        env.step(actions)
    torch.testing.assert_close(env.gtd["dof_position"][:, 0], start[:, 0] + 0.2, rtol=0.0, atol=0.05)
    kept = env.gtd["dof_position"][2].clone()
    env.reset(torch.tensor([True, True, False]))
    torch.testing.assert_close(env.gtd["dof_position"][:2], start[:2])
    assert torch.equal(env.gtd["dof_position"][2], kept)


def test_resets_draw_joints_in_their_ranges_and_apart() -> None:
    env = build("morphy")
    env.reset()
    angles, rates = env.gtd["dof_position"], env.gtd["dof_velocity"]
    assert float(angles.abs().max()) <= 0.1
    assert float(rates.abs().max()) <= 0.05
    assert len(angles.flatten().unique()) == angles.numel()


def test_rk4_of_a_vehicle_with_joints_is_refused_by_name() -> None:
    with pytest.raises(CapabilityError, match="no integrator 'rk4'"):
        build("morphy", sim=replace(SIMS.get("base_sim_2ms"), integrator="rk4"))


@pytest.mark.slow
def test_ends_hold_arms_that_thrust_pushes_beyond_them() -> None:
    """At full thrust, 2 N on 0.07 m: past the upper end by what spring and end share."""
    model = make_model(ROBOTS.get("morphy_fixed_base"), num_envs=1)
    state = at_rest(model)
    full = torch.full((1, 4), 2.0, dtype=F64)
    for _ in range(500):
        state = articulated_step(model, state, full, full[:, :0], 4e-3)
    mass, length = 0.01625, 0.07
    spring, end = 5834.85 * mass * length**2, 2.8291
    angle, aside = state.joint_pos[0, :2].tolist()
    reach = length * cos(aside)  # of an arm that the drag of its rotor turns sideways, on the ends there
    gravity = mass * G * (reach * cos(angle) - length * cos(0.125))
    balance = 2.0 * reach - gravity - spring * (0.125 - angle) ** 2 - end * (-0.25 - angle)
    assert abs(balance) < 1e-4
    assert -0.25 - angle == pytest.approx((2.0 * length - spring * 0.375**2) / (end + 2 * spring * 0.375), rel=0.05)
    assert sqrt(float(state.joint_vel.square().sum())) < 1e-6


CREEP = (
    CreepCfg(stiffness=0.277, time=0.048),
    CreepCfg(stiffness=0.133, time=0.365),
    CreepCfg(stiffness=0.052, time=4.04),
)
"""[N m/rad], [s]."""


def creep_arm(creep: tuple[CreepCfg, ...]) -> RobotCfg:
    """Morphy on a stand without weight, with linear springs in the elevations, of which part creeps."""
    robot = ROBOTS.get("morphy_fixed_base")
    spring = SpringCfg(stiffness=0.388, damping=0.0045, rest=0.1247, creep=creep)
    layout = tuple(
        replace(joint, ends=None, spring=spring if joint.name.startswith("elevation") else joint.spring)
        for joint in robot.joints.layout
    )
    return replace(robot, joints=replace(robot.joints, layout=layout))


def let_go(dt: float, num_steps: int) -> Tensor:
    """Return the elevation after each step of an arm that is let go 0.4 rad from its stop, where all has relaxed."""
    model = replace(make_model(creep_arm(CREEP), num_envs=1), gravity=0.0)
    bends = model.articulation
    state = replace(at_rest(model), joint_pos=torch.tensor([[0.4, 0.0] * 4], dtype=F64))
    crept, off, seen = (
        bends.initialise_creep(bends.unset_dashpots(1), state.joint_pos),
        torch.zeros(1, 4, dtype=F64),
        [],
    )
    for _ in range(num_steps):
        state = articulated_step(model, state, off, off[:, :0], dt, crept=crept)
        crept = bends.advance_creep(crept, state.joint_pos, dt)
        seen.append(state.joint_pos[0, 0])
    return torch.stack(seen)


@pytest.mark.slow
def test_an_arm_that_creeps_is_the_generalised_maxwell_model() -> None:
    """Against the modes of the linear law by which ``identify joint`` fits records; the error of 0.3 s halves with the step."""
    inertia = 0.01625 * 0.07**2
    params = {"stiffness": 0.388 / inertia, "damping": 0.0045 / inertia, "rest": 0.1247}
    for i, element in enumerate(CREEP, 1):
        params |= {f"stiffness_{i}": element.stiffness / inertia, f"time_{i}": element.time}
    apart = []
    for dt in (1e-3, 5e-4):
        number = round(0.3 / dt)
        time = dt * np.arange(1, number + 1)
        right = law_angle(ReleaseRecord(path="", time=time, angle=time, start=0.4), params)
        apart.append(float(np.sqrt(np.mean((let_go(dt, number).numpy() - right) ** 2))))
    assert apart[0] / apart[1] == pytest.approx(2.0, abs=0.2)
    assert apart[1] < 2e-3
