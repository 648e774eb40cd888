"""What a sensor writes beside distances: points, normals, faces, noise, the second camera; placement and rate."""

from dataclasses import replace

import numpy as np
import pytest
import torch
import trimesh
from torch import Tensor

from aerial_gym.assets import Scene
from aerial_gym.config.environment import PartCfg, ShapeCfg
from aerial_gym.config.sensor import CameraCfg, LidarCfg, LightCfg, NoiseCfg, StereoCfg
from aerial_gym.errors import ConfigError, ShapeError
from aerial_gym.math.quaternion import quat_from_euler, quat_multiply, quat_rotate
from aerial_gym.registry import GlobalTensorDictionary
from aerial_gym.sensors import SensorManager
from aerial_gym.sensors.mounts import Carrier
from tests.physics.sensor_rig import LEVEL, WALL, place_shapes, shoot
from tests.refusals import assert_refused

CAMERA = CameraCfg(
    summary="test camera", width=40, height=30, hfov_deg=80.0, min_range=0.0, max_range=20.0, kind="range",
    source="chosen for the test",
)  # fmt: skip

pytestmark = pytest.mark.usefixtures("few_rays")


SOLIDS = {
    "box": (ShapeCfg(kind="box", size=(1.0, 1.4, 0.8)), [3.0, 0.2, 0.1], [0.3, -0.4, 0.7]),
    "sphere": (ShapeCfg(kind="sphere", radius=0.8), [3.0, 0.2, 0.1], [0.0, 0.0, 0.0]),
    "cylinder": (ShapeCfg(kind="cylinder", radius=0.6, height=1.2), [3.0, 0.1, 0.0], [0.7, 0.5, 0.2]),
    "capsule": (ShapeCfg(kind="capsule", radius=0.4, height=1.0), [3.0, 0.1, 0.0], [0.7, 0.5, 0.2]),
}


@pytest.mark.parametrize("frame", ["world", "sensor"])
def test_points_lie_at_the_measured_range_along_their_rays(frame: str, device: torch.device) -> None:
    """In the sensor's frame a point is range times ray; in the world's it is that, turned and moved with the sensor."""
    shape, place, turn = SOLIDS["box"]
    scene = place_shapes([shape, WALL], [(place, turn), ([6.0, 0.0, 0.0], [0.0, 0.0, 0.0])], device)
    position, attitude = torch.tensor([[0.3, -0.2, 0.1]]), quat_from_euler(torch.tensor([[0.1, -0.05, 0.2]]))
    for kind in ("range", "depth"):
        cfg = replace(CAMERA, points=frame, kind=kind, position=(0.1, 0.0, 0.05), euler=(0.02, 0.1, -0.1))
        caster = shoot(cfg, scene, position=position, attitude=attitude)
        rays = caster.direction.cpu()
        measured = caster.images.distance[0, 0].cpu()
        along = measured / rays[..., 0] if kind == "depth" else measured
        expected = along.unsqueeze(-1) * rays
        if frame == "world":
            mount = quat_multiply(attitude, quat_from_euler(torch.tensor([cfg.euler])))
            origin = position + quat_rotate(attitude, torch.tensor([cfg.position]))
            expected = origin + quat_rotate(mount.expand(30, 40, 4), expected)
        torch.testing.assert_close(caster.images.points[0, 0].cpu(), expected, rtol=1e-5, atol=1e-5)


def test_a_pixel_without_a_distance_has_its_point_at_the_sensor(device: torch.device) -> None:
    scene = place_shapes([WALL], [([30.0, 0.0, 0.0], [0.0, 0.0, 0.0])], device)
    caster = shoot(replace(CAMERA, points="world"), scene, position=torch.tensor([[1.0, 2.0, 3.0]]))
    expected = torch.tensor([1.0, 2.0, 3.0], device=device).expand_as(caster.images.points)
    assert torch.equal(caster.images.points, expected)


