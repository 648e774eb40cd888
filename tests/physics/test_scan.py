"""Motion distortion of turning lidars: closed forms at every column, and ray by ray in float64 for any twist."""

from dataclasses import replace
from math import pi

import pytest
import torch
from torch import Tensor

from aerial_gym.assets import Scene
from aerial_gym.config.environment import PartCfg, ShapeCfg
from aerial_gym.config.sensor import LidarCfg, LightCfg
from aerial_gym.errors import ConfigError
from aerial_gym.math.quaternion import quat_exp, quat_from_euler, quat_multiply, quat_rotate, quat_rotate_inverse
from aerial_gym.registry import GlobalTensorDictionary
from aerial_gym.sensors import RayCaster, SensorImages, SensorManager
from aerial_gym.sensors.mounts import Carrier
from tests.physics.sensor_rig import LEVEL, make_wall, shoot

SCAN_S = 0.1
LIDAR = LidarCfg(
    summary="test lidar", width=40, height=12, elevation_low_deg=-25.0, elevation_high_deg=35.0, min_range=0.0,
    max_range=30.0, scan_s=SCAN_S, source="chosen for the test",
)  # fmt: skip
SECTOR = replace(LIDAR, azimuth_low_deg=-50.0, azimuth_high_deg=50.0)
TREE = ShapeCfg(
    kind="compound",
    parts=(
        PartCfg(shape=ShapeCfg(kind="sphere", radius=0.7), position=(0.1, 0.0, 0.9)),
        PartCfg(shape=ShapeCfg(kind="box", size=(0.6, 0.6, 2.0)), position=(0.0, 0.0, -0.6)),
    ),
)
BALL, BRICK, GROUND = (
    ShapeCfg(kind="sphere", radius=1.0), ShapeCfg(kind="box", size=(1.0, 1.6, 2.2)), ShapeCfg(kind="plane"),
)  # fmt: skip
SHAPES = [TREE, BALL, BRICK, GROUND]

pytestmark = pytest.mark.usefixtures("few_rays")


def crowd(device: torch.device, *, moving: bool) -> Scene:
    """Return two environments with the same shapes in another order, at their own poses, with their own twists."""
    draw = torch.Generator().manual_seed(6)
    state = torch.zeros(2, 4, 13)
    order = torch.tensor([[0, 1, 2, 3], [2, 3, 1, 0]])
    places = torch.tensor([[3.0, 1.2, 0.3], [-3.0, 0.6, 0.2], [0.5, -3.0, 0.5], [0.0, 0.0, -1.5]])
    state[..., :3] = places[order] + 0.2 * torch.rand(2, 4, 3, generator=draw)
    state[..., 3:7] = quat_from_euler(0.4 * torch.rand(2, 4, 3, generator=draw) - 0.2)
    twists = torch.rand(2, 4, 6, generator=draw) - 0.5
    state[..., 7:] = twists * torch.tensor([6.0, 6.0, 6.0, 4.0, 4.0, 4.0]) * moving
    ids = torch.arange(4).repeat(2, 1)
    return Scene(SHAPES, shape_index=order, semantic_id=ids, asset_state=state.to(device))


def azimuths(cfg: LidarCfg) -> Tensor:
    """Return the azimuth of every column [rad], (W,); a full turn keeps half a step from both ends."""
    low, high, count = cfg.azimuth_low_deg, cfg.azimuth_high_deg, cfg.width
    half = 0.5 * (high - low) / count if high - low == 360.0 else 0.0
    return torch.deg2rad(torch.linspace(high - half, low + half, count, dtype=torch.float64))


def ages(cfg: LidarCfg) -> Tensor:
    """Return the time from the measurement of each column to the capture [s], (W,), from its azimuth."""
    azimuth = azimuths(cfg)
    away = azimuth - azimuth[-1] if cfg.scan_clockwise else azimuth[0] - azimuth
    return SCAN_S * away / (2.0 * pi)


