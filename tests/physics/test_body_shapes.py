"""Boxes and capsules of a robot against everything that it can touch: distances, touches within a step, contact points.
The reference for shapes that are apart is a bounded least-squares problem (scipy), that of overlaps a grid of
points."""

from math import cos, pi, sin
from pathlib import Path

import numpy as np
import pytest
import torch
import trimesh
from scipy.optimize import lsq_linear
from scipy.spatial.transform import Rotation

from aerial_gym.assets import CollisionTest, Scene
from aerial_gym.assets.cores import body_reach, contact_points
from aerial_gym.config.robot import BoxCfg, CapsuleCfg, CollisionShape, SphereCfg
from aerial_gym.config.shape import ShapeCfg
from aerial_gym.errors import ConfigError

CPU = torch.device("cpu")
CORES = {
    BoxCfg: lambda s: (0.5 * np.array(s.size), 0.0),
    CapsuleCfg: lambda s: (np.array([0.0, 0.0, 0.5 * s.height]), s.radius),
    "box": lambda s: (0.5 * np.array(s.size), 0.0),
    "sphere": lambda s: (np.zeros(3), s.radius),
    "capsule": lambda s: (np.array([0.0, 0.0, 0.5 * s.height]), s.radius),
}
PLATE = BoxCfg(center=(0.02, -0.01, 0.03), size=(0.3, 0.24, 0.04), euler=(0.1, -0.2, 0.4))
ROD = CapsuleCfg(center=(0.0, 0.05, 0.0), radius=0.03, height=0.4, euler=(0.3, 1.2, 0.0))


def clearance(shapes: tuple[CollisionShape, ...], obstacles: list[ShapeCfg], poses: np.ndarray) -> np.ndarray:
    envs = len(poses)
    state = torch.zeros(envs, len(obstacles), 13)
    state[..., :7] = torch.tensor(poses)
    rows, out = torch.arange(len(obstacles)), torch.full((envs,), float("nan"))
    scene = Scene(obstacles, shape_index=rows, semantic_id=rows, asset_state=state)
    attitude = torch.tensor([0.0, 0.0, 0.0, 1.0]).repeat(envs, 1)
    CollisionTest(scene, shapes, position=torch.zeros(envs, 3), attitude=attitude, distance_out=out).measure()
    return out.double().numpy()


def random_poses(count: int, seed: int, reach: float) -> np.ndarray:
    rng = np.random.default_rng(seed)
    turns = Rotation.random(count, random_state=rng).as_quat()
    turns[::4] = [0.0, 0.0, 0.0, 1.0]  # parallel faces and edges too
    return np.concatenate((rng.normal(size=(count, 3)) * reach, turns), axis=1)


def nearest_pair(shape, obstacle: ShapeCfg, pose: np.ndarray) -> tuple[float, float]:
    """Return the distance of the cores and of the shapes: ``min |c + R y - d - S z|`` over both cores."""
    half, radius = CORES[type(shape)](shape)
    other_half, other_radius = CORES[obstacle.kind](obstacle)
    turn = Rotation.from_euler("ZYX", shape.euler[::-1]).as_matrix()
    matrix = np.hstack((turn, -Rotation.from_quat(pose[3:]).as_matrix()))
    offset, bound = np.array(shape.center) - pose[:3], np.concatenate((half, other_half)) + 1e-12
    result = lsq_linear(matrix, -offset, (-bound, bound), tol=1e-14)
    apart = float(np.linalg.norm(matrix @ result.x + offset))
    return apart, apart - radius - other_radius


@pytest.mark.parametrize("shape", [PLATE, pytest.param(ROD, marks=pytest.mark.slow)])
@pytest.mark.parametrize(
    "obstacle",
    [
        ShapeCfg(kind="box", size=(0.5, 0.2, 0.05)),
        ShapeCfg(kind="sphere", radius=0.15),
        ShapeCfg(kind="capsule", radius=0.02, height=1.0),
    ],
)
def test_the_distance_is_that_of_the_nearest_pair(shape: CollisionShape, obstacle: ShapeCfg) -> None:
    """300 poses: exact to float32 and 2^-15 of an edge where the cores are apart, never too large where they touch."""
    poses = random_poses(300, 1, 0.25)
    result = clearance((shape,), [obstacle], poses[:, None])
    pairs = np.array([nearest_pair(shape, obstacle, pose) for pose in poses])
    apart = pairs[:, 0] > 1e-6
    assert apart.sum() > 100
    np.testing.assert_allclose(result[apart & (pairs[:, 1] > 0.0)], pairs[apart & (pairs[:, 1] > 0.0), 1], atol=2e-6)
    assert (result[pairs[:, 1] < -1e-6] < 0.0).all()
    radii = CORES[type(shape)](shape)[1] + CORES[obstacle.kind](obstacle)[1]
    assert (result[~apart] <= 1e-6 - radii).all()


def shape_grid(shape: BoxCfg, count: int) -> np.ndarray:
    half = 0.5 * np.array(shape.size)
    axes = np.meshgrid(*(np.linspace(-h, h, count) for h in half), indexing="ij")
    points = np.stack([axis.ravel() for axis in axes], axis=1)
    return np.array(shape.center) + Rotation.from_euler("ZYX", shape.euler[::-1]).apply(points)


