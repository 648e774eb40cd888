"""Links that touch the ground or each other, in MuJoCo as a backend: rest, overlap, momentum and energy in closed form.
All in float64 but for whole simulations. K is the stiffness of a ``ContactCfg`` per mass of the whole vehicle."""

from dataclasses import replace
from math import cos, inf, sin
from pathlib import Path

import pytest
import torch
from scipy.optimize import brentq

from aerial_gym.errors import CapabilityError
from aerial_gym.math.quaternion import quat_from_euler, quat_rotate
from aerial_gym.physics.articulated.steppers import implicit_euler
from aerial_gym.physics.articulated.tree import TreeState
from aerial_gym.physics.ground import LinkContacts, Solid
from aerial_gym.robots import ROBOTS
from aerial_gym.robots.joints.obstacle_sweep import shapes_on_links
from tests.cross.mujoco.contact.arms import (
    ARM,
    ARM_MASS,
    CFG,
    FEET,
    HINGES,
    MASS,
    MIDDLE,
    ContactRig,
    G,
    arm_state,
    link_shape,
    springs,
    two_arms,
    weights,
)
from tests.cross.mujoco.contact.on_legs import FILE, LEGS, build, let_go, put, put_down
from tests.cross.mujoco.contact.test_obstacles import foot_shapes, place_solids
from tests.physics.vehicles import F64

pytest.importorskip("mujoco", reason="MuJoCo is not installed: pip install 'aerial-gym[mujoco]'")


@pytest.mark.parametrize(("dt", "damping", "span"), [(0.002, 0.2, 1.5), (0.01, 0.02, 6.0), (0.01, 0.2, 6.0)])
def test_a_vehicle_on_its_arms_bends_and_sinks_as_springs_say(dt: float, damping: float, span: float) -> None:
    """A foot each: m g = 2 K m depth; of an arm the hinge carries ``(M g L / 2 - m_a g l) cos q``, here up."""
    stiffness = 2.0
    tree, links = two_arms("revolute", HINGES, 0.05), weights(0.1)
    rig = ContactRig(tree, links, springs(stiffness, damping), LinkContacts(links=(1, 2)), FEET, dt=dt, friction=0.0)
    state = rig.run(arm_state(0.03), span)
    moment = 0.5 * MASS * G * ARM - ARM_MASS * G * 0.1
    up = brentq(lambda q: stiffness * q - moment * cos(q), 0.0, 1.0)
    assert state.joint_pos.tolist() == [pytest.approx([-up, -up], rel=1e-4)]
    assert state.lin_vel.norm() < 1e-6
    depth = 0.01 - (state.position[0, 2].item() + ARM * sin(up))
    assert depth == pytest.approx(CFG.sinking / 2.0, rel=1e-3)
    rig.impulse.zero_()
    rig.run(state, 0.2)
    assert rig.impulse.tolist() == [pytest.approx([0.0, 0.0, MASS * G * 0.2], abs=1e-6)]


@pytest.mark.parametrize(
    ("radius", "half", "contacts"),
    [(0.02, (0.0, 0.0, 0.0), 1), (0.0, (0.02, 0.01, 0.01), 4), (0.02, (0.0, 0.0, 0.03), 2)],
    ids=["spheres", "boxes", "capsules"],
)
def test_links_that_are_pressed_together_overlap_as_two_springs_say(
    radius: float, half: tuple[float, float, float], contacts: int
) -> None:
    """A force F of springs holds an overlap of ``2 F / (n K m)``, and the whole stays where it is: nobody pushes it. Of
    faces the corners touch, of edges the ends."""
    stiffness, rest = 30.0, 0.05
    tree, links = two_arms("prismatic", ((-1.0, 0.0, 0.0), (1.0, 0.0, 0.0)), 0.05), weights(0.0)
    on = LinkContacts(links=(), shapes=(link_shape(1, radius, half), link_shape(2, radius, half)), pairs=((0, 1),))
    rig = ContactRig(tree, links, springs(stiffness, 1.0, (rest, rest)), on, (), dt=0.002, gravity=0.0)
    state = rig.run(arm_state(1.0), 0.6)
    force = stiffness * (rest - state.joint_pos[0, 0].item())
    overlap = 2.0 * (state.joint_pos[0, 0].item() - 0.03)  # faces of half widths 0.02 m meet after 0.03 m each
    assert overlap == pytest.approx(2.0 * force / (CFG.stiffness * MASS * contacts), rel=1e-2)
    assert overlap > 1e-4
    assert (state.position - torch.tensor([[0.0, 0.0, 1.0]])).abs().max() < 1e-9
    assert state.lin_vel.norm() + state.ang_vel.norm() < 1e-9
    assert rig.impulse.abs().max() < 1e-9


