"""Obstacles that push links, in MuJoCo as a backend: in closed form, beside flat ground, and beside a model written by
hand. Without a simulation around all is in float64; steps begin and end in the same frame as the obstacles. K is the
stiffness of a ``ContactCfg`` per mass of the whole vehicle."""

from dataclasses import replace
from itertools import product
from math import cos, inf, sin

import numpy as np
import pytest
import torch

from aerial_gym.math.quaternion import quat_exp, quat_from_euler, quat_multiply, quat_rotate
from aerial_gym.physics.articulated.tree import TreeState
from aerial_gym.physics.ground import LinkContacts, Solid, Solids
from aerial_gym.physics.mujoco.mjcf import solver_numbers
from tests.cross.mujoco.contact.arms import (
    ARM,
    CFG,
    FEET,
    HINGES,
    MASS,
    MIDDLE,
    ContactRig,
    arm_state,
    link_shape,
    springs,
    two_arms,
    weights,
)
from tests.physics.vehicles import F64

mujoco = pytest.importorskip("mujoco", reason="MuJoCo is not installed: pip install 'aerial-gym[mujoco]'")

BLOCK = Solid(kind="box", size=(2.0, 2.0, 0.5))
CUBE = tuple(product((-0.5, 0.5), repeat=3))


def place_solids(
    *solids: Solid, places, attitudes=((0.0, 0.0, 0.0, 1.0),), twists=(0.0,) * 6, moves: bool = False
) -> Solids:
    """Return obstacles of one part each, in one environment."""
    count = torch.arange(len(solids), dtype=torch.int32)[None]
    state = torch.zeros(1, len(solids), 13, dtype=F64)
    state[0, :, :3], state[0, :, 3:7] = torch.tensor(places, dtype=F64), torch.tensor(attitudes, dtype=F64)
    state[0, :, 7:] = torch.tensor(twists, dtype=F64)
    return Solids(table=solids, part=count, carrier=count, state=state, moves=moves)


def foot_shapes(solids: Solids | None) -> LinkContacts:
    shapes = tuple(replace(link_shape(k, 0.01, MIDDLE), center=foot[:3]) for k, foot in enumerate(FEET, 1))
    return LinkContacts(links=(1, 2), shapes=() if solids is None else shapes, solids=solids)


def make_rig(
    solids: Solids | None, *, height: float = -inf, friction: float = 0.5, damping: float = 0.02
) -> ContactRig:
    tree, links, law = two_arms("revolute", HINGES, 0.05), weights(0.1), springs(2.0, damping)
    return ContactRig(tree, links, law, foot_shapes(solids), FEET, dt=0.002, height=height, friction=friction)


STOPS = 1e-4
"""By which share accelerations differ where MuJoCo's solver stops: what it minimises is then 1e-8 above the least."""


def assert_same(actual: TreeState, reference: TreeState, bound: float) -> None:
    for name, values in vars(reference).items():
        torch.testing.assert_close(getattr(actual, name), values, rtol=0.0, atol=bound, msg=name)


TUMBLING = arm_state(0.06, lin_vel=(0.3, 0.1, -1.0), ang_vel=(0.5, 1.0, 2.0))


@pytest.mark.parametrize("moves", [False, True])
def test_a_fall_onto_a_box_is_that_onto_ground_at_its_top(moves: bool) -> None:
    """Until spring, damper and friction have done with it; to rounding, but for the solver where the box is a heavy body."""
    ground, box = make_rig(None, height=0.0), make_rig(place_solids(BLOCK, places=[(0.3, -0.2, 2.0)], moves=moves))
    engine_value = TUMBLING
    package_value = replace(engine_value, position=engine_value.position + torch.tensor([[0.0, 0.0, 2.5]], dtype=F64))
    for _ in range(150):
        package_value, engine_value = box.step(package_value), ground.step(engine_value)
        force = ground.bodies.impulse
        torch.testing.assert_close(box.bodies.impulse, force, rtol=0.0, atol=STOPS * MASS if moves else 1e-12)
    assert ground.impulse[0, 2] > 0.3
    down = replace(package_value, position=package_value.position - torch.tensor([[0.0, 0.0, 2.5]], dtype=F64))
    assert_same(down, engine_value, STOPS if moves else 1e-12)


