"""The ray caster against closed forms in float64, against trimesh, and against itself. The closed forms here intersect
boundaries (faces, discs, quadrics) and pick the nearest point that lies on the shape; the kernel intersects intervals.
Float32 distances of a few metres with well-posed rays are good to 1e-6 m; 1e-4 m is asked."""

from dataclasses import replace
from math import inf, radians, tan

import numpy as np
import pytest
import torch
import trimesh
from numpy.typing import NDArray
from torch import Tensor

from aerial_gym.assets import PARKED_Z, Scene
from aerial_gym.config.environment import ShapeCfg
from aerial_gym.config.sensor import CameraCfg
from aerial_gym.errors import ShapeError
from aerial_gym.sensors import MISS_ID, RayCaster, SensorImages
from aerial_gym.sensors.mounts import Carrier
from tests.physics.sensor_rig import make_caster, make_scene, shoot
from tests.physics.test_collision import random_unit_quaternions, rotation

Array = NDArray[np.float64]

TOLERANCE = 1e-4

CAMERA = CameraCfg(
    summary="test camera", width=48, height=37, hfov_deg=80.0, min_range=0.0, max_range=20.0, kind="range",
    source="chosen for the test",
)  # fmt: skip
BOX = ShapeCfg(kind="box", size=(0.6, 1.0, 1.6))
SPHERE = ShapeCfg(kind="sphere", radius=0.7)
CYLINDER = ShapeCfg(kind="cylinder", radius=0.4, height=1.5)
CAPSULE = ShapeCfg(kind="capsule", radius=0.35, height=1.1)


def take_image(cfg: CameraCfg, scene: Scene, position: Tensor, attitude: Tensor) -> tuple[Tensor, Tensor]:
    """Return distances and ids, (E, H, W), on the CPU."""
    images = shoot(cfg, scene, position=position, attitude=attitude).images
    return images.distance[:, 0].cpu(), images.segmentation[:, 0].cpu()


def level(num_envs: int) -> tuple[Tensor, Tensor]:
    return torch.zeros(num_envs, 3), torch.tensor([0.0, 0.0, 0.0, 1.0]).repeat(num_envs, 1)


def pixel_rays(cfg: CameraCfg) -> Array:
    """Return unit rays (H * W, 3), x forward, y left, z up: K^-1 (x + 1/2, y + 1/2, 1), turned from the optical frame."""
    focal = 0.5 * cfg.width / tan(radians(cfg.hfov_deg) / 2)
    camera = np.array([[focal, 0, cfg.width / 2], [0, focal, cfg.height / 2], [0, 0, 1]])
    y, x = np.mgrid[0 : cfg.height, 0 : cfg.width]
    optical = np.linalg.solve(camera, np.stack((x.ravel() + 0.5, y.ravel() + 0.5, np.ones(x.size))))
    rays = np.stack((optical[2], -optical[0], -optical[1]), axis=1)
    return rays / np.linalg.norm(rays, axis=1, keepdims=True)


def nearest_on_boundary(candidates: list[tuple[Array, Array]]) -> Array:
    """Return the smallest distance >= 0 among (distance, lies on the shape), or inf."""
    best = np.full(candidates[0][0].shape, inf)
    for distance, valid in candidates:
        best = np.where(valid & (distance >= 0.0) & (distance < best), distance, best)
    return best


def quadratic_roots(a: Array, b: Array, c: Array) -> list[Array]:
    """Return both roots of a t² + 2 b t + c, NaN where they are complex."""
    with np.errstate(invalid="ignore", divide="ignore"):
        root = np.sqrt(b * b - a * c)
        return [(-b - root) / a, (-b + root) / a]


def exact_distance(shape: ShapeCfg, o: Array, d: Array) -> Array:
    """Return the distance along rays o + t d, both (N, 3) in the shape's frame, to the surface of a shape, inf for a miss."""
    if shape.kind == "box":
        return _exact_box(np.asarray(shape.size) / 2, o, d)
    radius, half = shape.radius or 0.0, (shape.height or 0.0) / 2
    if shape.kind == "sphere":
        return nearest_on_boundary(_sphere_candidates(o, d, radius, lambda p: np.ones(len(p), bool)))
    if shape.kind == "cylinder":
        side = _side_candidates(o, d, radius, half)
        return nearest_on_boundary([*side, *_disc_candidates(o, d, radius, half)])
    up = np.array([0.0, 0.0, half])
    ends = _sphere_candidates(o - up, d, radius, lambda p: p[:, 2] >= 0.0)
    ends += _sphere_candidates(o + up, d, radius, lambda p: p[:, 2] <= 0.0)
    return nearest_on_boundary([*_side_candidates(o, d, radius, half), *ends])