def test_shapes_that_are_no_pair_pass_through_each_other() -> None:
    tree, links = two_arms("prismatic", ((-1.0, 0.0, 0.0), (1.0, 0.0, 0.0)), 0.05), weights(0.0)
    on = LinkContacts(links=(), shapes=(link_shape(1, 0.02, MIDDLE), link_shape(2, 0.02, MIDDLE)))
    rig = ContactRig(tree, links, springs(30.0, 1.0, (0.05, 0.05)), on, (), dt=0.002, gravity=0.0)
    state = rig.run(arm_state(1.0), 1.0)
    assert state.joint_pos.tolist() == [pytest.approx([0.05, 0.05], abs=1e-4)]


def test_a_fall_on_an_arm_gains_no_energy_and_the_ground_gives_what_momentum_lacks() -> None:
    """It comes down with one arm first, at 1 m/s; what semi-implicit steps of 1 ms err by is some percent of the motion."""
    tree, links = two_arms("revolute", HINGES, 0.05), weights(0.1)
    rig = ContactRig(tree, links, springs(2.0, 0.002), LinkContacts(links=(1, 2)), FEET, dt=0.001)
    state = arm_state(0.05, lin_vel=(0.1, 0.0, -1.0), attitude=(0.0, sin(0.05), 0.0, cos(0.05)))
    most, momentum = rig.energy_and_momentum(state)
    first, energy, final = most, most, momentum
    for _ in range(800):
        state = rig.step(state)
        energy, final = rig.energy_and_momentum(state)
        most = max(most, energy)
    assert most < first + 0.02 * (0.5 * MASS)
    assert energy < first - 0.4 * (0.5 * MASS)
    gained = final - momentum + torch.tensor([[0.0, 0.0, 0.8 * MASS * G]], dtype=F64)
    torch.testing.assert_close(rig.impulse, gained, rtol=0.0, atol=5e-3 * float(gained[0, 2]))


def test_contacts_push_a_drive_as_they_push_a_spring_of_its_numbers() -> None:
    """The same step but for rounding: what touches is pushed at the rates of its start."""
    tree, links = two_arms("revolute", HINGES, 0.05), weights(0.1)
    rig = ContactRig(tree, links, springs(2.0, 0.02), LinkContacts(links=(1, 2)), FEET, dt=0.002)
    actual = reference = arm_state(0.02, lin_vel=(0.1, 0.0, -1.0), ang_vel=(0.0, 3.0, 1.0))
    for _ in range(50):
        actual, reference = rig.step(actual), rig.step(reference, driven=True)
    assert rig.impulse[0, 2] > 0.1
    for name, values in vars(actual).items():
        torch.testing.assert_close(getattr(reference, name), values, rtol=0.0, atol=1e-9)


def test_a_robot_stands_on_legs_under_its_arms(on_legs: str) -> None:
    """All four carry its weight; the ends of its joints bear what the springs do not; 0.29 kg."""
    sim, crashed = put_down(on_legs, 0.08, 0.5)
    weight = torch.tensor([[0.0, 0.0, 0.29 * G]]).repeat(2, 1)
    torch.testing.assert_close(sim.gtd["robot_contact_force"], weight, rtol=0.0, atol=0.02 * 0.29 * G)
    assert (sim.gtd["dof_position"][:, ::2] < -0.1).all()  # arms bend up
    assert (sim.gtd["robot_position"][:, 2] > 0.03).all()
    assert not crashed.any()