def middle_ages(cfg: LidarCfg) -> Tensor:
    """Return the mean age of the columns of every column's group, (W,)."""
    groups = ages(cfg).split(cfg.scan_columns)
    return torch.cat([group.mean().expand(len(group)) for group in groups])


@pytest.mark.parametrize("columns", [1, 6, 40])
def test_at_rest_a_scan_is_the_image_of_an_instant_bit_for_bit(columns: int, device: torch.device) -> None:
    """Every image, with two lidars in each of two environments, also with columns that do not fit into tiles."""
    scene = crowd(device, moving=False)
    cfg = replace(
        LIDAR, count=2, points="world", normals="sensor", face_ids=True, light=LightCfg(), position=(0.2, 0.1, 0.0),
        euler=(0.1, -0.2, 0.3), scan_columns=columns,
    )  # fmt: skip
    pose = {
        "position": torch.tensor([[0.1, 0.2, 0.0], [0.0, -0.3, 0.1]]),
        "attitude": quat_from_euler(torch.tensor([[0.1, 0.0, 0.4], [-0.2, 0.1, 2.0]])),
    }
    scanned, still = shoot(cfg, scene, **pose).images, shoot(replace(cfg, scan_s=None), scene, **pose).images
    assert (scanned.distance > 0.0).float().mean() > 0.4
    for name in ("distance", "segmentation", "points", "normals", "face_ids", "color"):
        assert torch.equal(getattr(scanned, name), getattr(still, name)), name


@pytest.mark.parametrize("clockwise", [True, False])
@pytest.mark.parametrize("cfg", [LIDAR, SECTOR], ids=["turn", "sector"])
def test_flying_at_a_wall_each_column_has_the_range_of_its_own_time(
    cfg: LidarCfg, clockwise: bool, device: torch.device
) -> None:
    """With t the age of a column, the wall was v t further away: r = (d + v t) / (cos el cos az). The last column, right
    or left, belongs to the capture."""
    cfg, speed, depth = replace(cfg, scan_clockwise=clockwise), 8.0, 6.0
    caster = shoot(cfg, make_wall(depth, device), lin_vel=torch.tensor([[speed, 0.0, 0.0]]))
    result, ahead = caster.images.distance[0, 0].cpu().double(), caster.direction[..., 0].cpu().double()
    age = ages(cfg)
    assert age[-1 if clockwise else 0] == 0.0
    assert age.max() == pytest.approx(SCAN_S * (39 / 40 if cfg.full_turn else 100 / 360))
    expected = (depth + speed * age) / ahead
    seen = (ahead > 0.05) & (expected < 29.0)
    assert seen.float().mean() > 0.3
    torch.testing.assert_close(result[seen], expected[seen], rtol=1e-6, atol=1e-6)
    assert (result[ahead < 0.0] == -1.0).all()


def meet(shape: ShapeCfg, start: Tensor, ray: Tensor) -> Tensor:
    """Return the distance at which rays enter a shape in its own frame, inf for a miss, (...); float64."""
    if shape.kind == "plane":
        t = -start[..., 2] / ray[..., 2]
        return torch.where(t > 0.0, t, torch.inf)
    if shape.kind == "sphere":
        along = (start * ray).sum(-1)
        root = along**2 - (start**2).sum(-1) + shape.radius**2
        t = -along - root.clamp(min=0.0).sqrt()
        return torch.where((root > 0.0) & (t > 0.0), t, torch.inf)
    half = 0.5 * torch.tensor(shape.size, dtype=torch.float64)
    one, two = (-half - start) / ray, (half - start) / ray
    near, far = torch.minimum(one, two).amax(-1), torch.maximum(one, two).amin(-1)
    return torch.where((near <= far) & (near > 0.0), near, torch.inf)