def _exact_box(half: Array, o: Array, d: Array) -> Array:
    candidates = []
    for axis in range(3):
        rest = [i for i in range(3) if i != axis]
        for side in (-1.0, 1.0):
            t = (side * half[axis] - o[:, axis]) / d[:, axis]
            point = o + t[:, None] * d
            candidates.append((t, (np.abs(point[:, rest]) <= half[rest]).all(axis=1)))
    return nearest_on_boundary(candidates)


def _sphere_candidates(o: Array, d: Array, radius: float, part) -> list[tuple[Array, Array]]:
    roots = quadratic_roots((d * d).sum(1), (o * d).sum(1), (o * o).sum(1) - radius**2)
    return [(t, np.isfinite(t) & part(o + np.nan_to_num(t)[:, None] * d)) for t in roots]


def _side_candidates(o: Array, d: Array, radius: float, half: float) -> list[tuple[Array, Array]]:
    p, v = o[:, :2], d[:, :2]
    roots = quadratic_roots((v * v).sum(1), (p * v).sum(1), (p * p).sum(1) - radius**2)
    return [(t, np.isfinite(t) & (np.abs(o[:, 2] + np.nan_to_num(t) * d[:, 2]) <= half)) for t in roots]


def _disc_candidates(o: Array, d: Array, radius: float, half: float) -> list[tuple[Array, Array]]:
    result = []
    for side in (-half, half):
        t = (side - o[:, 2]) / d[:, 2]
        point = o[:, :2] + t[:, None] * d[:, :2]
        result.append((t, (point * point).sum(1) <= radius**2))
    return result


def exact_image(cfg: CameraCfg, scene: Scene, body: tuple[Tensor, Tensor], env: int) -> tuple[Array, NDArray[np.int64]]:
    shapes = [scene.shape_table.shapes[i] for i in scene.shape_index[env].tolist()]
    state = scene.asset_state[env].double().cpu()
    heading = pixel_rays(cfg) @ rotation(body[1][env]).T
    origin = body[0][env].double().numpy()
    ranges = []
    for a, shape in enumerate(shapes):
        matrix = rotation(state[a, 3:7])
        local = (origin - state[a, :3].numpy()) @ matrix
        ranges.append(exact_distance(shape, np.tile(local, (len(heading), 1)), heading @ matrix))
    stack = np.stack(ranges)
    instance = np.where(np.isfinite(stack.min(axis=0)), stack.argmin(axis=0), -1)
    size = (cfg.height, cfg.width)
    return stack.min(axis=0).reshape(size), instance.reshape(size)


@pytest.mark.parametrize("shape", [BOX, SPHERE, CYLINDER, CAPSULE], ids=lambda s: s.kind)
def test_every_pixel_of_a_turned_shape_matches_the_closed_form(shape: ShapeCfg, device: torch.device) -> None:
    """Random poses of shape and body, in front of the camera: range of each pixel, hits and misses, in 24 environments."""
    generator = torch.Generator().manual_seed(3)
    num_envs = 24
    body = (torch.randn(num_envs, 3, generator=generator), random_unit_quaternions(num_envs, generator=generator))
    ahead = torch.rand(num_envs, 3, generator=generator) * torch.tensor([4.0, 1.0, 1.0]) + torch.tensor(
        [1.5, -0.5, -0.5]
    )
    turned = [torch.as_tensor(rotation(q) @ v.double().numpy()) for q, v in zip(body[1], ahead, strict=True)]
    place = (body[0] + torch.stack(turned))[:, None]
    attitude = random_unit_quaternions(num_envs, 1, generator=generator)
    scene = make_scene([shape], place, attitude, device=device)
    measured, ids = take_image(CAMERA, scene, *body)
    for env in range(num_envs):
        expected, instance = exact_image(CAMERA, scene, body, env)
        assert ids[env].numpy().tolist() == np.where(instance == 0, 0, -2).tolist()
        hit = instance == 0
        assert hit.sum() >= 10
        np.testing.assert_allclose(measured[env].numpy()[hit], expected[hit], rtol=0.0, atol=TOLERANCE)


