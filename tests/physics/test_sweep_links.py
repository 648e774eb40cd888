"""Swept collisions of links: a chain of two arms past a thin pole, and links past each other. As in ``test_sweep.py``,
a crossing is built by putting a random point of a shape on a random point of the other at a random time. The chain's
kinematics are written here anew: a base that moves evenly, and hinges that turn evenly, in float64. Letters: N flights,
each an environment."""

import numpy as np
import pytest
import torch
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from aerial_gym.assets import CollisionTest, Scene
from aerial_gym.assets.self_collision import SelfCollisionTest
from aerial_gym.config.collision import BoxCfg, CapsuleCfg, CollisionCfg
from aerial_gym.config.environment import ShapeCfg
from aerial_gym.config.joint import JointCfg, JointsCfg, LinkCfg
from aerial_gym.physics import Trajectory
from aerial_gym.registry import GlobalTensorDictionary
from aerial_gym.robots.joints.link_tensors import declare_links
from aerial_gym.robots.joints.links import LinkTrack
from tests.physics.test_sweep import DT, SweepMotion, directions, points_in_hull, points_in_part, random_motion

Array = NDArray[np.float64]

LINK = LinkCfg(mass=0.01, com=(0.3, 0.0, 0.0), inertia=((1e-5, 0.0, 0.0), (0.0, 1e-5, 0.0), (0.0, 0.0, 1e-5)))
UPPER = JointCfg(name="upper", axis=(0.0, 0.0, 1.0), position=(0.1, 0.0, 0.0), link=LINK)
LOWER = JointCfg(name="lower", axis=(0.0, 1.0, 0.0), position=(0.4, 0.0, 0.0), parent="upper", link=LINK)
CHAIN = JointsCfg(layout=(UPPER, LOWER), source="invented")
ROD = CapsuleCfg(center=(0.55, 0.0, 0.0), radius=0.01, height=0.28, euler=(0.0, np.pi / 2, 0.0), link="lower")
POLE = ShapeCfg(kind="cylinder", radius=0.005, height=1.0)


def rotate_joint(point: Array, joint: JointCfg, angle: Array) -> Array:
    return np.asarray(joint.position) + Rotation.from_rotvec(angle[:, None] * joint.axis).apply(point - joint.position)


def tensor(values: Array) -> torch.Tensor:
    return torch.as_tensor(np.asarray(values)).float()


@pytest.mark.parametrize("flights", [500, pytest.param(100_000, marks=pytest.mark.slow)])
@pytest.mark.parametrize("misses", [False, True], ids=["crossing", "clear"])
def test_a_chain_of_arms_touches_a_pole_between_two_poses(misses: bool, flights: int) -> None:
    """Hinges turn at up to 30 rad/s on a base of 5 to 20 m/s and 10 rad/s. A crossing has a common point. A clear rod passes
    on the far side of a plane that is 1 mm from the pole, at 100 times."""
    rng = np.random.default_rng(3)
    base = random_motion(rng, flights, 1, speed=(5.0, 20.0), spin=10.0)
    first, rate = rng.uniform(-2.5, 2.5, size=(flights, 2)), rng.uniform(-30.0, 30.0, size=(flights, 2))

    def place(own: Array, s: Array) -> Array:
        angle = first + s[:, None] * rate * DT
        x, q = base.pose(0, s)
        return x + q.apply(rotate_joint(rotate_joint(own, LOWER, angle[:, 1]), UPPER, angle[:, 0]))

    pole_turn = Rotation.random(flights, random_state=rng)
    if misses:
        out = pole_turn.apply(np.where([[1.0, 1.0, 0.0]], directions(rng, flights), 0.0))
        out /= np.linalg.norm(out, axis=1, keepdims=True)
        ends = [np.tile([x, 0.0, 0.0], (flights, 1)) for x in (0.41, 0.69)]
        height = [
            np.einsum("nd,nd->n", out, place(end, np.full(flights, s)))
            for s in np.linspace(0.0, 1.0, 101)
            for end in ends
        ]
        near = place(ends[1], rng.uniform(size=flights))
        least = np.min(height, axis=0) - ROD.radius - POLE.radius - 1e-3
        pole = near + (least - np.einsum("nd,nd->n", out, near))[:, None] * out
    else:
        common = place(points_in_hull(ROD, rng, flights), rng.uniform(size=flights))
        pole = common - pole_turn.apply(points_in_part(POLE, rng, flights))
    assert crash_flags(base, first, rate, pole, pole_turn).tolist() == [not misses] * flights