@pytest.mark.parametrize(
    "solid",
    [
        Solid(kind="box", size=(0.5, 0.5, 0.5)), Solid(kind="sphere", size=(0.5, 0.0, 0.0)),
        Solid(kind="capsule", size=(0.5, 0.3, 0.0)), Solid(kind="cylinder", size=(0.5, 0.5, 0.0)),
        Solid(kind="mesh", vertices=CUBE),
    ],
    ids=lambda solid: solid.kind,
)  # fmt: skip
def test_arms_press_on_obstacles_as_springs_say(solid: Solid) -> None:
    """Prismatic arms between two obstacles: ``k (rest - q) = K m overlap`` of each, and the base stays where it is."""
    stiffness, rest, radius, gap = 30.0, 0.05, 0.02, 0.01
    tree, links = two_arms("prismatic", ((1.0, 0.0, 0.0), (-1.0, 0.0, 0.0)), 0.05), weights(0.0)
    aside = 0.05 + radius + gap + 0.5
    shapes = (link_shape(1, radius, MIDDLE), link_shape(2, radius, MIDDLE))
    solids = place_solids(solid, solid, places=[(aside, 0.0, 1.0), (-aside, 0.0, 1.0)])
    on = LinkContacts(links=(), shapes=shapes, solids=solids)
    rig = ContactRig(tree, links, springs(stiffness, 1.0, (rest, rest)), on, (), dt=0.002, gravity=0.0, height=-inf)
    state = rig.run(arm_state(1.0), 0.6)
    overlap = state.joint_pos[0] - gap
    force = stiffness * (rest - state.joint_pos[0])
    torch.testing.assert_close(overlap, force / (CFG.stiffness * MASS), rtol=1e-3, atol=0.0)
    assert (overlap > 3e-4).all()
    assert (state.position - torch.tensor([[0.0, 0.0, 1.0]])).norm() < 1e-6


def test_a_part_pushes_where_its_compound_carries_it() -> None:
    """Two blocks in one obstacle, turned by a quarter about x and shifted: the upper face is where geometry says."""
    solids = replace(
        place_solids(
            replace(BLOCK, size=(0.5, 0.5, 2.0), position=(0.0, 0.7, 0.0)),
            Solid(kind="sphere", size=(0.1, 0.0, 0.0), position=(0.0, 0.0, 5.0)),
            places=[(0.0, 0.0, 3.0), (0.0, 0.0, 0.0)],
            attitudes=[(sin(np.pi / 4), 0.0, 0.0, cos(np.pi / 4)), (0.0, 0.0, 0.0, 1.0)],
        ),
        carrier=torch.zeros(1, 2, dtype=torch.int32),
    )
    rig = make_rig(solids, friction=0.0, damping=0.2)  # y of the obstacle is up: the face is 0.7 + 0.5 above its origin
    state = rig.run(arm_state(4.25), 1.5)
    foot = state.position[0, 2] - ARM * torch.sin(state.joint_pos[0]) - 0.01
    torch.testing.assert_close(4.2 - foot, torch.full_like(foot, CFG.sinking / 2.0), rtol=1e-3, atol=0.0)


def test_what_moves_with_a_box_falls_on_it_as_on_one_at_rest() -> None:
    """Galilei: box and vehicle both faster by V, which shifts all positions by V t and changes no force, friction included."""
    velocity = torch.tensor([0.7, -0.4, 0.5], dtype=F64)
    rest = make_rig(place_solids(BLOCK, places=[(0.0, 0.0, -0.5)]))
    moving = place_solids(BLOCK, places=[(0.0, 0.0, -0.5)], twists=[(*velocity.tolist(), 0.0, 0.0, 0.0)], moves=True)
    carried = make_rig(moving)
    engine_value = TUMBLING
    package_value = replace(engine_value, lin_vel=engine_value.lin_vel + velocity)
    for _ in range(150):
        package_value, engine_value = carried.step(package_value), rest.step(engine_value)
        moving.state[0, 0, :3] += rest.bodies.dt * velocity
    at_rest = replace(
        package_value, position=package_value.position - 0.3 * velocity, lin_vel=package_value.lin_vel - velocity
    )
    assert_same(at_rest, engine_value, STOPS)
    assert rest.impulse[0, 2] > 0.3