@pytest.mark.parametrize("shape", [BOX, SPHERE, CYLINDER, CAPSULE], ids=lambda s: s.kind)
def test_from_inside_a_shape_its_far_side_is_seen(shape: ShapeCfg, device: torch.device) -> None:
    """A camera inside a solid sees the distance at which each ray leaves it, as it does inside a mesh."""
    generator = torch.Generator().manual_seed(4)
    body = (torch.zeros(4, 3) + 0.05, random_unit_quaternions(4, generator=generator))
    place = torch.rand(4, 1, 3, generator=generator) * 0.2 - 0.1
    scene = make_scene([shape], place, random_unit_quaternions(4, 1, generator=generator), device=device)
    measured, ids = take_image(CAMERA, scene, *body)
    assert (ids == 0).all()
    for env in range(4):
        expected, _ = exact_image(CAMERA, scene, body, env)
        np.testing.assert_allclose(measured[env].numpy(), expected, rtol=0.0, atol=TOLERANCE)


@pytest.mark.parametrize(("shape", "end"), [(CYLINDER, 0.75), (CAPSULE, 0.9), (BOX, 0.8)])
def test_rays_exactly_along_an_axis_are_no_special_case(shape: ShapeCfg, end: float, device: torch.device) -> None:
    """Direction (0, 0, 1) to the bit, which divides by zero: on the axis it meets the end, 0.5 m beside it nothing. A
    quaternion of halves turns x to z without rounding."""
    one = replace(CAMERA, width=1, height=1)
    up = torch.tensor([[-0.5, -0.5, -0.5, 0.5]]).repeat(2, 1)
    scene = make_scene([shape], torch.zeros(2, 1, 3), level(2)[1][:, None], device=device)
    measured, ids = take_image(one, scene, torch.tensor([[0.0, 0.0, -3.0], [0.5, 0.0, -3.0]]), up)
    assert measured[0].item() == pytest.approx(3.0 - end, abs=1e-6)
    assert ids.flatten().tolist() == [0, MISS_ID]


@pytest.mark.parametrize(("shape", "end"), [(CYLINDER, 0.75), (CAPSULE, 0.9), (BOX, 0.8)])
def test_a_ray_parallel_to_a_surface_sees_it_or_passes(shape: ShapeCfg, end: float, device: torch.device) -> None:
    """A horizontal ray 1 mm above the top passes; 1 mm below the top it meets the side, or the cap near its pole."""
    one = replace(CAMERA, width=1, height=1)
    scene = make_scene([shape], torch.zeros(2, 1, 3), level(2)[1][:, None], device=device)
    _, ids = take_image(one, scene, torch.tensor([[-3.0, 0.0, end + 1e-3], [-3.0, 0.0, end - 1e-3]]), level(2)[1])
    assert ids.flatten().tolist() == [MISS_ID, 0]


def test_a_random_mesh_matches_the_ray_caster_of_trimesh(device: torch.device, tmp_path) -> None:
    pytest.importorskip("rtree")
    from trimesh.ray.ray_triangle import RayMeshIntersector

    rng = np.random.default_rng(5)
    ball = trimesh.creation.icosphere(subdivisions=2)
    ball.vertices *= 0.3 + 0.25 * rng.random((len(ball.vertices), 1))
    ball.vertices += [0.1, -0.05, 0.2]  # origin and centre differ
    ball.export(tmp_path / "bumpy.stl")
    shape = ShapeCfg(kind="mesh", path=str(tmp_path / "bumpy.stl"), scale=2.0)
    generator = torch.Generator().manual_seed(6)
    place = torch.tensor([[[2.0, 0.1, -0.2]], [[1.4, -0.2, 0.1]]])
    attitude = random_unit_quaternions(2, 1, generator=generator)
    scene = make_scene([shape], place, attitude, device=device)
    measured, ids = take_image(CAMERA, scene, *level(2))
    stored = trimesh.load_mesh(tmp_path / "bumpy.stl")
    stored.apply_scale(2.0)
    for env in range(2):
        matrix = rotation(attitude[env, 0])
        rays = pixel_rays(CAMERA) @ matrix
        origin = np.tile(-place[env, 0].double().numpy() @ matrix, (len(rays), 1))
        points, index, _ = RayMeshIntersector(stored).intersects_location(origin, rays, multiple_hits=False)
        expected = np.full(len(rays), inf)
        expected[index] = np.linalg.norm(points - origin[index], axis=1)
        hit = np.isfinite(expected)
        assert hit.sum() > 100
        assert ((ids[env].numpy().ravel() == 0) == hit).all()
        np.testing.assert_allclose(measured[env].numpy().ravel()[hit], expected[hit], rtol=0.0, atol=TOLERANCE)