@pytest.mark.parametrize("clockwise", [True, False])
@pytest.mark.parametrize("columns", [1, 4])
def test_any_twists_of_robot_and_obstacles_match_an_intersection_of_every_ray(
    clockwise: bool, columns: int, device: torch.device
) -> None:
    """Each ray starts where its sensor was, and meets the obstacles where they were, all moved back in float64; in two
    environments with two lidars each. Ranges, ids, points and normals; sensor points are those along the ray itself."""
    cfg = replace(
        LIDAR, count=2, points="world", normals="world", position=(0.3, -0.2, 0.1), euler=(0.2, 0.1, -0.3), height=24,
        width=96, scan_clockwise=clockwise, scan_columns=columns,
    )  # fmt: skip
    scene, draw = crowd(device, moving=True), torch.Generator().manual_seed(7)
    robot = {
        "position": 0.6 * torch.rand(2, 3, generator=draw) - 0.3,
        "attitude": quat_from_euler(torch.rand(2, 3, generator=draw) - 0.5),
        "lin_vel": 10.0 * torch.rand(2, 3, generator=draw) - 5.0,
        "ang_vel": 8.0 * torch.rand(2, 3, generator=draw) - 4.0,
    }
    caster = shoot(cfg, scene, **robot)
    images = caster.images
    rays = caster.direction.cpu().double()
    age = middle_ages(cfg)[:, None]  # (W, 1)
    at_mount = torch.tensor(cfg.position, dtype=torch.float64)
    mount = quat_from_euler(torch.tensor(cfg.euler, dtype=torch.float64))
    for env in range(2):
        position, attitude, lin_vel, ang_vel = (robot[key][env].double() for key in robot)
        body = quat_multiply(attitude.expand(cfg.width, 4), quat_exp(-ang_vel * age))
        origin = position - lin_vel * age + quat_rotate(body, at_mount.expand(cfg.width, 3))
        sensor = quat_multiply(body, mount.expand(cfg.width, 4))
        heading = quat_rotate(sensor.expand(cfg.height, -1, 4), rays)
        nearest = torch.full((cfg.height, cfg.width), torch.inf, dtype=torch.float64)
        expected_id = torch.full(nearest.shape, -2)
        for instance in range(4):
            state = scene.asset_state[env, instance].cpu().double()
            turned = quat_multiply(quat_exp(-state[10:13] * age), state[3:7].expand(cfg.width, 4))
            place = state[:3] - state[7:10] * age
            shape = SHAPES[int(scene.shape_index[env, instance])]
            for part in shape.parts or (PartCfg(shape=shape),):
                own = quat_rotate_inverse(turned, origin - place) - torch.tensor(part.position, dtype=torch.float64)
                t = meet(part.shape, own, quat_rotate_inverse(turned.expand(cfg.height, -1, 4), heading))
                closer = t < nearest
                nearest, expected_id = torch.where(closer, t, nearest), torch.where(closer, instance, expected_id)
        out_of_reach = nearest > cfg.max_range
        expected_id[out_of_reach] = -2
        for number in range(2):
            ids = images.segmentation[env, number].cpu()
            same = ids == expected_id
            assert same.float().mean() > 0.998  # rays along an edge may fall to either side
            assert all((ids == instance).any() for instance in (-2, 0, 1, 2, 3))
            hit = same & (ids >= 0)
            result = images.distance[env, number].cpu().double()
            error = (result - nearest)[hit].abs() / nearest[hit]
            assert error.quantile(0.99) < 1e-5
            assert error.max() < 1e-3  # where a ray grazes a surface, round-off counts more
            exact = hit & ((result - nearest).abs() < 1e-4)
            point = origin + nearest.unsqueeze(-1) * heading
            torch.testing.assert_close(
                images.points[env, number].cpu().double()[exact], point[exact], rtol=0.0, atol=2e-4
            )
            normals = images.normals[env, number].cpu().double()
            instance = int((scene.shape_index[env] == 3).nonzero()[0, 0])
            state = scene.asset_state[env, instance].cpu().double()
            turned = quat_multiply(quat_exp(-state[10:13] * age), state[3:7].expand(cfg.width, 4))
            up = quat_rotate(turned, torch.tensor([0.0, 0.0, 1.0], dtype=torch.float64).expand(cfg.width, 3))
            ground = ids == instance
            torch.testing.assert_close(normals[ground], up.expand(cfg.height, -1, 3)[ground], rtol=0.0, atol=1e-5)
    still = shoot(replace(cfg, scan_s=None), scene, **robot).images.distance
    assert ((still - images.distance).abs() > 0.05).float().mean() > 0.3