@pytest.mark.parametrize("name", list(SOLIDS))
def test_normals_are_those_of_the_surface(name: str, device: torch.device) -> None:
    """The point of a pixel, in the shape's own frame, gives the normal in closed form; it is unit and faces the sensor."""
    shape, place, turn = SOLIDS[name]
    scene = place_shapes([shape], [(place, turn)], device)
    cfg = replace(CAMERA, points="world", normals="world", face_ids=True)
    caster = shoot(cfg, scene)
    images = caster.images
    hit = (images.segmentation[0, 0] == 0).cpu()
    assert hit.sum() > 60
    attitude = quat_from_euler(torch.tensor(turn))
    back = torch.cat((-attitude[:3], attitude[3:])).expand(int(hit.sum()), 4)
    local = quat_rotate(back, images.points[0, 0].cpu()[hit] - torch.tensor(place))
    result = quat_rotate(back, images.normals[0, 0].cpu()[hit])
    expected, sure = surface_normal(shape, local)
    torch.testing.assert_close(result[sure], expected[sure], rtol=0.0, atol=2e-4)
    assert sure.float().mean() > 0.9
    world = images.normals[0, 0].cpu()
    assert ((world * caster.direction.cpu()).sum(-1)[hit] < 0.0).all()
    assert (world[~hit] == 0.0).all()


def surface_normal(shape: ShapeCfg, local: Tensor) -> tuple[Tensor, Tensor]:
    """Return the outward normal at points of a surface, and where no edge is nearer than a millimetre."""
    if shape.kind == "sphere":
        return local / local.norm(dim=-1, keepdim=True), torch.ones(len(local), dtype=torch.bool)
    if shape.kind == "box":
        gap = (local.abs() - 0.5 * torch.tensor(shape.size)).abs()
        axis = gap.argmin(dim=-1)
        normal = torch.zeros_like(local)
        normal[torch.arange(len(local)), axis] = local.gather(-1, axis[:, None])[:, 0].sign()
        return normal, gap.sort(dim=-1).values[:, 1] > 1e-3
    if shape.kind == "capsule":
        middle = torch.zeros_like(local)
        middle[:, 2] = local[:, 2].clamp(-0.5 * shape.height, 0.5 * shape.height)
        return (local - middle) / shape.radius, torch.ones(len(local), dtype=torch.bool)
    side = (local[:, :2].norm(dim=-1) - shape.radius).abs()
    cap = (local[:, 2].abs() - 0.5 * shape.height).abs()
    flat = torch.zeros_like(local)
    flat[:, 2] = local[:, 2].sign()
    radial = torch.cat((local[:, :2] / shape.radius, torch.zeros(len(local), 1)), dim=-1)
    return torch.where((cap < side)[:, None], flat, radial), (cap - side).abs() > 1e-3


@pytest.mark.parametrize("turn", [[0.0, 0.0, 0.0], [0.2, -0.1, 0.5]])
@pytest.mark.parametrize("height", [-1.5, 1.5])
def test_a_plane_has_the_distance_of_its_equation_at_every_pixel(
    height: float, turn: list[float], device: torch.device
) -> None:
    """n . (o + t d) = n . p gives t; rays that do not fall see nothing, up to grazing ones. Its normal is n from
    above and -n from below, where the camera is within the solid."""
    place = [0.5, 0.2, height]
    scene = place_shapes(
        [ShapeCfg(kind="plane"), SOLIDS["sphere"][0]], [(place, turn), ([3.0, 0.2, 0.4], [0, 0, 0])], device
    )
    attitude = quat_from_euler(torch.tensor([[0.1, -0.2 * height, -0.3]]))
    caster = shoot(replace(CAMERA, normals="world", max_range=500.0), scene, attitude=attitude)
    images, rays = caster.images, caster.direction.cpu().double()
    world = quat_rotate(attitude.double().expand(30, 40, 4), rays)
    normal = quat_rotate(
        quat_from_euler(torch.tensor(turn, dtype=torch.float64)), torch.tensor([0.0, 0.0, 1.0]).double()
    )
    t = (normal @ torch.tensor(place, dtype=torch.float64)) / (world @ normal)
    ids, result = images.segmentation[0, 0].cpu(), images.distance[0, 0].cpu().double()
    ground = ids == 0
    assert ground.sum() > 200
    slope = (world @ normal).abs()[ground]  # t is a quotient by it: round-off of some 1e-7 counts the more, the flatter
    assert ((result - t).abs()[ground] <= 1e-5 + t[ground] * 5e-7 / slope).all()
    falls = (t > 0.0) & (t < 499.0)
    assert torch.equal(ground, falls & (ids != 1))
    expected = (-1.0 if height > 0.0 else 1.0) * normal.float().expand(int(ground.sum()), 3)
    torch.testing.assert_close(images.normals[0, 0].cpu()[ground], expected, rtol=0.0, atol=1e-5)