def test_depth_is_range_times_the_cosine_to_the_axis(device: torch.device) -> None:
    """The same scene read as depth and as range: depth / range is the x component of the unit ray."""
    generator = torch.Generator().manual_seed(7)
    place = torch.tensor([[[2.5, 0.3, 0.1], [3.5, -0.8, 0.4]]])
    scene = make_scene([BOX, CAPSULE], place, random_unit_quaternions(1, 2, generator=generator), device=device)
    depth, _ = take_image(replace(CAMERA, kind="depth"), scene, *level(1))
    ranges, _ = take_image(CAMERA, scene, *level(1))
    cosine = torch.as_tensor(pixel_rays(CAMERA)[:, 0].reshape(CAMERA.height, CAMERA.width)).float()
    hit = ranges[0] > 0.0
    assert 100 < hit.sum() < hit.numel()
    torch.testing.assert_close(depth[0][hit], (ranges[0] * cosine)[hit], rtol=1e-6, atol=0.0)


def make_clutter(num_envs: int, device: torch.device) -> Scene:
    generator = torch.Generator().manual_seed(8)
    shapes = [BOX, SPHERE, CYLINDER, CAPSULE, ShapeCfg(kind="box", size=(0.1, 2.0, 2.0)), BOX, SPHERE, CYLINDER]
    place = torch.randn(num_envs, 8, 3, generator=generator) * 1.5 + torch.tensor([4.0, 0.0, 0.0])
    attitude = random_unit_quaternions(num_envs, 8, generator=generator)
    ids = torch.tensor([9, 0, 107, 42, 13, 105, 106, 7])
    return make_scene(shapes, place, attitude, device=device, ids=ids)


def test_segmentation_names_the_nearest_instance_in_every_pixel(device: torch.device) -> None:
    """Of eight overlapping solids the id is that of the smallest closed-form distance; nothing is -2."""
    scene = make_clutter(3, device)
    body = level(3)
    measured, ids = take_image(CAMERA, scene, *body)
    for env in range(3):
        expected, instance = exact_image(CAMERA, scene, body, env)
        names = np.append(scene.semantic_id[env].cpu().numpy(), MISS_ID)
        assert (ids[env].numpy() == names[instance]).all()
        hit = instance >= 0
        np.testing.assert_allclose(measured[env].numpy()[hit], expected[hit], rtol=0.0, atol=TOLERANCE)
        assert len(np.unique(ids[env])) > 3


@pytest.mark.parametrize(
    ("options", "near", "far", "scale"),
    [
        ({}, -1.0, -1.0, 1.0),
        ({"normalize": True}, -1.0, 1.0, 5.0),
        ({"far_out_of_range_value": 5.0, "near_out_of_range_value": 0.0}, 0.0, 5.0, 1.0),
        ({"normalize": True, "far_out_of_range_value": 10.0}, -1.0, 2.0, 5.0),
    ],
)
def test_out_of_range_pixels_hold_the_documented_values(
    options: dict, near: float, far: float, scale: float, device: torch.device
) -> None:
    """Walls at 0.5, 3 and 6 m with limits 1 to 5 m: too near keeps its id, too far is nothing, as is empty space."""
    camera = replace(CAMERA, kind="depth", min_range=1.0, max_range=5.0, **options)
    wall = ShapeCfg(kind="box", size=(0.2, 40.0, 40.0))
    place = torch.tensor([[[0.6, 0.0, 0.0]], [[3.1, 0.0, 0.0]], [[6.1, 0.0, 0.0]], [[-3.0, 0.0, 0.0]]])
    scene = make_scene([wall], place, level(4)[1][:, None], device=device)
    depth, ids = take_image(camera, scene, *level(4))
    assert (depth[0] == near).all()
    assert (ids[0] == 0).all()
    torch.testing.assert_close(depth[1], torch.full_like(depth[1], 3.0 / scale), rtol=0.0, atol=1e-6)
    assert (depth[2:] == far).all()
    assert (ids[2:] == MISS_ID).all()


def test_the_far_limit_of_depth_is_a_plane_and_that_of_range_a_sphere(device: torch.device) -> None:
    """A wall at 4.9 m: depth sees all of it within 5 m, range only where 4.9 / cosine is at most 5."""
    wall = ShapeCfg(kind="box", size=(0.2, 40.0, 40.0))
    scene = make_scene([wall], torch.tensor([[[5.0, 0.0, 0.0]]]), level(1)[1][:, None], device=device)
    _, depth_ids = take_image(replace(CAMERA, kind="depth", max_range=5.0), scene, *level(1))
    _, range_ids = take_image(replace(CAMERA, kind="range", max_range=5.0), scene, *level(1))
    assert (depth_ids == 0).all()
    cosine = pixel_rays(CAMERA)[:, 0].reshape(CAMERA.height, CAMERA.width)
    assert ((range_ids[0].numpy() == 0) == (4.9 / cosine < 5.0)).all()


