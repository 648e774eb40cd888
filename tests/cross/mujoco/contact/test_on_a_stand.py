"""Links of a vehicle on a stand that touch ground, walls and each other, in MuJoCo as a backend, in closed form. All in
float64 but for the simulation. K is the stiffness of a ``ContactCfg`` per mass of the whole vehicle; arms hang on
hinges 0.05 m beside the base, 0.2 m to the middle of a foot of 0.01 m."""

from dataclasses import replace
from math import inf
from pathlib import Path

import pytest
import torch
from scipy.optimize import brentq

from aerial_gym.math.quaternion import quat_from_euler, quat_rotate
from aerial_gym.physics.articulated.steppers import implicit_euler
from aerial_gym.physics.articulated.tree import TreeState
from aerial_gym.physics.ground import LinkContacts
from aerial_gym.physics.solids import Solid
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
from tests.cross.mujoco.contact.on_legs import FILE, LEGS, build, let_go, put
from tests.cross.mujoco.contact.test_obstacles import foot_shapes, place_solids
from tests.physics.vehicles import F64

pytest.importorskip("mujoco", reason="MuJoCo is not installed: pip install 'aerial-gym[mujoco]'")

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


def test_arms_of_a_stand_push_each_other() -> None:
    """Hanging straight down from hinges 0.1 m apart, bent inwards by springs until spheres of 0.04 m at their feet meet. The
    hinge moment ``k (rest - q)`` is what force at the feet and weight at an angle give back."""
    stiffness, rest = 0.5, torch.pi / 2.0 + 0.5
    shapes = tuple(replace(link_shape(k, 0.04, MIDDLE), center=foot[:3]) for k, foot in enumerate(FEET, 1))
    on = LinkContacts(links=(), shapes=shapes, pairs=((0, 1),))
    tree = replace(two_arms("revolute", HINGES, 0.05), floating=False)
    rig = ContactRig(tree, weights(COM), springs(stiffness, 0.05, (rest, rest)), on, (), dt=0.002, height=-inf)
    down = torch.full((1, 2), torch.pi / 2.0, dtype=F64)
    state = rig.run(replace(arm_state(1.0), joint_pos=down), 3.0)

    def excess(q: float) -> float:
        angle = torch.tensor(q, dtype=F64)
        overlap = 0.08 - 2.0 * (0.05 + ARM * torch.cos(angle))
        force = 0.5 * CFG.stiffness * MASS * overlap
        moment = stiffness * (rest - angle) + ARM_WEIGHT * COM * torch.cos(angle)
        return float(moment - force * ARM * torch.sin(angle))

    meet = brentq(excess, torch.pi / 2.0, torch.pi / 2.0 + 0.4)
    assert state.joint_pos.tolist() == [pytest.approx([meet, meet], abs=1e-5)]
    assert rig.bodies.impulse.norm() < 1e-9


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
