"""The collision test against closed forms and against trimesh. Each environment holds one point, so a batch is a sample
of points. Float32 distances of a few metres are good to 1e-6 m; 5e-6 m is asked, and 5e-5 m of meshes, whose closest
point is found through barycentric coordinates."""

import numpy as np
import pytest
import torch
import trimesh
from numpy.typing import NDArray
from torch import Tensor

from aerial_gym.assets import PARKED_Z, CollisionTest, Scene
from aerial_gym.config.environment import ShapeCfg
from aerial_gym.config.robot import SphereCfg
from aerial_gym.errors import ShapeError
from tests.physics.sensor_rig import make_scene

Array = NDArray[np.float64]

BOX = ShapeCfg(kind="box", size=(0.6, 1.0, 1.6))
SPHERE = ShapeCfg(kind="sphere", radius=0.7)
CYLINDER = ShapeCfg(kind="cylinder", radius=0.4, height=1.5)
PLANE = ShapeCfg(kind="plane")
CAPSULE = ShapeCfg(kind="capsule", radius=0.35, height=1.1)
RADIUS = 0.05
PROBE = (SphereCfg(center=(0.0, 0.0, 0.0), radius=RADIUS),)


def random_unit_quaternions(*shape: int, generator: torch.Generator) -> Tensor:
    q = torch.randn(*shape, 4, generator=generator)
    return q / q.norm(dim=-1, keepdim=True)


def rotation(q: Tensor) -> Array:
    x, y, z, w = q.double().tolist()
    return trimesh.transformations.quaternion_matrix([w, x, y, z])[:3, :3]


def measure(
    scene: Scene, position: Tensor, attitude: Tensor | None = None, spheres: tuple[SphereCfg, ...] = PROBE
) -> tuple[Tensor, Tensor]:
    num_envs, device = scene.num_envs, scene.device
    upright = torch.tensor([0.0, 0.0, 0.0, 1.0]).repeat(num_envs, 1)
    distance = torch.full((num_envs,), float("nan"), device=device)
    test = CollisionTest(
        scene, spheres, position=position.float().to(device),
        attitude=(upright if attitude is None else attitude).float().to(device), distance_out=distance,
    )  # fmt: skip
    test.measure()
    return distance.cpu(), distance.cpu() < 0.0


def single_shape_scene(shape: ShapeCfg, num_envs: int, device: torch.device) -> Scene:
    upright = torch.tensor([0.0, 0.0, 0.0, 1.0]).repeat(num_envs, 1, 1)
    return make_scene([shape], torch.zeros(num_envs, 1, 3), upright, device=device)


@pytest.mark.parametrize("height", [0.7, -0.2])
def test_below_a_plane_the_distance_is_negative_far_from_its_origin_too(height: float, device: torch.device) -> None:
    distance, crashes = measure(single_shape_scene(PLANE, 1, device), torch.tensor([[40.0, -3.0, height]]))
    assert distance.item() == pytest.approx(height - RADIUS, abs=1e-6)
    assert crashes.item() == (height < RADIUS)


def surface_distance(shape: ShapeCfg, p: Array) -> Array:
    """Return the unsigned distance (N,) of points (N, 3) to the surface: the smallest to any part of the boundary."""
    if shape.kind == "box":
        half = np.asarray(shape.size) / 2
        faces = []
        for axis in range(3):
            for side in (-1.0, 1.0):
                nearest = np.clip(p, -half, half)
                nearest[:, axis] = side * half[axis]
                faces.append(np.linalg.norm(p - nearest, axis=1))
        return np.min(faces, axis=0)
    radius, half = shape.radius or 0.0, (shape.height or 0.0) / 2
    across = np.hypot(p[:, 0], p[:, 1])
    if shape.kind == "sphere":
        return np.abs(np.linalg.norm(p, axis=1) - radius)
    wall = np.hypot(across - radius, p[:, 2] - np.clip(p[:, 2], -half, half))
    if shape.kind == "cylinder":
        ends = [np.hypot(across - np.minimum(across, radius), p[:, 2] - z) for z in (-half, half)]
        return np.min([wall, *ends], axis=0)
    caps = []
    for side in (-1.0, 1.0):
        beyond = side * p[:, 2] - half  # the half sphere lies where this is positive; its rim belongs to the wall
        to_cap = np.abs(np.hypot(across, beyond) - radius)
        caps.append(np.where(beyond >= 0.0, to_cap, np.inf))
    return np.min([wall, *caps], axis=0)


