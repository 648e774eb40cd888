"""Swept collisions, one pair of shapes at a time: no crossing between two poses is missed, and no clear pass is
reported. Truth shares no code with the package. A *crossing* is built: at a random time a random point of the robot's
shape is put on a random point of the part. A *clear pass* is built too: in the frame of the part, the support functions
of both shapes along a fixed direction stay a given clearance apart, at 100 times of each substep in float64. Letters: N
flights, each an environment; K substeps."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
import torch
import trimesh
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from aerial_gym.assets import AssetManager, CollisionTest, Scene
from aerial_gym.assets.self_collision import SelfCollisionTest
from aerial_gym.config.environment import AssetCfg, EnvironmentCfg, MotionCfg, ShapeCfg
from aerial_gym.config.joint import JointCfg, JointsCfg, LinkCfg
from aerial_gym.config.robot import BoxCfg, CapsuleCfg, CollisionCfg, CollisionShape, SphereCfg
from aerial_gym.math.random import Randomness
from aerial_gym.physics import Trajectory
from aerial_gym.registry import GlobalTensorDictionary
from aerial_gym.robots.joints.link_tensors import declare_links
from aerial_gym.robots.joints.links import LinkTrajectory

Array = NDArray[np.float64]

DT, TIMES = 0.01, 100
ROOM = {f"bounds_{side}_{end}": 3 * (x,) for side, x in (("lower", -9.0), ("upper", 9.0)) for end in ("low", "high")}
CLEAR = 5e-4
"""Distance [m] that must not be reported: 2.5 times that at which the sweep stops."""
ROUNDING = 5e-6
"""Of the least height [m]: accelerations of 0.4 m per substep squared between 100 times, ``a dt²/8``."""

HULLS: dict[str, CollisionShape] = {
    "sphere": SphereCfg(center=(0.05, -0.03, 0.02), radius=0.04),
    "box": BoxCfg(center=(0.02, 0.0, -0.01), size=(0.3, 0.2, 0.06), euler=(0.2, -0.1, 0.7)),
    "capsule": CapsuleCfg(center=(0.03, 0.05, 0.0), radius=0.02, height=0.4, euler=(0.4, 1.2, 0.0)),
}
PARTS = {
    "box": ShapeCfg(kind="box", size=(0.02, 1.0, 2.0)), "sphere": ShapeCfg(kind="sphere", radius=0.05),
    "cylinder": ShapeCfg(kind="cylinder", radius=0.01, height=1.5),
    "capsule": ShapeCfg(kind="capsule", radius=0.01, height=0.8), "plane": ShapeCfg(kind="plane"),
}  # fmt: skip
MESHES = ("slab", "torus", "sheet")


@dataclass(frozen=True)
class SweepMotion:
    """Poses of a body at times 0 to K: each substep shifts and turns it at constant rates; the turn is in the world."""

    start: Array  # (N, 3) [m]
    attitude: Rotation  # (N,)
    shifts: Array  # (K, N, 3) [m]
    turns: Array  # (K, N, 3) [rad]

    def pose(self, substep: int, s: Array | float) -> tuple[Array, Rotation]:
        share = np.broadcast_to(s, len(self.start))[:, None]
        place = self.start + self.shifts[:substep].sum(axis=0) + share * self.shifts[substep]
        attitude = self.attitude
        for turn in self.turns[:substep]:
            attitude = Rotation.from_rotvec(turn) * attitude
        return place, Rotation.from_rotvec(share * self.turns[substep]) * attitude

    def tile(self, times: int) -> "SweepMotion":
        """Return the motions of all bodies, then all of them again, so many times."""
        attitude = Rotation.from_quat(np.tile(self.attitude.as_quat(), (times, 1)))
        shifts, turns = (np.tile(part, (1, times, 1)) for part in (self.shifts, self.turns))
        return SweepMotion(np.tile(self.start, (times, 1)), attitude, shifts, turns)

    def translate(self, by: Array) -> "SweepMotion":
        return SweepMotion(self.start + by, self.attitude, self.shifts, self.turns)


def directions(rng: np.random.Generator, n: int) -> Array:
    v = rng.normal(size=(n, 3))
    return v / np.linalg.norm(v, axis=1, keepdims=True)


def random_motion(rng: np.random.Generator, n: int, k: int, *, speed: tuple[float, float], spin: float) -> SweepMotion:
    """Return motions of a speed [m/s] and a spin of up to so much [rad/s], each substep with its own spin."""
    shift = directions(rng, n) * rng.uniform(*speed, size=(n, 1)) * DT
    turns = directions(rng, k * n).reshape(k, n, 3) * rng.uniform(0.0, spin * DT, size=(k, n, 1))
    place = rng.uniform(-3.0, 3.0, size=(n, 3))
    return SweepMotion(place, Rotation.random(n, random_state=rng), np.repeat(shift[None], k, axis=0), turns)


def draw_motion(rng: np.random.Generator, n: int, k: int, *, moves: bool) -> SweepMotion:
    result = random_motion(rng, n, k, speed=(0.0, 20.0) if moves else (0.0, 0.0), spin=20.0 if moves else 0.0)
    return SweepMotion(result.start, result.attitude, result.shifts, np.repeat(result.turns[:1], k, axis=0))


def points_in_hull(hull: CollisionShape, rng: np.random.Generator, n: int) -> Array:
    unit = directions(rng, n) * rng.uniform(size=(n, 1)) ** (1 / 3)
    if isinstance(hull, SphereCfg):
        return np.asarray(hull.center) + hull.radius * unit
    turn = Rotation.from_euler("xyz", hull.euler)
    if isinstance(hull, BoxCfg):
        return np.asarray(hull.center) + turn.apply(rng.uniform(-0.5, 0.5, size=(n, 3)) * hull.size)
    along = rng.uniform(-0.5, 0.5, size=(n, 1)) * hull.height * np.array([0.0, 0.0, 1.0])
    return np.asarray(hull.center) + turn.apply(along + hull.radius * unit)


def hull_reach(hull: CollisionShape, direction: Array) -> Array:
    """Return the support function of the solid in the body frame, (N,)."""
    reach = direction @ np.asarray(hull.center)
    if isinstance(hull, SphereCfg):
        return reach + hull.radius
    own = Rotation.from_euler("xyz", hull.euler).inv().apply(direction)
    if isinstance(hull, BoxCfg):
        return reach + np.abs(own) @ np.asarray(hull.size) / 2
    return reach + 0.5 * hull.height * np.abs(own[:, 2]) + hull.radius


def make_mesh(name: str) -> trimesh.Trimesh:
    if name == "slab":  # a closed wall of many faces
        return trimesh.creation.box(extents=(0.02, 0.6, 0.6)).subdivide().subdivide()
    if name == "torus":
        return trimesh.creation.torus(major_radius=0.3, minor_radius=0.02, major_sections=24, minor_sections=8)
    return trimesh.Trimesh([[-0.5, -0.5, 0], [0.5, -0.5, 0], [0.5, 0.5, 0], [-0.5, 0.5, 0]], [[0, 1, 2], [0, 2, 3]])


def points_in_part(part: ShapeCfg | trimesh.Trimesh, rng: np.random.Generator, n: int) -> Array:
    if isinstance(part, trimesh.Trimesh):
        weights = rng.dirichlet((1.0, 1.0, 1.0), size=n)
        return np.einsum("nk,nkd->nd", weights, part.triangles[rng.integers(len(part.faces), size=n)])
    if part.kind == "box":
        return rng.uniform(-0.5, 0.5, size=(n, 3)) * part.size
    if part.kind == "plane":
        return rng.uniform((-2.0, -2.0, -0.1), (2.0, 2.0, 0.0), size=(n, 3))
    unit = directions(rng, n) * rng.uniform(size=(n, 1)) ** (1 / 3) * part.radius
    along = rng.uniform(-0.5, 0.5, size=(n, 1)) * (part.height or 0.0) * np.array([0.0, 0.0, 1.0])
    return along + unit * ((1.0, 1.0, 0.0) if part.kind == "cylinder" else 1.0)


def part_reach(part: ShapeCfg | trimesh.Trimesh, n: Array) -> Array:
    """Return the support function, (N,)."""
    if isinstance(part, trimesh.Trimesh):
        return (n @ part.vertices.T).max(axis=1)
    if part.kind == "box":
        return np.abs(n) @ np.asarray(part.size) / 2
    if part.kind == "plane":
        return np.zeros(len(n))
    along = 0.5 * (part.height or 0.0) * np.abs(n[:, 2])
    return along + part.radius * (np.hypot(n[:, 0], n[:, 1]) if part.kind == "cylinder" else 1.0)


def crossings(
    hull: CollisionShape, part: ShapeCfg | trimesh.Trimesh, n: int, *, moves: bool, k: int = 2
) -> tuple[SweepMotion, SweepMotion]:
    """Return motions of robot and part with a common point at a random time of a random substep."""
    rng = np.random.default_rng(1)
    robot = random_motion(rng, n, k, speed=(5.0, 40.0), spin=30.0)
    other = draw_motion(rng, n, k, moves=moves)
    own, partner = points_in_hull(hull, rng, n), points_in_part(part, rng, n)
    share = rng.uniform(size=n)
    gap = np.zeros((k, n, 3))
    for j in range(k):
        (x, q), (y, p) = robot.pose(j, share), other.pose(j, share)
        gap[j] = y + p.apply(partner) - x - q.apply(own)
    return robot.translate(gap[rng.integers(k, size=n), np.arange(n)]), other


def heights(
    hull: CollisionShape, part: ShapeCfg | trimesh.Trimesh, robot: SweepMotion, other: SweepMotion, n: Array
) -> Array:
    """Return the height of the robot above the plane that supports the part along n, at all times, (K TIMES, N)."""
    times, result = np.linspace(0.0, 1.0, TIMES).repeat(len(n)), []
    robot, other, own = robot.tile(TIMES), other.tile(TIMES), np.tile(n, (TIMES, 1))
    for j in range(len(robot.shifts)):
        (x, q), (y, p) = robot.pose(j, times), other.pose(j, times)
        world = p.apply(own)
        low = -hull_reach(hull, -q.inv().apply(world))
        height = np.einsum("nd,nd->n", world, x - y) + low - part_reach(part, own)
        result.append(height.reshape(TIMES, len(n)))
    return np.concatenate(result)


def clear_passes(
    hull: CollisionShape, part: ShapeCfg | trimesh.Trimesh, n: int, *, moves: bool, clearance: float, k: int = 1
) -> tuple[SweepMotion, SweepMotion]:
    """Return motions whose shapes stay a clearance apart, and come nearly as close; half of them pass along a face."""
    rng = np.random.default_rng(2)
    robot = random_motion(rng, n, k, speed=(5.0, 40.0), spin=30.0)
    other = draw_motion(rng, n, k, moves=moves)
    normal = directions(rng, n)
    normal[::2] = np.eye(3)[rng.integers(3, size=len(normal[::2]))]
    if isinstance(part, ShapeCfg) and part.kind == "plane":
        normal[:] = (0.0, 0.0, 1.0)
    world = other.attitude.apply(normal)
    along = robot.shifts - other.shifts
    robot = SweepMotion(
        robot.start, robot.attitude, robot.shifts - 0.95 * (along * world).sum(axis=-1, keepdims=True) * world,
        robot.turns,
    )  # fmt: skip
    target = other.start + other.attitude.apply(points_in_part(part, rng, n))
    robot = robot.translate(target - robot.pose(0, 0.5)[0])
    for _ in range(4):
        least = heights(hull, part, robot, other, normal).min(axis=0)
        robot = robot.translate((clearance - least)[:, None] * world)
    least = heights(hull, part, robot, other, normal).min(axis=0)
    assert least.min() > clearance - ROUNDING
    assert np.median(least) < 1.5 * clearance
    return robot, other


def crash_flags(
    hull: CollisionShape,
    shape: ShapeCfg,
    robot: SweepMotion,
    other: SweepMotion,
    *,
    moves: bool,
    device: torch.device = torch.device("cpu"),  # noqa: B008
    motion: MotionCfg = MotionCfg(kind="twist"),  # noqa: B008 (frozen)
    end: float = 100.0,
    path: tuple[float, float] = (0.0, 0.0),
) -> NDArray[np.bool_]:
    """Return the flags of flights that the collision test calls crashes, (N,).

    Args:
        hull: The robot.
        shape: The part.
        robot: Motion of the robot.
        other: Of the part: its start and the twist of its first substep.
        moves: Whether the part moves.
        device: Where it is tested.
        motion: How it does.
        end: Half the size of the bounds [m].
        path: Ends of its way along x [m], if it moves between waypoints.
    """
    n, k = len(robot.start), len(robot.shifts)
    cfg = EnvironmentCfg(
        summary="a test", source="test", physics_steps_per_env_step=k, **ROOM,
        assets=(AssetCfg(
            name="part", count=1, keep=True, shapes=(shape,), position_ratio_low=(0.5,) * 3, position_ratio_high=(0.5,) * 3,
            motion=motion if moves else MotionCfg(),
        ),),
    )  # fmt: skip
    gtd = GlobalTensorDictionary(device=device, sizes={"E": n, "A": 1})
    random = Randomness(n, seed=1, device=device)
    ends = torch.full((n, 3), end, device=device)
    made = AssetManager(cfg, gtd, num_envs=n, device=device, random=random, bounds_min=-ends, bounds_max=ends)
    random.begin(torch.ones(n, dtype=torch.bool, device=device))
    made.reset(random.mask)
    if motion.kind == "waypoints":
        made._waypoints[..., 0] = torch.tensor(path)
    state = np.concatenate((other.start, other.attitude.as_quat(), other.shifts[0] / DT, other.turns[0] / DT), axis=1)
    gtd["env_asset_state_tensor"][:, 0] = torch.as_tensor(state)
    poses = [robot.pose(0, 0.0), *(robot.pose(j, 1.0) for j in range(k))]
    position = torch.as_tensor(np.asarray([x for x, _ in poses])).float().to(device)
    attitude = torch.as_tensor(np.asarray([q.as_quat() for _, q in poses])).float().to(device)
    distance, crashes = torch.full((n,), torch.nan, device=device), torch.zeros(n, dtype=torch.bool, device=device)
    test = CollisionTest(
        made.scene, (hull,), position=position[-1], attitude=attitude[-1], distance_out=distance, moving=made.moving
    )
    test.record_launches(position, attitude, dt=DT, crashes_out=crashes)
    test.step()
    return crashes.cpu().numpy()


def make_shape(name: str, folder: Path) -> tuple[ShapeCfg, ShapeCfg | trimesh.Trimesh]:
    if name in PARTS:
        return PARTS[name], PARTS[name]
    mesh = make_mesh(name)
    mesh.export(folder / f"{name}.obj")
    return ShapeCfg(kind="mesh", path=str(folder / f"{name}.obj")), mesh


@pytest.mark.parametrize("moves", [False, True], ids=["still", "moving"])
@pytest.mark.parametrize("name", [*PARTS, *MESHES])
@pytest.mark.parametrize("hull", HULLS)
@pytest.mark.parametrize("flights", [500, pytest.param(100_000, marks=pytest.mark.slow)])
def test_no_crossing_is_missed(
    hull: str, name: str, moves: bool, flights: int, device: torch.device, tmp_path: Path
) -> None:
    shape, part = make_shape(name, tmp_path)
    flights = (
        flights // 5 if name in ("slab", "torus") and flights < 1000 else flights
    )  # of many faces, 0.1 to 0.5 ms each
    robot, other = crossings(HULLS[hull], part, flights, moves=moves)
    assert np.flatnonzero(~crash_flags(HULLS[hull], shape, robot, other, moves=moves, device=device)).tolist() == []


@pytest.mark.parametrize("moves", [False, True], ids=["still", "moving"])
@pytest.mark.parametrize("name", [*PARTS, *MESHES])
@pytest.mark.parametrize("hull", HULLS)
def test_a_clear_pass_is_not_reported(hull: str, name: str, moves: bool, device: torch.device, tmp_path: Path) -> None:
    shape, part = make_shape(name, tmp_path)
    robot, other = clear_passes(HULLS[hull], part, 100, moves=moves, clearance=CLEAR)
    assert np.flatnonzero(crash_flags(HULLS[hull], shape, robot, other, moves=moves, device=device)).tolist() == []


BALL = PARTS["sphere"]  # of 0.05 m; the hull has 0.04 m


@pytest.mark.parametrize(
    ("at", "motion", "crashes"),
    [
        (9.05, "bounce", True),  # the ball turns at 9.0 and reaches 9.05, the hull from 9.01 on
        (9.0915, "bounce", False),  # from 9.0515 on
        (8.5, "bounce", False),
        (9.05, "waypoints", True),
        (9.0915, "waypoints", False),
        (-8.95, "wrap", True),  # the ball goes on at -9, and ends at -8.8
        (8.97, "wrap", True),  # before
        (0.0, "wrap", False),  # it is nowhere between
        (-9.2, "wrap", False),
    ],
)
def test_a_ball_that_turns_or_is_wrapped_is_swept_along_its_own_way(at: float, motion: str, crashes: bool) -> None:
    """From x = 8.9 m at 30 m/s in 10 ms, in bounds of 9 m; the hull is at rest, and nothing touches at either pose."""
    cfg = (
        MotionCfg(kind="waypoints", speed=(1.0, 1.0))
        if motion == "waypoints"
        else MotionCfg(kind="twist", at_bounds=motion)
    )
    rest, level = np.zeros((1, 1, 3)), Rotation.identity(1)
    center = np.asarray(HULLS["sphere"].center)
    robot = SweepMotion(np.array([[at, 0.0, 0.0]]) - center, level, rest, rest)
    other = SweepMotion(np.array([[8.9, 0.0, 0.0]]), level, rest + np.array([30.0 * DT, 0.0, 0.0]), rest)
    result = crash_flags(HULLS["sphere"], BALL, robot, other, moves=True, motion=cfg, end=9.0, path=(-9.0, 9.0))
    assert result.tolist() == [crashes]


@pytest.mark.parametrize("hull", HULLS)
def test_a_hull_that_rests_on_a_plane_or_leaves_it_does_not_touch_it(hull: str) -> None:
    """At gap 0 to float32, at rest, upwards and turning about the vertical: nothing comes nearer."""
    up, level = np.array([[0.0, 0.0, 1.0]]), Rotation.identity(3)
    shifts = np.array([[[0.0, 0.0, 0.0], [0.1, 0.0, 0.2], [0.2, 0.0, 0.0]]])
    turns = np.array([[[0.0, 0.0, 0.0], [0.0, 0.0, 0.0], [0.0, 0.0, 0.3]]])
    start = hull_reach(HULLS[hull], -up)[0] * up + 1e-5
    result = crash_flags(
        HULLS[hull], PARTS["plane"], SweepMotion(np.tile(start, (3, 1)), level, shifts, turns),
        SweepMotion(np.zeros((3, 3)), level, 0.0 * shifts, 0.0 * turns), moves=False,
    )  # fmt: skip
    assert result.tolist() == [False, False, False]


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
    assert crash_flags_of_links(base, first, rate, pole, pole_turn).tolist() == [not misses] * flights


def crash_flags_of_links(
    base: SweepMotion, first: Array, rate: Array, pole: Array, pole_turn: Rotation
) -> torch.Tensor:
    n = len(first)
    state = np.concatenate((pole, pole_turn.as_quat(), np.zeros((n, 6))), axis=1)
    rows = torch.zeros(1, dtype=torch.int64)
    scene = Scene([POLE], shape_index=rows, semantic_id=rows, asset_state=tensor(state).unsqueeze(1))
    record = Trajectory.zeros(1, n, device=torch.device("cpu"), num_joints=2)
    for row in range(2):
        x, q = base.pose(0, float(row))
        record.position[row], record.attitude[row] = tensor(x), tensor(q.as_quat())
        record.joint_pos[row] = tensor(first + row * rate * DT)
    track = LinkTrajectory(CHAIN, record)
    track.refresh()
    gtd = GlobalTensorDictionary(device=torch.device("cpu"), sizes={"E": n})
    links = declare_links(gtd, CHAIN)
    distance, crashes = torch.zeros(n), torch.zeros(n, dtype=torch.bool)
    test = CollisionTest(
        scene, (), position=links.state[:, 0, :3], attitude=links.state[:, 0, 3:7], distance_out=distance,
        links=links.link_shapes(CollisionCfg(capsules=(ROD,), source="invented")),
    )  # fmt: skip
    test.record_launches(track.position, track.attitude, dt=DT / track.pieces, crashes_out=crashes)
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
    test.record_launches(position, attitude, crashes_out=crashes)
    test.step()
    assert crashes.all()
