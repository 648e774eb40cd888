"""Drag of links against closed forms and conservation laws, on the reference engine; on the fused one in ``tests/cross``."""

from dataclasses import replace

import pytest
import torch
from torch import Tensor

from aerial_gym.config.joint import JointCfg, JointsCfg, LinkCfg
from aerial_gym.config.robot import RobotCfg
from aerial_gym.math.quaternion import quat_rotate_inverse, quat_to_matrix
from aerial_gym.physics.articulated.articulation import build_articulation
from aerial_gym.physics.articulated.flight import articulated_step, link_damping
from aerial_gym.physics.articulated.link_loads import LinkDamping, motion_in_air
from aerial_gym.physics.articulated.motion import place_links
from aerial_gym.physics.articulated.steppers import implicit_euler
from aerial_gym.physics.articulated.tree import Links, Tree, TreeState
from aerial_gym.physics.effects.links import LinkDrag
from aerial_gym.physics.model import Model, build_model, check_effects, robot_effects
from aerial_gym.physics.state import ArticulatedState, state_at_rest
from aerial_gym.physics.vehicle import vehicle_from_config
from aerial_gym.robots import ROBOTS
from tests.physics.articulated.trees import (
    F64,
    kinetic_energy,
    momenta,
    pendulum,
    random_links,
    random_motion,
    random_tree,
)

G = 9.81

ORDERS = ("lx", "ly", "lz", "qx", "qy", "qz", "ax", "ay", "az", "bx", "by", "bz")


def make_damping(
    tree: Tree, links: Links, state: TreeState, wind: Tensor | None = None, **numbers: float
) -> tuple[LinkDamping, Tensor]:
    """Return the damping of all links, and the parameters, (E, 12); ``l=0.1`` sets all three axes."""
    row = torch.tensor([numbers.get(name, numbers.get(name[0], 0.0)) for name in ORDERS], dtype=F64)
    params = row.expand(len(state.position), -1)
    wind = torch.zeros_like(state.lin_vel) if wind is None else wind
    velocity, turned_wind = motion_in_air(
        tree, links, state.joint_pos, state.joint_vel, quat_rotate_inverse(state.attitude, state.lin_vel),
        state.ang_vel, quat_rotate_inverse(state.attitude, wind),
    )  # fmt: skip
    damping = LinkDrag().damping(velocity, params)
    return LinkDamping(velocity=velocity, damping=damping, turned_wind=turned_wind), params


def swing(
    dt: float, span: float, start: float, *, linear: float = 0.0, quadratic: float = 0.0, gravity: float = G
) -> Tensor:
    tree, links = pendulum(0.5, 0.2)
    state = TreeState.at_rest(1, 1, like=links.mass)
    state.joint_pos[:] = start
    state.joint_vel[:] = 2.0 * (gravity == 0.0)
    for _ in range(round(span / dt)):
        damping, _ = make_damping(tree, links, state, l=linear, q=quadratic)
        state = implicit_euler(tree, links, (), state, dt, gravity=gravity, damping=damping)
    return torch.cat((state.joint_pos, state.joint_vel))[:, 0]


def test_quadratic_drag_slows_a_link_hyperbolically() -> None:
    """Without weight ``m l q'' = -d l² q'²``: ``q' = q0' / (1 + d l q0' t / m)``. The step ends with the speed of its start in
    ``q0' / (1 + d l q0' dt / m)``: it is exact at every length."""
    quadratic, mass, length = 0.3, 0.2, 0.5
    for dt in (0.25, 4e-3):
        rate = float(swing(dt, 1.0, 0.0, quadratic=quadratic, gravity=0.0)[1])
        assert rate == pytest.approx(2.0 / (1.0 + quadratic * length * 2.0 / mass), rel=1e-9)


def make_drag_robot(
    mass: float, joints: tuple[JointCfg, ...], drag: dict[str, float], **rest: dict[str, float]
) -> RobotCfg:
    robot = ROBOTS.get("base_quadrotor")
    links = [joint.link for joint in joints if joint.link is not None]
    masses = torch.tensor([mass, *(link.mass for link in links)], dtype=F64)
    coms = torch.tensor([(0.0, 0.0, 0.0), *(link.com for link in links)], dtype=F64)
    com = (masses @ coms) / masses.sum()
    inertia = 0.02 * torch.eye(3, dtype=F64)
    for link in links:
        inertia = inertia + torch.tensor(link.inertia, dtype=F64)
    for m, lever in zip(masses, coms - com, strict=True):
        inertia = inertia + m * (lever @ lever * torch.eye(3, dtype=F64) - lever.outer(lever))
    body = replace(
        robot.body, mass=float(masses.sum()), com=tuple(com.tolist()), inertia=tuple(map(tuple, inertia.tolist()))
    )
    effects = {"link_drag": drag, **rest}
    return replace(
        robot, body=body, joints=JointsCfg(layout=joints, floating=True, source="test"), effects=effects,
        effects_source="test",
    )  # fmt: skip