def test_faces_of_a_box_are_numbered_by_axis_and_side(device: torch.device) -> None:
    """A camera before each face of a cube sees the number 2 axis + (1 on the upper side)."""
    cube = ShapeCfg(kind="box", size=(1.0, 1.0, 1.0))
    scene = place_shapes([cube], [([0.0, 0.0, 0.0], [0.0, 0.0, 0.0])], device, num_envs=6)
    position, attitude = torch.zeros(6, 3), LEVEL.repeat(6, 1)
    looks = {0: (0.0, 0.0, 0.0), 1: (0.0, 0.0, np.pi), 2: (0.0, 0.0, np.pi / 2), 3: (0.0, 0.0, -np.pi / 2),
             4: (0.0, -np.pi / 2, 0.0), 5: (0.0, np.pi / 2, 0.0)}  # fmt: skip
    for face, euler in looks.items():
        position[face, face // 2] = 3.0 if face % 2 else -3.0
        attitude[face] = quat_from_euler(torch.tensor(euler))
    caster = shoot(replace(CAMERA, face_ids=True), scene, position=position, attitude=attitude)
    assert caster.images.face_ids[:, 0, 15, 20].tolist() == [0, 1, 2, 3, 4, 5]
    assert (caster.images.face_ids[:, 0, 0, 0] == -1).all()


def test_normals_and_faces_of_a_mesh_match_trimesh(device: torch.device, tmp_path) -> None:
    pytest.importorskip("rtree", reason="trimesh's ray caster needs rtree: pip install 'aerial-gym[dev]'")
    mesh = trimesh.creation.icosphere(subdivisions=1, radius=0.9)
    mesh.apply_scale([1.0, 0.7, 1.3])
    mesh.export(tmp_path / "egg.stl")
    shape = ShapeCfg(kind="mesh", path=str(tmp_path / "egg.stl"))
    place, turn = [3.0, 0.1, -0.1], [0.4, 0.2, -0.9]
    caster = shoot(replace(CAMERA, normals="world", face_ids=True), place_shapes([shape], [(place, turn)], device))
    images = caster.images
    loaded = trimesh.load_mesh(tmp_path / "egg.stl", process=False)
    turned = loaded.copy()
    matrix = trimesh.transformations.euler_matrix(*turn, "sxyz")
    matrix[:3, 3] = place
    turned.apply_transform(matrix)
    rays = caster.direction.cpu().numpy().reshape(-1, 3)
    face, ray, _ = turned.ray.intersects_id(np.zeros_like(rays), rays, multiple_hits=False, return_locations=True)
    found_face, found_normal = images.face_ids.flatten().cpu().numpy(), images.normals.reshape(-1, 3).cpu().numpy()
    same = found_face[ray] == face
    assert same.mean() > 0.98  # a ray along an edge may be given to either side
    np.testing.assert_allclose(found_normal[ray][same], turned.face_normals[face][same], atol=1e-4)
    missed = np.setdiff1d(np.arange(len(rays)), ray)
    assert (found_face[missed] == -1).mean() > 0.99


def test_normals_in_the_sensor_frame_are_those_of_the_world_turned(device: torch.device) -> None:
    shape, place, turn = SOLIDS["capsule"]
    attitude = quat_from_euler(torch.tensor([[0.2, -0.1, 0.3]]))
    result = {}
    for frame in ("world", "sensor"):
        scene = place_shapes([shape], [(place, turn)], device)
        result[frame] = shoot(replace(CAMERA, normals=frame), scene, attitude=attitude).images.normals
    sensor = result["sensor"][0, 0].cpu()
    torch.testing.assert_close(
        result["world"][0, 0].cpu(), quat_rotate(attitude.expand(30, 40, 4), sensor), rtol=0.0, atol=1e-5
    )


def test_a_matt_ground_has_the_brightness_of_lambert_and_the_shadow_of_a_roof(device: torch.device) -> None:
    """Ground: albedo (ambient + (1 - ambient) cos) with the angle of the sun. A roof at height h throws a shadow that is
    its own outline, shifted by -h s_xy / s_z; the sky has its own colour."""
    sun = torch.tensor([0.5, 0.25, 1.0], dtype=torch.float64)
    sun = sun / sun.norm()
    albedo, h, half = (0.8, 0.4, 0.2), 1.0, 0.6
    ground = ShapeCfg(kind="plane", color=albedo)
    roof = ShapeCfg(kind="box", size=(2 * half, 2 * half, 1e-3), color=(0.1, 0.2, 0.9))
    place = [4.0, 0.3, -1.0]
    scene = place_shapes([ground, roof], [([0, 0, -2.0], [0, 0, 0]), (place, [0.0, 0.0, 0.0])], device)
    light = LightCfg(sun=tuple(sun.tolist()), ambient=0.3, sky=(0.5, 0.6, 0.7))
    attitude = quat_from_euler(torch.tensor([[0.1, 0.35, 0.2]]))
    cfg = replace(CAMERA, light=light, points="world", max_range=40.0)
    images = shoot(cfg, scene, attitude=attitude).images
    ids, color, point = images.segmentation[0, 0].cpu(), images.color[0, 0].cpu(), images.points[0, 0].cpu().double()
    shift = h * sun[:2] / sun[2]
    inside = (point[..., :2] + shift - torch.tensor(place[:2]).double()).abs()
    gap = inside.amax(dim=-1) - half
    ground_seen = (ids == 0) & (gap.abs() > 5e-3)
    shadow = gap < 0.0
    assert (ground_seen & shadow).sum() > 20
    bright = torch.where(shadow, 0.3, 0.3 + 0.7 * sun[2]).float().unsqueeze(-1)
    expected = bright * torch.tensor(albedo)
    torch.testing.assert_close(color[ground_seen], expected[ground_seen], rtol=0.0, atol=1e-5)
    lit_roof = (0.3 + 0.7 * sun[2]).float() * torch.tensor(roof.color)
    top = (ids == 1) & (point[..., 2] > -1.0)
    torch.testing.assert_close(color[top], lit_roof.expand(int(top.sum()), 3), rtol=0.0, atol=1e-5)
    sky = ids == -2
    assert sky.any()
    torch.testing.assert_close(color[sky], torch.tensor([0.5, 0.6, 0.7]).expand(int(sky.sum()), 3))
    unshaded = shoot(replace(cfg, light=replace(light, shadows=False)), scene, attitude=attitude).images.color
    everywhere = (0.3 + 0.7 * sun[2]).float() * torch.tensor(albedo)
    seen = unshaded[0, 0].cpu()[ids == 0]
    torch.testing.assert_close(seen, everywhere.expand_as(seen), rtol=0.0, atol=1e-5)


def test_impossible_lights_and_colours_are_refused() -> None:
    with pytest.raises(ConfigError, match=r"LightCfg.sun = \(0.0, 0.0, 0.0\): must point somewhere"):
        LightCfg(sun=(0.0, 0.0, 0.0))
    assert_refused(ConfigError, r"LightCfg.ambient = 1.5", LightCfg, ambient=1.5)
    assert_refused(ConfigError, r"ShapeCfg.color = \(0.1, 1.2, 0.0\)", ShapeCfg, kind="plane", color=(0.1, 1.2, 0.0))


def noisy_wall(noise: NoiseCfg, device, *, distance: float = 4.0, images: int = 40, kind: str = "depth") -> Tensor:
    """Return the distances of a wall straight ahead, images x pixels."""
    scene = place_shapes([WALL], [([distance + 0.1, 0.0, 0.0], [0.0, 0.0, 0.0])], device)
    caster = shoot(replace(CAMERA, kind=kind, noise=noise), scene)
    result = []
    for _ in range(images):
        caster.cast()
        result.append(caster.images.distance.flatten().clone().cpu())
    return torch.stack(result)


@pytest.mark.parametrize("distance", [2.0, 8.0])
def test_noise_has_the_mean_and_deviation_of_its_polynomial(distance: float, device: torch.device) -> None:
    """Of n draws the mean is off by less than 5 std/sqrt(n), the deviation by less than 5 std/sqrt(2 n)."""
    noise = NoiseCfg(std_a=1e-3, std_b=2e-3, std_c=5e-3, mean_offset=-0.05)
    result = noisy_wall(noise, device, distance=distance).double()
    std, n = noise.std(distance), result.numel()
    assert abs(result.mean().item() - (distance + 0.05)) < 5.0 * std / n**0.5 + 1e-6
    assert abs(result.std().item() - std) < 5.0 * std / (2 * n) ** 0.5


def test_noise_differs_between_pixels_images_and_seeds_and_repeats_with_a_seed(device: torch.device) -> None:
    noise = NoiseCfg(std_c=0.01)
    scene = place_shapes([WALL], [([4.1, 0.0, 0.0], [0.0, 0.0, 0.0])], device)
    cfg = replace(CAMERA, kind="depth", noise=noise)
    one, two = shoot(cfg, scene, seed=1), shoot(cfg, scene, seed=1)
    first = one.images.distance.clone()
    assert torch.equal(first, two.images.distance)
    assert not torch.equal(first, shoot(cfg, scene, seed=2).images.distance)
    assert len(first.flatten().unique()) > 0.99 * first.numel()
    one.cast()
    assert (one.images.distance != first).float().mean() > 0.99
    one.reset(torch.ones(1, dtype=torch.bool, device=device))
    one.cast()
    assert torch.equal(one.images.distance, first)
    pairs = noisy_wall(noise, device, images=60).double() - 4.0
    shifted = (pairs[:, 1:] * pairs[:, :-1]).mean() / pairs.var()
    later = (pairs[1:] * pairs[:-1]).mean() / pairs.var()
    assert max(abs(shifted), abs(later)) < 5.0 / pairs.numel() ** 0.5


def test_dropped_pixels_hold_the_near_value_at_the_given_rate(device: torch.device) -> None:
    result = noisy_wall(NoiseCfg(dropout=0.07), device)
    dropped = result == -1.0
    torch.testing.assert_close(result[~dropped], torch.full_like(result[~dropped], 4.0), rtol=0.0, atol=1e-5)
    rate, n = dropped.double().mean().item(), result.numel()
    assert abs(rate - 0.07) < 5.0 * (0.07 * 0.93 / n) ** 0.5


def test_a_stereo_pixel_is_invalid_exactly_where_the_second_camera_is_blocked(device: torch.device) -> None:
    """A post between the cameras' lines of sight: for every pixel on the wall behind, the line from the second camera
    (at y = b) to the point of the wall is tested against the post's rectangle in plan, by hand."""
    baseline, post_x, half, wall_x = 0.3, 2.0, 0.1, 5.0
    post = ShapeCfg(kind="box", size=(0.02, 2 * half, 60.0))
    scene = place_shapes([WALL, post], [([wall_x + 0.1, 0, 0], [0, 0, 0]), ([post_x, 0.0, 0.0], [0, 0, 0])], device)
    cfg = StereoCfg(**{**vars(CAMERA), "model": "stereo", "kind": "depth", "width": 160, "baseline": baseline})
    caster = shoot(cfg, scene)
    depth = caster.images.distance[0, 0].cpu()
    plain = shoot(replace(CAMERA, kind="depth", width=160), scene).images.distance[0, 0].cpu()
    rays = caster.direction.cpu().double()
    point = rays / rays[..., :1] * plain.double().unsqueeze(-1)
    y_near, y_far = [baseline + (point[..., 1] - baseline) * x / point[..., 0] for x in (post_x - 0.01, post_x + 0.01)]
    behind = plain > 3.0
    blocked = behind & (torch.minimum(y_near, y_far) < half) & (torch.maximum(y_near, y_far) > -half)
    half_width = np.tan(np.radians(40.0))
    outside = ((point[..., 1] - baseline) / point[..., 0]).abs() > half_width
    edge = ((y_near.abs() - half).abs() < 1e-3) | ((y_far.abs() - half).abs() < 1e-3)
    facing = behind | (point[..., 0] < post_x - 0.005)
    sure = facing & ~edge
    assert blocked.any()
    invalid = depth == -1.0
    assert torch.equal(invalid[sure], (blocked | outside)[sure])
    assert torch.equal(depth[~invalid], plain[~invalid])
    disparity = caster.images.disparity[0, 0].cpu()
    focal = 80.0 / np.tan(np.radians(40.0))
    torch.testing.assert_close(disparity[~invalid], focal * baseline / plain[~invalid], rtol=1e-5, atol=0.0)
    assert (disparity[invalid] == 0.0).all()


def test_a_compound_is_seen_as_its_parts_would_be(device: torch.device) -> None:
    """Two parts that move with one asset against two assets at the poses worked out by hand, and their own ids."""
    trunk = PartCfg(shape=ShapeCfg(kind="cylinder", radius=0.2, height=2.0), position=(0.0, 0.0, 1.0), semantic_id=7)
    crown = PartCfg(shape=SOLIDS["box"][0], position=(0.1, -0.2, 2.2), euler=(0.3, 0.2, 0.1))
    tree = ShapeCfg(kind="compound", parts=(trunk, crown))
    place, turn = [4.0, 0.3, -1.5], [0.2, -0.1, 0.8]
    whole = shoot(CAMERA, place_shapes([WALL, tree], [([8.0, 0, 0], [0, 0, 0]), (place, turn)], device)).images
    attitude = quat_from_euler(torch.tensor(turn))
    state = torch.zeros(1, 3, 13)
    state[0, 0, 0], state[0, 0, 6] = 8.0, 1.0
    for row, part in ((1, trunk), (2, crown)):
        state[0, row, :3] = torch.tensor(place) + quat_rotate(attitude, torch.tensor(part.position))
        state[0, row, 3:7] = quat_multiply(attitude, quat_from_euler(torch.tensor(part.euler)))
    apart = Scene(
        [WALL, trunk.shape, crown.shape], shape_index=torch.arange(3), semantic_id=torch.tensor([0, 7, 1]),
        asset_state=state.to(device),
    )  # fmt: skip
    pieces = shoot(CAMERA, apart).images
    torch.testing.assert_close(whole.distance, pieces.distance, rtol=0.0, atol=1e-5)
    assert (whole.segmentation == pieces.segmentation).float().mean() > 0.999
    assert set(whole.segmentation.unique().tolist()) == {0, 1, 7}


def test_environments_may_have_compounds_of_different_numbers_of_parts(device: torch.device) -> None:
    part = PartCfg(shape=ShapeCfg(kind="sphere", radius=0.5))
    pair = ShapeCfg(kind="compound", parts=(part, replace(part, position=(0.0, 1.5, 0.0))))
    single = ShapeCfg(kind="sphere", radius=0.5)
    state = torch.zeros(2, 1, 13, device=device)
    state[..., 0], state[..., 6] = 4.0, 1.0
    scene = Scene([pair, single], shape_index=torch.tensor([[0], [1]]), semantic_id=torch.zeros(1), asset_state=state)
    distance = shoot(CAMERA, scene).images.distance
    assert scene.num_parts == 2
    assert (distance[0] > 0).sum() > 1.8 * (distance[1] > 0).sum() > 0


def test_placements_are_drawn_within_their_ranges_for_masked_environments(device: torch.device) -> None:
    cfg = replace(
        CAMERA, count=2, position_low=(-0.1, -0.1, 0.0), position_high=(0.1, 0.1, 0.0), euler_low=(0.0, -0.2, 0.0),
        euler_high=(0.0, 0.2, 0.0),
    )  # fmt: skip
    caster = shoot(cfg, place_shapes([WALL], [([4.1, 0, 0], [0, 0, 0])], device, num_envs=50))
    mask = torch.arange(50, device=device) < 30
    caster.reset(mask)
    place = caster.places.position.cpu()
    assert (place[30:] == 0.0).all()
    assert (place[:30].abs() <= 0.1).all()
    assert (place[:30, :, :2] != 0.0).all()
    assert (place[:30, 0, :2] != place[:30, 1, :2]).all()
    pitch = 2.0 * torch.asin(caster.places.attitude[:30, :, 1].cpu())
    assert (pitch.abs() <= 0.2 + 1e-6).all()
    assert pitch.abs().max() > 0.15


def test_a_sensor_with_a_rate_keeps_its_image_between_captures(device: torch.device) -> None:
    """30 Hz on 10 ms steps: images at 0, 4, 7, 10, 14 ... steps after the reset of each environment."""
    scene = place_shapes([WALL], [([4.1, 0, 0], [0, 0, 0])], device, num_envs=2)
    gtd = GlobalTensorDictionary(device=device, sizes={"E": 2})
    position = torch.zeros(2, 3, device=device)
    pose = {"position": position, "attitude": LEVEL.repeat(2, 1).to(device)}
    slow = replace(CAMERA, kind="depth", rate_hz=30.0)
    manager = SensorManager({"slow": slow}, gtd, scene, Carrier(**pose), num_envs=2, device=device, dt=0.01)
    all_rows, second = torch.tensor([True, True], device=device), torch.tensor([False, True], device=device)
    manager.reset(all_rows)
    taken: list[list[int]] = [[], []]
    last = [-1.0, -1.0]
    for step in range(15):
        if step == 5:
            manager.reset(second)
        position[:, 0] = 0.1 * step
        manager.capture()
        for env in range(2):
            seen = gtd["depth_range_pixels"][env, 0, 15, 20].item()
            if seen != last[env]:
                taken[env].append(step)
                last[env] = seen
    assert taken[0] == [0, 4, 7, 10, 14]
    assert taken[1] == [0, 4, 5, 9, 12]


@pytest.mark.parametrize("steps", [1, 3])
def test_images_of_a_sensor_with_latency_appear_so_many_steps_later(steps: int, device: torch.device) -> None:
    """A camera that moves 0.1 m a step towards a wall shows where it was ``steps`` ago; after a reset, where it is."""
    scene = place_shapes([WALL], [([9.1, 0, 0], [0, 0, 0])], device, num_envs=2)
    gtd = GlobalTensorDictionary(device=device, sizes={"E": 2})
    position = torch.zeros(2, 3, device=device)
    pose = {"position": position, "attitude": LEVEL.repeat(2, 1).to(device)}
    late = replace(CAMERA, kind="depth", latency_s=0.02 * steps, points="sensor")
    manager = SensorManager({"late": late}, gtd, scene, Carrier(**pose), num_envs=2, device=device, dt=0.02)
    all_rows, second = torch.tensor([True, True], device=device), torch.tensor([False, True], device=device)
    manager.reset(all_rows)
    begin = [0, 0]
    for step in range(12):
        if step == 7:
            manager.reset(second)
            begin[1] = 7
        position[:, 0] = 0.1 * step
        manager.capture()
        for env in range(2):
            expected = 9.0 - 0.1 * max(begin[env], step - steps)
            assert gtd["depth_range_pixels"][env, 0, 15, 20].item() == pytest.approx(expected, abs=1e-5)
            assert gtd["point_cloud_pixels"][env, 0, 15, 20, 0].item() == pytest.approx(expected, abs=1e-5)
            assert gtd["segmentation_pixels"][env, 0, 15, 20].item() == 0


def test_every_image_stands_in_the_gtd_under_its_key(device: torch.device) -> None:
    scene = place_shapes([WALL], [([4.1, 0, 0], [0, 0, 0])], device)
    gtd = GlobalTensorDictionary(device=device, sizes={"E": 1})
    pose = {"position": torch.zeros(1, 3, device=device), "attitude": LEVEL.repeat(1, 1).to(device)}
    lidar = LidarCfg(
        summary="test lidar", width=36, height=4, azimuth_low_deg=-180.0, azimuth_high_deg=180.0, elevation_low_deg=-10.0,
        elevation_high_deg=10.0, min_range=0.1, max_range=20.0, points="sensor", source="chosen for the test",
    )  # fmt: skip
    full = replace(CAMERA, points="world", normals="sensor", face_ids=True)
    manager = SensorManager({"full": full, "lidar": lidar}, gtd, scene, Carrier(**pose), num_envs=1, device=device)
    manager.capture()
    kinds = ("depth_range", "segmentation", "point_cloud", "normal", "face_id")
    assert set(gtd) == {f"{kind}_pixels" for kind in kinds} | {
        "lidar_depth_range_pixels", "lidar_segmentation_pixels", "lidar_point_cloud_pixels",
    }  # fmt: skip
    assert gtd["lidar_point_cloud_pixels"].shape == (1, 1, 4, 36, 3)
    ahead = gtd["lidar_point_cloud_pixels"][0, 0, ..., 0]
    assert ahead[ahead != 0.0].min() > 3.99
    with pytest.raises(ShapeError, match=r"mask is \(3,\) torch.bool"):
        manager.reset(torch.ones(3, dtype=torch.bool, device=device))
    late = replace(CAMERA, latency_s=0.1)
    with pytest.raises(ConfigError, match=r"sensor late: latency_s = 0.1 needs the length of a step"):
        SensorManager({"late": late}, gtd, scene, Carrier(**pose), num_envs=1, device=device)