def test_parts_move_as_their_poses_do() -> None:
    """Velocities beside differences of poses half a step before and after, of second order: errors below ``(w h)² v``."""
    generator, h = torch.Generator().manual_seed(0), 1e-4
    state = torch.randn(2, 3, 13, dtype=F64, generator=generator)
    state[..., 3:7] = quat_from_euler(state[..., 3:6])
    turn = quat_from_euler(torch.randn(2, 3, dtype=F64, generator=generator)).tolist()
    table = tuple(Solid(kind="box", position=(0.3 * k, -0.2, 1.0), attitude=tuple(turn[k])) for k in range(2))
    part, carrier = torch.tensor([[0, 1, -1], [1, 1, 0]]), torch.tensor([[0, 2, 0], [1, 0, 2]])

    def at_time(t: float) -> tuple[torch.Tensor, ...]:
        moved = state.clone()
        moved[..., :3] += t * state[..., 7:10]
        moved[..., 3:7] = quat_multiply(quat_exp(t * state[..., 10:]), state[..., 3:7])
        return Solids(table=table, part=part, carrier=carrier, state=moved).motion_of_parts()

    position, attitude, lin_vel, ang_vel = at_time(0.0)
    before, after = at_time(-0.5 * h), at_time(0.5 * h)
    torch.testing.assert_close(lin_vel, (after[0] - before[0]) / h, rtol=0.0, atol=1e-6)
    axis = torch.eye(3, dtype=F64).expand(2, 3, 3, 3)
    edges = [quat_rotate(pose[1].unsqueeze(2).expand(2, 3, 3, 4), axis) for pose in (before, after)]
    spin = quat_rotate(attitude, ang_vel).unsqueeze(2).expand(2, 3, 3, 3)
    own = quat_rotate(attitude.unsqueeze(2).expand(2, 3, 3, 4), axis)
    torch.testing.assert_close((edges[1] - edges[0]) / h, torch.linalg.cross(spin, own), rtol=0.0, atol=1e-6)
    assert not position[0, 2].any()


RAW = """
<mujoco>
  <option timestep="0.002" cone="elliptic" impratio="100" gravity="0 0 -9.81">
    <flag warmstart="disable" eulerdamp="disable"/>
  </option>
  <default><geom condim="3" friction="0.5 0 0"/></default>
  <worldbody>
    <geom type="box" size="2 2 0.5" pos="0.1 0.2 -0.55" quat="0.995 0.0998 0 0"/>
    <geom type="cylinder" size="0.05 0.3" pos="0.25 0 0"/>
    <body name="base" pos="0 0 0.06">
      <freejoint/>
      <inertial pos="0 0 0" mass="0.2" diaginertia="2e-4 2e-4 4e-4"/>
      <body pos="0.05 0 0">
        <joint type="hinge" axis="0 1 0" damping="0.002" armature="4e-6"/>
        <inertial pos="0.1 0 0" mass="0.05" diaginertia="1e-5 1e-5 1e-5"/>
        <geom type="sphere" size="0.01" pos="0.2 0 0"/>
      </body>
      <body pos="-0.05 0 0">
        <joint type="hinge" axis="0 -1 0" damping="0.002" armature="4e-6"/>
        <inertial pos="-0.1 0 0" mass="0.05" diaginertia="1e-5 1e-5 1e-5"/>
        <geom type="sphere" size="0.01" pos="-0.2 0 0"/>
      </body>
    </body>
  </worldbody>
</mujoco>
"""


def test_it_moves_as_a_model_of_mujoco_that_was_written_by_hand() -> None:
    """Dampers alone in its joints, held through a step beside an armature C dt; a tilted box and a pole, both in the world."""
    model = mujoco.MjModel.from_xml_string(RAW)
    model.geom_solref[:], model.geom_solimp[:] = solver_numbers(CFG, 0.002)
    model.body_invweight0[2:, 0] = model.body_invweight0[1, 0] = 1.0 / MASS
    data = mujoco.MjData(model)
    data.qvel[:6] = (0.3, 0.1, -1.0, 0.5, 1.0, 2.0)
    tilt = np.array([0.0998, 0.0, 0.0, 0.995]) / np.hypot(0.995, 0.0998)
    solids = place_solids(
        BLOCK, Solid(kind="cylinder", size=(0.05, 0.3, 0.0)), places=[(0.1, 0.2, -0.55), (0.25, 0.0, 0.0)],
        attitudes=[tuple(tilt), (0.0, 0.0, 0.0, 1.0)],
    )  # fmt: skip
    tree, links = two_arms("revolute", HINGES, 0.05), weights(0.1)
    rig = ContactRig(tree, links, springs(0.0, 0.002), foot_shapes(solids), FEET, dt=0.002, height=-inf)
    state, touches = TUMBLING, 0
    for _ in range(200):
        mujoco.mj_step(model, data)
        touches += data.ncon
        state = rig.step(state)
        result = torch.cat((state.position, state.lin_vel, state.ang_vel, state.joint_pos, state.joint_vel), dim=-1)
        expected = (*data.qpos[:3], *data.qvel[:6], *data.qpos[7:], *data.qvel[6:])
        np.testing.assert_allclose(result[0].numpy(), expected, rtol=0.0, atol=1e-7)
    assert touches > 20