def test_a_fast_touch_of_a_leg_is_a_crash(on_legs: str) -> None:
    assert put_down(on_legs, 0.8, 0.45)[1].all()


def test_what_cannot_be_pushed_is_refused_by_name(on_legs: str) -> None:
    with pytest.raises(CapabilityError, match="push back at a contact of a vehicle with joints. Use backend 'mujoco'"):
        build(on_legs, backend="warp")


def test_a_snake_whose_rods_push_each_other_flies() -> None:
    """Rods that no joint connects are pairs, in the axes of their links; folded far enough they push, and it stays whole."""
    robot = ROBOTS.get("snakey_position")
    robot = replace(robot, collision=replace(robot.collision, between_links=True))
    spheres, on = shapes_on_links(robot, device=torch.device("cpu"))
    assert len(spheres) == len(on.links) == 2 * len(on.shapes)  # ends of capsules
    assert all(abs(on.shapes[one].link - on.shapes[other].link) > 1 for one, other in on.pairs)
    assert on.pairs
    for shape in on.shapes:
        assert max(abs(c) for c in shape.center) <= 1.0, shape.link  # a rod begins at its joint
    sim = build(robot)
    sim.reset()
    sim.gtd["robot_position"][:, 2] = 2.0
    for _ in range(5):
        sim.step(torch.zeros_like(sim.gtd["robot_actions"]))
    assert sim.gtd["dof_position"].isfinite().all()


HANGING = torch.tensor([[0.0, torch.pi / 2.0]], dtype=F64)
ARM_WEIGHT, COM = ARM_MASS * G, 0.1


def on_a_stand(on: LinkContacts, *, height: float = -inf, stiffness: float = 0.0, gravity: float = G) -> ContactRig:
    tree = replace(two_arms("revolute", HINGES, 0.05), floating=False)
    law = springs(stiffness, 0.02)
    return ContactRig(tree, weights(COM), law, on, FEET, dt=0.002, friction=0.0, height=height, gravity=gravity)


def test_arms_that_fall_on_the_ground_rest_on_it_at_the_angle_of_their_height() -> None:
    """Each foot carries ``m_a g l / L``, and the ground's impulse is both; the stand carries the rest, and stays."""
    rig = on_a_stand(LinkContacts(links=(1, 2)), height=0.4)
    first = replace(
        arm_state(0.5), lin_vel=torch.ones(1, 3, dtype=F64), ang_vel=torch.ones(1, 3, dtype=F64)
    )  # it has none
    state = rig.run(first, 2.0)
    force = ARM_WEIGHT * COM / ARM
    depth = force / (CFG.stiffness * MASS)
    down = ARM * torch.sin(state.joint_pos[0]) + 0.01 - 0.1
    torch.testing.assert_close(down, torch.full_like(down, depth), rtol=1e-3, atol=0.0)
    assert rig.bodies.impulse.tolist() == [pytest.approx([0.0, 0.0, 2.0 * force * 0.002], rel=1e-5, abs=1e-12)]
    assert torch.equal(state.position, first.position)
    assert not state.lin_vel.any()
    assert not state.ang_vel.any()