def test_a_scene_without_instances_is_all_misses(device: torch.device) -> None:
    scene = make_scene([], torch.zeros(2, 0, 3), torch.zeros(2, 0, 4), device=device)
    depth, ids = take_image(CAMERA, scene, *level(2))
    assert (depth == -1.0).all()
    assert (ids == MISS_ID).all()
    without_ids = shoot(replace(CAMERA, segmentation=False), scene).images
    assert (without_ids.distance == -1.0).all()
    assert without_ids.segmentation is None


def test_a_moved_obstacle_is_seen_in_the_next_image(device: torch.device) -> None:
    wall = ShapeCfg(kind="box", size=(0.2, 40.0, 40.0))
    root = torch.zeros(3, 2, 13, device=device)  # row 0 is the robot: the scene has a strided view of row 1
    root[:, 1, 0], root[:, 1, 6] = 3.1, 1.0
    scene = Scene([wall], shape_index=torch.zeros(1), semantic_id=torch.zeros(1), asset_state=root[:, 1:])
    caster = make_caster(replace(CAMERA, kind="depth"), scene)
    depth = caster.images.distance
    caster.cast()
    torch.testing.assert_close(depth, torch.full_like(depth, 3.0), rtol=0.0, atol=1e-6)
    root[1, 1, 0] = 4.1
    root[2, 1, 2] = PARKED_Z
    caster.cast()
    for env, expected in enumerate((3.0, 4.0, -1.0)):
        torch.testing.assert_close(depth[env], torch.full_like(depth[env], expected), rtol=0.0, atol=1e-6)


def test_a_parked_obstacle_is_absent_even_within_range(device: torch.device) -> None:
    scene = make_scene([SPHERE], torch.tensor([[[0.0, 0.0, PARKED_Z]]]), level(1)[1][:, None], device=device)
    down = torch.tensor([[0.0, 0.5**0.5, 0.0, 0.5**0.5]])
    _, ids = take_image(replace(CAMERA, max_range=2000.0), scene, torch.tensor([[0.0, 0.0, PARKED_Z + 5.0]]), down)
    assert (ids == MISS_ID).all()


def test_reset_puts_only_the_mounts_of_masked_environments_back(device: torch.device) -> None:
    scene = make_clutter(3, device)
    caster = make_caster(CAMERA, scene)
    depth = caster.images.distance
    caster.cast()
    nominal = depth.clone()
    caster.places.position.add_(torch.tensor([0.3, 0.2, -0.1], device=device))
    caster.cast()
    shifted = depth.clone()
    assert (shifted != nominal).flatten(1).any(dim=1).all()
    caster.reset(torch.tensor([False, True, False], device=device))
    caster.cast()
    for env, expected in enumerate((shifted, nominal, shifted)):
        assert torch.equal(depth[env], expected[env])


def test_wrong_tensors_are_refused_with_shape_and_expectation(device: torch.device) -> None:
    scene = make_clutter(2, device)
    position, attitude = (t.to(device) for t in level(2))
    image = torch.zeros(2, 1, CAMERA.height, CAMERA.width, device=device)
    ids = image.int()

    def refuse(match: str, **changed: Tensor | None) -> None:
        given = {"position": position, "attitude": attitude, "distance": image, "segmentation": ids, **changed}
        images = SensorImages(distance=given["distance"], segmentation=given["segmentation"])
        with pytest.raises(ShapeError, match=match):
            RayCaster(CAMERA, scene, images, Carrier(position=given["position"], attitude=given["attitude"]))

    turned = image.transpose(2, 3).contiguous()
    refuse(r"distance is \(2, 1, 48, 37\).*expected \(2, 1, 37, 48\)", distance=turned)
    refuse("segmentation must be given exactly if the sensor has such an image: it is True", segmentation=None)
    refuse("the last axis must be contiguous", position=torch.zeros(3, 2, device=device).T)
    broad = torch.zeros(2, 1, CAMERA.height, 2 * CAMERA.width, device=device)[..., ::2]
    refuse("images must be contiguous", distance=broad)
    with pytest.raises(ShapeError, match="shape_index must lie in 0 to 0"):
        Scene([BOX], shape_index=torch.ones(8), semantic_id=scene.semantic_id, asset_state=scene.asset_state)