def contains(shape: ShapeCfg, p: Array) -> NDArray[np.bool_]:
    """Return whether points lie inside: the inequalities that define the solid."""
    if shape.kind == "box":
        return (np.abs(p) < np.asarray(shape.size) / 2).all(axis=1)
    radius, half = shape.radius or 0.0, (shape.height or 0.0) / 2
    squared = p[:, 0] ** 2 + p[:, 1] ** 2
    if shape.kind == "cylinder":
        return (squared < radius**2) & (np.abs(p[:, 2]) < half)
    return squared + np.maximum(np.abs(p[:, 2]) - half, 0.0) ** 2 < radius**2


@pytest.mark.parametrize("shape", [BOX, SPHERE, CYLINDER, CAPSULE], ids=lambda s: s.kind)
def test_random_points_around_a_turned_shape_match_the_closed_form(shape: ShapeCfg, device: torch.device) -> None:
    """1000 points, a third of them inside: distance to the nearest part of the boundary, sign by the solid's inequalities."""
    generator = torch.Generator().manual_seed(1)
    num_envs = 1000
    place = torch.randn(num_envs, 1, 3, generator=generator)
    attitude = random_unit_quaternions(num_envs, 1, generator=generator)
    spread = torch.where(torch.arange(num_envs) % 2 == 0, 0.3, 1.5)[:, None]
    points = place[:, 0] + spread * torch.randn(num_envs, 3, generator=generator)
    distance, _ = measure(make_scene([shape], place, attitude, device=device), points)
    offset = (points - place[:, 0]).double().numpy()
    local = np.stack([v @ rotation(q) for v, q in zip(offset, attitude[:, 0], strict=True)])
    inside = contains(shape, local)
    assert 100 < inside.sum() < 900
    expected = np.where(inside, -1.0, 1.0) * surface_distance(shape, local)
    np.testing.assert_allclose(distance.numpy(), expected - RADIUS, rtol=0.0, atol=5e-6)


def test_mesh_distance_matches_trimesh(device: torch.device, tmp_path) -> None:
    """A bumpy closed mesh stored inside out: it is turned, and inside is negative. trimesh counts inside positive."""
    pytest.importorskip("rtree")
    rng = np.random.default_rng(2)
    ball = trimesh.creation.icosphere(subdivisions=2)
    ball.vertices *= 0.6 + 0.4 * rng.random((len(ball.vertices), 1))
    right_side_out = ball.copy()
    ball.invert()
    ball.export(tmp_path / "ball.obj")
    shape = ShapeCfg(kind="mesh", path=str(tmp_path / "ball.obj"))
    points = torch.as_tensor(rng.normal(size=(200, 3)) * np.where(np.arange(200) % 2 == 0, 0.3, 1.0)[:, None])
    distance, _ = measure(single_shape_scene(shape, 200, device), points)
    expected = -trimesh.proximity.signed_distance(right_side_out, points.float().double().numpy())
    assert 50 < (expected < 0.0).sum() < 150
    np.testing.assert_allclose(distance.numpy(), expected - RADIUS, rtol=0.0, atol=5e-5)


def test_an_open_sheet_has_no_interior(device: torch.device, tmp_path) -> None:
    """A single square of two triangles at z = 0: distance is |z| on both sides."""
    corners = np.array([[-5, -5, 0], [5, -5, 0], [5, 5, 0], [-5, 5, 0]], dtype=float)
    trimesh.Trimesh(corners, [[0, 1, 2], [0, 2, 3]]).export(tmp_path / "sheet.obj")
    scene = single_shape_scene(ShapeCfg(kind="mesh", path=str(tmp_path / "sheet.obj")), 4, device)
    heights = torch.tensor([0.7, -0.7, 0.02, -0.02])
    points = torch.stack((torch.full((4,), 0.3), torch.full((4,), -0.2), heights), dim=1)
    distance, crashes = measure(scene, points)
    torch.testing.assert_close(distance, heights.abs() - RADIUS, rtol=0.0, atol=1e-6)
    assert crashes.tolist() == [False, False, True, True]