@pytest.mark.parametrize("kind", ["cylinder", "block", "ring"])
def test_the_distance_to_other_obstacles_is_the_least_of_many_points(kind: str, tmp_path: Path) -> None:
    """A grid of points over the plate can only be farther, by at most half its diagonal step; a ring is not convex."""
    poses, grid = random_poses(60, 2, 0.2), 9
    obstacle = ShapeCfg(kind="cylinder", radius=0.05, height=0.6)
    if kind != "cylinder":
        ring = trimesh.creation.torus(0.3, 0.04, major_sections=16, minor_sections=8)
        mesh = trimesh.creation.box((0.4, 0.3, 0.2)) if kind == "block" else ring
        mesh.export(tmp_path / "mesh.obj")
        obstacle = ShapeCfg(kind="mesh", path=str(tmp_path / "mesh.obj"))
    result = clearance((PLATE,), [obstacle], poses[:, None])
    probes = tuple(SphereCfg(center=tuple(point), radius=1e-9) for point in shape_grid(PLATE, grid))
    reference = clearance(probes, [obstacle], poses[:, None])
    step = 0.5 * np.linalg.norm(np.array(PLATE.size) / (grid - 1))
    outside = reference > step
    assert outside.sum() > 15
    assert (result <= reference + 1e-6)[outside].all()
    assert (result >= reference - step - 1e-6)[outside].all()
    assert (result[reference < 0.0] < 0.0).all()
    assert (reference < 0.0).sum() > 3


def test_a_sheet_that_an_edge_pierces_is_touched(tmp_path: Path) -> None:
    """A triangle without an inside, far larger than the plate, and one far from it."""
    triangle = trimesh.Trimesh([[-9.0, -9.0, 0.0], [9.0, -9.0, 0.0], [0.0, 9.0, 0.0]], [[0, 1, 2]])
    triangle.export(tmp_path / "sheet.obj")
    sheet, upright = ShapeCfg(kind="mesh", path=str(tmp_path / "sheet.obj")), Rotation.from_euler("y", 1.4).as_quat()
    poses = np.array([[[0.05, 0.0, 0.0, *upright]], [[3.0, 0.0, 0.0, *upright]]])
    result = clearance((BoxCfg(size=(0.4, 0.4, 0.05)),), [sheet], poses)
    assert result[0] < 0.0
    assert result[1] == pytest.approx(3.0 * sin(1.4) - 0.2 * sin(1.4) - 0.025 * cos(1.4), abs=1e-5)


def test_a_rod_through_the_middle_of_a_plate_is_touched() -> None:
    rod = ShapeCfg(kind="cylinder", radius=0.001, height=4.0)
    pose = np.array([[[0.03, 0.02, 0.0, 0.0, 0.0, 0.0, 1.0]]])
    assert clearance((BoxCfg(size=(0.4, 0.4, 0.05)),), [rod], pose)[0] < 0.0


def test_a_box_over_a_plane_is_as_high_as_its_lowest_edge() -> None:
    box, root = BoxCfg(size=(0.2, 0.2, 0.1)), (0.0, 0.0, 0.0, 1.0)
    plane = ShapeCfg(kind="plane")
    assert clearance((box,), [plane], np.array([[[0, 0, -0.3, *root]]]))[0] == pytest.approx(0.25, abs=1e-6)
    tilted = np.array([[[0, 0, -0.3, *Rotation.from_euler("x", 0.5).as_quat()]]])
    expected = 0.3 * cos(0.5) - (0.1 * sin(0.5) + 0.05 * cos(0.5))  # of the lowest edge along the normal (0, -sin, cos)
    assert clearance((box,), [plane], tilted)[0] == pytest.approx(expected, abs=1e-6)


def test_contact_points_are_corners_and_ends() -> None:
    shapes = (
        SphereCfg(center=(1.0, 2.0, 3.0), radius=0.5),
        BoxCfg(center=(0.0, 0.0, 1.0), size=(0.2, 0.4, 0.6), euler=(0.0, 0.0, 0.5 * pi)),
        CapsuleCfg(radius=0.1, height=2.0, euler=(0.0, 0.5 * pi, 0.0)),
    )
    points = contact_points(shapes, device=CPU)
    assert points.shape == (11, 4)
    assert points[0].tolist() == [1.0, 2.0, 3.0, 0.5]
    corners = {(round(float(x), 5), round(float(y), 5), round(float(z), 5)) for x, y, z, _ in points[1:9]}
    assert corners == {(x, y, z) for x in (0.2, -0.2) for y in (0.1, -0.1) for z in (0.7, 1.3)}
    torch.testing.assert_close(points[9:].abs(), torch.tensor([[1.0, 0.0, 0.0, 0.1]] * 2), rtol=0.0, atol=1e-6)
    assert body_reach(shapes) == pytest.approx(14**0.5 + 0.5)
    assert body_reach(()) == 0.0


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: BoxCfg(size=(0.1, 0.0, 0.1)), r"BoxCfg.size = .*: every edge must be > 0"),
        (lambda: BoxCfg(size=(0.1, float("nan"), 0.1)), r"BoxCfg.size = .*: must be finite"),
        (
            lambda: BoxCfg(size=(0.1, 0.1, 0.1), euler=(45.0, 0.0, 0.0)),
            r"must lie within \+-2 pi. Angles are in radians",
        ),
        (lambda: CapsuleCfg(radius=0.0, height=1.0), r"CapsuleCfg.radius = 0.0: must be > 0"),
        (lambda: CapsuleCfg(radius=0.1, height=-1.0), r"CapsuleCfg.height = -1.0: must be > 0"),
    ],
)
def test_impossible_shapes_are_refused(make, message: str) -> None:
    with pytest.raises(ConfigError, match=message):
        make()