def arm(name: str, com: tuple[float, float, float], position: tuple[float, float, float], **rest: object) -> JointCfg:
    lump = ((1e-4, 0.0, 0.0), (0.0, 1e-4, 0.0), (0.0, 0.0, 1e-4))
    defaults = {"axis": (0.0, 0.0, 1.0), "link": LinkCfg(mass=0.1, com=com, inertia=lump)}
    return JointCfg(name=name, position=position, **(defaults | rest))


def make_model(robot: RobotCfg, *, gravity: float = 0.0, num_envs: int = 1) -> tuple[Model, ArticulatedState]:
    vehicle = vehicle_from_config(robot, num_envs=num_envs, dtype=F64)
    check_effects(robot)
    effects = robot_effects(robot, num_envs=num_envs, device=torch.device("cpu"), dtype=F64)
    articulation = build_articulation(robot, like=vehicle.mass)
    model = build_model(vehicle, effects, gravity=gravity, articulation=articulation)
    body = state_at_rest(num_envs, vehicle.num_rotors, device=torch.device("cpu"), dtype=F64)
    joints = articulation.reference.repeat(num_envs, 1)
    return model, ArticulatedState(**vars(body), joint_pos=joints, joint_vel=torch.zeros_like(joints))


def fly(model: Model, state: ArticulatedState, dt: float, steps: int) -> ArticulatedState:
    for _ in range(steps):
        state = articulated_step(model, state, state.rotor_speed, state.joint_pos[:, :0], dt)
    return state


@pytest.mark.parametrize("floating", [True, False])
def test_forces_of_links_are_the_rate_of_momentum(floating: bool) -> None:
    """Of random trees without weight in wind: ``P' = sum F`` and ``L' = sum (x x F + T)`` of free ones, and the power of
    F and T, in the world, from velocities that differences of places say: ``F = -R (l + q |u|) R^T u``, and T likewise."""
    tree, dt = random_tree(5, 1, floating=floating), 1e-6
    links, state = random_links(tree, 8, 1), random_motion(tree, 8, 1)
    wind = torch.randn(8, 3, dtype=F64, generator=torch.Generator().manual_seed(2))
    damping, params = make_damping(
        tree, links, state, wind, lx=0.1, ly=0.3, lz=0.05, q=0.2, ax=0.01, ay=0.02, az=0.03, b=0.01
    )

    def link_motion(at: TreeState) -> tuple[Tensor, Tensor]:
        places, turn = place_links(tree, links, at.joint_pos), quat_to_matrix(at.attitude).unsqueeze(1)
        return at.position.unsqueeze(1) + (turn @ places.com.unsqueeze(-1)).squeeze(-1), turn @ places.rotation

    coasting = implicit_euler(tree, links, (), state, dt, gravity=0.0)
    drifting = implicit_euler(tree, links, (), state, dt, gravity=0.0, damping=damping)
    (first, turned), (second, after) = link_motion(state), link_motion(coasting)
    through = (second - first) / dt - wind.unsqueeze(1)
    rate = (after - turned) / dt @ turned.mT  # the skew matrix of the angular velocity
    turning = torch.stack((rate[..., 2, 1], rate[..., 0, 2], rate[..., 1, 0]), dim=-1)
    linear, quadratic, turn, whirl = params.unsqueeze(1).split(3, dim=-1)

    def drag_force(velocity: Tensor, per_speed: Tensor, per_square: Tensor) -> Tensor:
        own = (turned.mT @ velocity.unsqueeze(-1)).squeeze(-1)
        own = (per_speed + per_square * own.norm(dim=-1, keepdim=True)) * own
        return -(turned @ own.unsqueeze(-1)).squeeze(-1)

    force, torque = drag_force(through, linear, quadratic), drag_force(turning, turn, whirl)
    if floating:
        expected = (force.sum(1), (torch.linalg.cross(first, force) + torque).sum(1))
        after_drag, without = momenta(tree, links, drifting), momenta(tree, links, coasting)
        for result, before, rate in zip(after_drag, without, expected, strict=True):
            torch.testing.assert_close((result - before) / dt, rate, rtol=1e-4, atol=1e-4)
    power = (force * (through + wind.unsqueeze(1))).sum((1, 2)) + (torque * turning).sum((1, 2))
    gained = (kinetic_energy(tree, links, drifting) - kinetic_energy(tree, links, coasting)) / dt
    torch.testing.assert_close(gained, power, rtol=1e-4, atol=1e-4)