def make_clutter(num_envs: int, device: torch.device) -> Scene:
    generator = torch.Generator().manual_seed(3)
    shapes = [BOX, SPHERE, CYLINDER, CAPSULE] * 5
    place = 2.5 * torch.randn(num_envs, 20, 3, generator=generator)
    return make_scene(shapes, place, random_unit_quaternions(num_envs, 20, generator=generator), device=device)


def test_the_nearest_pair_of_sphere_and_instance_counts(device: torch.device) -> None:
    scene = make_clutter(50, device)
    generator = torch.Generator().manual_seed(4)
    position, attitude = torch.randn(50, 3, generator=generator), random_unit_quaternions(50, generator=generator)
    spheres = tuple(
        SphereCfg(center=c, radius=r)
        for c, r in (((0.3, 0.0, 0.1), 0.1), ((-0.2, 0.3, 0.0), 0.25), ((0.0, -0.3, 0.2), 0.02))
    )
    singles = []
    for sphere in spheres:
        for a in range(20):
            state = scene.asset_state[:, a : a + 1].cpu()
            one = make_scene([scene.shape_table.shapes[a]], state[..., :3], state[..., 3:7], device=device)
            singles.append(measure(one, position, attitude, (sphere,))[0])
    distance, crashes = measure(scene, position, attitude, spheres)
    expected = torch.stack(singles).min(dim=0).values
    torch.testing.assert_close(distance, expected, rtol=0.0, atol=2e-6)
    assert 5 < crashes.sum() < 45


def test_moved_and_parked_obstacles_count_at_once(device: torch.device) -> None:
    scene = single_shape_scene(SPHERE, 1, device)
    distance = torch.full((1,), float("nan"), device=device)
    position = torch.tensor([[2.7, 0.0, 0.0]], device=device)
    attitude = torch.tensor([[0.0, 0.0, 0.0, 1.0]], device=device)
    test = CollisionTest(scene, PROBE, position=position, attitude=attitude, distance_out=distance)
    test.measure()
    assert distance.item() == pytest.approx(2.0 - RADIUS, abs=1e-6)
    scene.asset_state[0, 0, 0] = 2.5
    test.measure()
    assert distance.item() == pytest.approx(0.2 - 0.7 - RADIUS, abs=1e-6)
    scene.asset_state[0, 0, 2] = PARKED_Z
    position[0, 2] = PARKED_Z
    test.measure()
    assert distance.item() == float("inf")


def test_where_there_is_nothing_to_touch_the_distance_is_infinite(device: torch.device) -> None:
    empty = make_scene([], torch.zeros(2, 0, 3), torch.zeros(2, 0, 4), device=device)
    distance, crashes = measure(empty, torch.zeros(2, 3))
    assert distance.tolist() == [float("inf")] * 2
    assert not crashes.any()
    assert measure(single_shape_scene(SPHERE, 1, device), torch.zeros(1, 3), spheres=())[0].item() == float("inf")


def test_wrong_outputs_are_refused(device: torch.device) -> None:
    scene = single_shape_scene(SPHERE, 2, device)
    position, attitude = torch.zeros(2, 3, device=device), torch.zeros(2, 4, device=device)
    distance = torch.zeros(2, device=device)
    with pytest.raises(ShapeError, match=r"distance_out is \(3,\) torch.float32.*expected \(2,\) torch.float32"):
        CollisionTest(scene, PROBE, position=position, attitude=attitude, distance_out=torch.zeros(3, device=device))
    test = CollisionTest(scene, PROBE, position=position, attitude=attitude, distance_out=distance)
    with pytest.raises(ShapeError, match=r"Call follow\(\)"):
        test.step()
    with pytest.raises(ShapeError, match=r"crashes_out is \(2,\) torch.float32.*expected \(2,\) torch.bool"):
        test.record_launches(position[None], attitude[None], dt=0.01, crashes_out=distance)