def crash_flags(base: SweepMotion, first: Array, rate: Array, pole: Array, pole_turn: Rotation) -> torch.Tensor:
    n = len(first)
    state = np.concatenate((pole, pole_turn.as_quat(), np.zeros((n, 6))), axis=1)
    rows = torch.zeros(1, dtype=torch.int64)
    scene = Scene([POLE], shape_index=rows, semantic_id=rows, asset_state=tensor(state).unsqueeze(1))
    record = Trajectory.zeros(1, n, device=torch.device("cpu"), num_joints=2)
    for row in range(2):
        x, q = base.pose(0, float(row))
        record.position[row], record.attitude[row] = tensor(x), tensor(q.as_quat())
        record.joint_pos[row] = tensor(first + row * rate * DT)
    track = LinkTrack(CHAIN, record)
    track.refresh()
    gtd = GlobalTensorDictionary(device=torch.device("cpu"), sizes={"E": n})
    links = declare_links(gtd, CHAIN)
    distance, crashes = torch.zeros(n), torch.zeros(n, dtype=torch.bool)
    test = CollisionTest(
        scene, (), position=links.state[:, 0, :3], attitude=links.state[:, 0, 3:7], distance_out=distance,
        links=links.link_shapes(CollisionCfg(capsules=(ROD,), source="invented")),
    )  # fmt: skip
    test.follow(track.position, track.attitude, dt=DT / track.pieces, crashes_out=crashes)
    test.step()
    return crashes


@pytest.mark.parametrize("flights", [2000, pytest.param(100_000, marks=pytest.mark.slow)])
def test_links_that_cross_each_other_between_two_poses_crash(flights: int) -> None:
    rng = np.random.default_rng(4)
    one, two = (random_motion(rng, flights, 1, speed=(5.0, 40.0), spin=30.0) for _ in range(2))
    box = BoxCfg(size=(0.3, 0.2, 0.06), center=(0.0, 0.1, 0.0), link="one")
    capsule = CapsuleCfg(radius=0.02, height=0.4, center=(1.0, 0.0, 0.0), euler=(0.4, 1.2, 0.0), link="two")
    share = rng.uniform(size=flights)
    (x, q), (y, p) = one.pose(0, share), two.pose(0, share)
    common = y + p.apply(points_in_hull(capsule, rng, flights))
    one = one.translate(common - x - q.apply(points_in_hull(box, rng, flights)))
    poses = [[motion.pose(0, row) for motion in (one, one, two)] for row in (0.0, 1.0)]  # the base has no shape
    position = tensor([[x for x, _ in row] for row in poses]).transpose(1, 2)
    attitude = tensor([[q.as_quat() for _, q in row] for row in poses]).transpose(1, 2)
    distance, crashes = torch.zeros(flights), torch.zeros(flights, dtype=torch.bool)
    test = SelfCollisionTest(
        CollisionCfg(boxes=(box,), capsules=(capsule,), between_links=True, source="invented"),
        names=("base", "one", "two"), parents=(0, 0), pivots=((0.0, 0.0, 0.0),) * 3,
        state=torch.cat((position[1], attitude[1], torch.zeros(flights, 3, 6)), dim=-1), distance_out=distance,
    )  # fmt: skip
    test.follow(position, attitude, crashes_out=crashes)
    test.step()
    assert crashes.all()