@pytest.mark.parametrize("size", [1.0, 1e4])
def test_energy_only_falls_in_still_air_however_large_drag_is(size: float) -> None:
    """Of random trees without weight, links of 0.1 to 1 kg: ``d dt`` is 0.1 kg and more, and 1e3 kg. Held through the step that
    diverges."""
    tree, dt = random_tree(5, 4), 0.01
    links, state = random_links(tree, 16, 4), random_motion(tree, 16, 4)
    held = state
    for step in range(30):
        damping, _ = make_damping(tree, links, state, l=10.0 * size, q=size, a=0.1 * size, b=0.01 * size)
        end = implicit_euler(tree, links, (), state, dt, gravity=0.0, damping=damping)
        assert bool((kinetic_energy(tree, links, end) < kinetic_energy(tree, links, state)).all()), step
        state = end
        if size > 1.0 and step < 5:
            damping, _ = make_damping(tree, links, held, l=10.0 * size, q=size, a=0.1 * size, b=0.01 * size)
            held = implicit_euler(tree, links, (), held, dt, gravity=0.0, wrench=damping.start_wrench(links))
    if size > 1.0:
        assert not bool((kinetic_energy(tree, links, held) < 1e6).any())


def test_a_number_of_a_link_stands_in_place_of_that_of_all() -> None:
    """A link that moves at 2 m/s along its x and turns about its z at 1 rad/s, and one at rest."""
    robot = ROBOTS.get("morphy")
    drag = {"qx": 0.1, "lz": 0.2, "azimuth_2.qx": 0.3, "azimuth_2.ay": 0.4, "base.lz": 0.0}
    robot = replace(robot, effects={"link_drag": drag}, effects_source="test")
    model, _ = make_model(robot)
    ((effect, params),) = list(model.effects)
    assert [p.name for p in effect.parameters] == list(drag)
    assert effect.parameters[2].meaning == "force per speed squared along x of azimuth_2"
    velocity = torch.tensor([2.0, 0.0, 0.0, 0.0, 0.0, 1.0], dtype=F64).expand(1, 9, 6)
    result = effect.damping(velocity, params)[0]
    expected = torch.tensor([[0.2, 0.0, 0.2, 0.0, 0.0, 0.0]], dtype=F64).repeat(9, 1)
    expected[0, 2] = 0.0
    place = robot.joints.link_names.index("azimuth_2")
    expected[place, 0], expected[place, 4] = 0.6, 0.4
    torch.testing.assert_close(result, expected)
    expected[:, 0], expected[place, 4] = 0.0, 0.4
    torch.testing.assert_close(effect.damping(0.0 * velocity, params)[0], expected)


def test_links_without_mass_feel_nothing_and_the_base_what_others_do() -> None:
    """Of morphy's universal joints: five of nine links have mass."""
    robot = replace(ROBOTS.get("morphy"), effects={"link_drag": {"lx": 0.1}}, effects_source="test")
    model, state = make_model(robot)
    links = model.articulation.links(model.vehicle)
    tree = TreeState(**{name: rows for name, rows in vars(state).items() if name != "rotor_speed"})
    acts = link_damping(model, model.articulation, links, tree)
    assert acts.damping[0, :, 0].tolist() == [0.1, 0.0, 0.1, 0.0, 0.1, 0.0, 0.1, 0.0, 0.1]


def test_slopes_are_finite_at_rest_in_still_air() -> None:
    model, state = make_model(
        make_drag_robot(1.0, (arm("left", (0.0, 0.4, 0.0), (0.0, 0.1, 0.0)),), {"qx": 0.3, "bz": 0.02})
    )
    ((law, params),) = model.effects
    inputs = [torch.zeros_like(rows).requires_grad_() for rows in (params, state.joint_pos, state.joint_vel)]
    there = replace(model, effects=type(model.effects)([(law, inputs[0])]))
    after = fly(there, replace(state, joint_pos=inputs[1], joint_vel=inputs[2]), 0.01, 3)
    for slope in torch.autograd.grad(after.joint_vel.sum(), inputs, allow_unused=True):
        assert slope is None or bool(slope.isfinite().all())