def test_points_in_the_sensor_frame_lie_along_the_rays_of_the_table(device: torch.device) -> None:
    """Raw, as drivers give them: range times direction, whatever the twist."""
    cfg = replace(SECTOR, points="sensor")
    twist = {"lin_vel": torch.tensor([[3.0, 1.0, 0.5]]), "ang_vel": torch.tensor([[0.5, -0.7, 2.0]])}
    caster = shoot(cfg, make_wall(6.0, device), **twist)
    expected = caster.images.distance.unsqueeze(-1) * caster.direction
    torch.testing.assert_close(caster.images.points, expected, rtol=1e-6, atol=0.0)
    assert (caster.images.distance > 0.0).all()


def test_a_scan_with_rate_and_latency_is_that_of_its_own_capture(device: torch.device) -> None:
    """10 Hz and 30 ms on 10 ms steps, at 2 m/s towards a wall: at step n the column of age t shows the robot as it was at
    the last capture that is 3 steps old, 0.02 (capture) - 2 t m on its way."""
    cfg, gtd = replace(SECTOR, rate_hz=10.0, latency_s=0.03), GlobalTensorDictionary(device=device, sizes={"E": 1})
    state = {"position": torch.zeros(1, 3, device=device), "attitude": LEVEL.repeat(1, 1).to(device)}
    twist = {"lin_vel": torch.tensor([[2.0, 0.0, 0.0]], device=device), "ang_vel": torch.zeros(1, 3, device=device)}
    manager = SensorManager(
        {"top": cfg}, gtd, make_wall(6.0, device), Carrier(**state, **twist), num_envs=1, device=device, dt=0.01
    )
    manager.reset(torch.ones(1, dtype=torch.bool, device=device))
    ahead = manager.casters["top"].direction[..., 0].cpu().double()
    for step in range(25):
        state["position"][0, 0] = 0.02 * step
        manager.capture()
        captured = max(step - 3, 0) // 10 * 10
        expected = (6.0 - 0.02 * captured + 2.0 * ages(cfg)) / ahead
        torch.testing.assert_close(gtd["depth_range_pixels"][0, 0].cpu().double(), expected, rtol=1e-6, atol=1e-6)


def test_impossible_scans_are_refused(device: torch.device) -> None:
    for columns in (0, 41, 2.5):
        with pytest.raises(
            ConfigError, match=rf"LidarCfg.scan_columns = {columns}: must be a whole number from 1 to width"
        ):
            replace(LIDAR, scan_columns=columns)
    shape = (1, 1, 12, 40)
    images = SensorImages(distance=torch.zeros(shape), segmentation=torch.zeros(shape, dtype=torch.int32))
    pose = Carrier(position=torch.zeros(1, 3), attitude=LEVEL.repeat(1, 1))
    with pytest.raises(ConfigError, match=r"LidarCfg.scan_s needs lin_vel and ang_vel"):
        RayCaster(LIDAR, make_wall(4.0, torch.device("cpu")), images, pose)


def test_an_empty_scene_is_scanned(device: torch.device) -> None:
    scene = Scene(
        [], shape_index=torch.zeros(0), semantic_id=torch.zeros(0), asset_state=torch.zeros(1, 0, 13).to(device)
    )
    assert (shoot(LIDAR, scene, lin_vel=torch.ones(1, 3)).images.distance == -1.0).all()