@pytest.mark.parametrize("turned", [False, True])
def test_a_wall_stops_a_pendulum_at_the_angle_of_geometry(turned: bool) -> None:
    """Where ``0.05 + L cos q - r`` is at the wall, less the overlap of the force that holds it,
    ``m_a g l cos q / (L sin q)``. The other arm hangs down all the time. Turned about the vertical and set down elsewhere
    everything is as before."""
    face = 0.15
    attitude = quat_from_euler(torch.tensor([[0.0, 0.0, 0.8 if turned else 0.0]], dtype=F64))
    place = torch.tensor([[3.0, -2.0, 1.5]], dtype=F64) * turned
    middle = place + quat_rotate(attitude, torch.tensor([[face - 0.02, 0.0, -0.1]], dtype=F64))
    wall = Solid(kind="box", size=(0.02, 0.5, 0.5))
    rig = on_a_stand(foot_shapes(place_solids(wall, places=middle.tolist(), attitudes=attitude.tolist())))
    state = rig.run(replace(arm_state(0.0), position=place, attitude=attitude, joint_pos=HANGING), 2.0)

    def overlap(q: torch.Tensor) -> torch.Tensor:
        return ARM_WEIGHT * COM / (ARM * torch.tan(q)) / (CFG.stiffness * MASS)

    def excess(q: float) -> float:
        angle = torch.tensor(q, dtype=F64)
        return float(0.05 + ARM * torch.cos(angle) - 0.01 - face + overlap(angle))

    stop = brentq(excess, 0.5, 1.5)
    assert state.joint_pos.tolist() == [pytest.approx([stop, torch.pi / 2.0], abs=1e-6)]
    force = overlap(torch.tensor(stop, dtype=F64)) * CFG.stiffness * MASS
    expected = quat_rotate(attitude, torch.tensor([[float(force), 0.0, 0.0]], dtype=F64))
    torch.testing.assert_close(rig.bodies.impulse, 0.002 * expected, rtol=1e-4, atol=1e-9)


def test_without_a_touch_it_swings_as_the_engine_of_this_package_has_it() -> None:
    """A tilted stand among an obstacle far away, beside ``implicit_euler``; drives and friction left out."""
    rig = on_a_stand(
        foot_shapes(place_solids(Solid(kind="box", size=(1.0, 1.0, 1.0)), places=[(9.0, 0.0, 0.0)])), stiffness=1.0
    )
    attitude = quat_from_euler(torch.tensor([[0.4, -0.7, 1.2]], dtype=F64))
    start = replace(arm_state(2.0), attitude=attitude, joint_vel=torch.tensor([[3.0, -1.0]], dtype=F64))
    actual: TreeState = start
    reference: TreeState = start
    for _ in range(50):
        actual = rig.step(actual)
        reference = implicit_euler(
            rig.tree, rig.links, [rig.law], reference, 0.002, gravity=G, wrench=torch.zeros(1, 3, 6, dtype=F64)
        )
    torch.testing.assert_close(actual.joint_pos, reference.joint_pos, rtol=0.0, atol=1e-9)
    torch.testing.assert_close(actual.joint_vel, reference.joint_vel, rtol=0.0, atol=1e-9)
    assert (actual.joint_pos - start.joint_pos).abs().max() > 0.01
    assert not rig.impulse.any()


def test_a_robot_on_its_stand_rests_its_legs_on_the_ground(tmp_path: Path) -> None:
    """In a simulation: its base, put down too low for arms that are level, stays there, and the ground bends the arms up."""
    (tmp_path / "on_a_stand.yaml").write_text(
        FILE.replace("extends: morphy", "extends: morphy_fixed_base").replace("LEGS", LEGS)
    )
    ends = []
    for low in (0.0, 0.02):
        sim = build(str(tmp_path / "on_a_stand.yaml"))
        put(sim, torch.tensor([0.0, 0.0, 0.06 - low]))
        crashed = let_go(sim, 0.5)
        assert (sim.gtd["robot_position"][:, 2] == 0.06 - low).all()
        assert not crashed.any()
        ends.append((sim.gtd["dof_position"][:, ::2].clone(), sim.gtd["robot_contact_force"][:, 2].clone()))
        assert (sim.gtd["robot_clearance"].abs() < 1e-3).all()
    assert (ends[1][0] < ends[0][0] - 0.1).all()
    assert (ends[1][1] > 2.0 * ends[0][1]).all()
