"""What range sensors of several vehicles in one environment see: each other, and themselves only where they are visible."""

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
import torch
from torch import Tensor

from aerial_gym import ENVIRONMENTS, ROBOTS, EnvManager, SimBuilder
from aerial_gym.assets import Scene
from aerial_gym.config.environment import AssetCfg, EnvironmentCfg, PartCfg, ShapeCfg
from aerial_gym.config.loader import dump_yaml
from aerial_gym.config.robot import CollisionCfg, RobotCfg, SphereCfg
from aerial_gym.config.sensor import CameraCfg, LidarCfg, NoiseCfg, RangeSensorCfg, StereoCfg
from aerial_gym.config.sensor_mount import SensorMountCfg
from aerial_gym.config.shape import FIRST_INSTANCE_ID, GROUND_ID
from aerial_gym.math.quaternion import quat_from_euler
from aerial_gym.sensors import RayCaster, make_images
from aerial_gym.sensors.mounts import Carrier
from tests.physics.test_optical_flow import difference
from tests.physics.test_ray_caster import pixel_rays, rotation
from tests.repetitions import rare_values
from tests.unit.env_manager.test_batch_independence import assert_same

pytestmark = pytest.mark.usefixtures("few_rays")

E = 2
RADIUS = 0.3
COMMON = {"summary": "test", "min_range": 0.0, "max_range": 20.0, "source": "chosen for the test"}
CAMERA = CameraCfg(
    **COMMON, width=48, height=36, hfov_deg=90.0, kind="range", points="world", normals="world", optical_flow=True,
    position=(0.1, 0.02, 0.03), euler=(0.05, -0.1, 0.1),
)  # fmt: skip
STEREO = StereoCfg(**COMMON, width=24, height=20, hfov_deg=80.0, baseline=-0.1, points="sensor")
LIDAR = LidarCfg(**COMMON, width=64, height=16, elevation_low_deg=-40.0, elevation_high_deg=40.0, normals="sensor")
TURNING = replace(LIDAR, scan_s=0.1, scan_columns=8, points="world")
OPEN = replace(ENVIRONMENTS.get("empty_env"), ground_height=-5.0)
BALL = CollisionCfg(spheres=(SphereCfg(center=(0.0, 0.0, 0.0), radius=RADIUS),))
QUAD = replace(ROBOTS.get("base_quadrotor"), collision=BALL)
POD = PartCfg(shape=ShapeCfg(kind="box", size=(0.3, 0.2, 0.1)), position=(0.1, 0.0, 0.05), euler=(0.1, 0.2, 0.3))
MAST = PartCfg(shape=ShapeCfg(kind="capsule", radius=0.04, height=0.3), position=(-0.1, 0.0, 0.2), semantic_id=7)


def build(*robots: tuple[RobotCfg, int], env: EnvironmentCfg | str = OPEN, **options: Any) -> EnvManager:
    """Return a simulation of kinds ``a``, ``b``, ..., each a robot and its count."""
    kinds = [{"name": robot, "count": count, "kind": "abc"[k]} for k, (robot, count) in enumerate(robots)]
    given = {"sim_name": "base_sim", "controller_name": "no_control", "num_envs": E, "device": "cpu", "seed": 3}
    return SimBuilder().build_env(**given | options, env_name=env, robots=kinds)


@pytest.fixture
def mount(tmp_path):
    """Return a function that puts sensors on a robot; the first has the plain keys."""

    def add_sensors(robot: RobotCfg, *sensors: RangeSensorCfg) -> RobotCfg:
        mounts = []
        for number, cfg in enumerate(sensors):
            file = tmp_path / f"sensor{number}_{len(list(tmp_path.iterdir()))}.yaml"
            file.write_text(dump_yaml(cfg), encoding="utf-8")
            mounts.append(SensorMountCfg(sensor=str(file), name=f"sensor{number}"))
        return replace(robot, sensors=tuple(mounts))

    return add_sensors


def place(env: EnvManager, positions: list[list[float]], *, seed: int = 1) -> None:
    """Put the vehicles of all kinds, in order, at positions, with drawn twists and attitudes about a heading along x or
    against it in turn, and fly one step."""
    draw, places = torch.Generator().manual_seed(seed), iter(positions)
    env.reset()
    for group in env.kinds.values():
        for v in range(group.kind.count):
            views = {key: group.gtd[key][:, v] for key in ("robot_position", "robot_orientation", "robot_linvel")}
            views["robot_position"][:] = torch.tensor(next(places)) + 0.1 * torch.rand(E, 3, generator=draw)
            angles = 0.4 * torch.rand(E, 3, generator=draw) - 0.2 + torch.tensor([0.0, 0.0, torch.pi * v])
            views["robot_orientation"][:] = quat_from_euler(angles)
            views["robot_linvel"][:] = 4.0 * torch.rand(E, 3, generator=draw) - 2.0
            group.gtd["robot_body_angvel"][:, v] = 4.0 * torch.rand(E, 3, generator=draw) - 2.0
    step(env)


def step(env: EnvManager) -> None:
    zero = {name: torch.zeros(env.num_envs, g.kind.count, g.robot_manager.num_actions) for name, g in env.kinds.items()}
    env.step(zero if len(zero) > 1 else next(iter(zero.values())))


def eye(gtd: Mapping[str, Tensor], env: int, v: int) -> tuple[np.ndarray, np.ndarray]:
    """Return origin and unit rays (N, 3) of the camera of a vehicle, world, in float64."""
    turn = rotation(gtd["robot_orientation"][env, v])
    origin = gtd["robot_position"][env, v].double().numpy() + turn @ np.array(CAMERA.position)
    mount = rotation(quat_from_euler(torch.tensor(CAMERA.euler, dtype=torch.float64)))
    return origin, pixel_rays(CAMERA) @ (turn @ mount).T


def test_another_vehicle_is_seen_at_its_place_and_the_own_body_is_not(mount) -> None:
    """Range, normal, point and id of a ball of 0.3 m, in closed form; each camera sits inside its own ball."""
    env = build((mount(QUAD, CAMERA), 3), env="empty_env")
    place(env, [[0.0, 0.0, 0.0], [2.0, 0.3, 0.1], [3.0, -1.0, -0.2]])
    env.render()
    gtd = env.gtd
    assert gtd["depth_range_pixels"].shape == (E, 3, 1, 36, 48)
    counted = 0
    for e in range(E):
        for v in range(3):
            origin, rays = eye(gtd, e, v)
            exact = np.full(len(rays), np.inf)
            ids = np.full(len(rays), -2)
            for other in {0, 1, 2} - {v}:
                centre = gtd["robot_position"][e, other].double().numpy() - origin
                along = rays @ centre
                square = along**2 - centre @ centre + RADIUS**2
                near = np.where((square > 0.0) & (along > 0.0), along - np.sqrt(np.maximum(square, 0.0)), np.inf)
                ids[near < exact] = FIRST_INSTANCE_ID + other
                exact = np.minimum(exact, near)
            image = {key: gtd[f"{key}_pixels"][e, v, 0].flatten(0, 1).numpy() for key in (
                "depth_range", "segmentation", "normal", "point_cloud")}  # fmt: skip
            assert (image["segmentation"] != ids).mean() < 0.003  # edges
            hit = (image["segmentation"] == ids) & (ids > 0)
            np.testing.assert_allclose(image["depth_range"][hit], exact[hit], atol=2e-5)
            points = origin + exact[hit, None] * rays[hit]
            np.testing.assert_allclose(image["point_cloud"][hit], points, atol=2e-5)
            centres = gtd["robot_position"][e, ids[hit] - FIRST_INSTANCE_ID].double().numpy()
            np.testing.assert_allclose(image["normal"][hit], (points - centres) / RADIUS, atol=2e-3)
            counted += int(hit.sum())
    assert counted > 150


def test_a_visible_vehicle_sees_itself_too(mount) -> None:
    """From inside its own ball a camera sees nothing else, under the vehicle's own id."""
    env = build((mount(replace(QUAD, visible=True), CAMERA), 2))
    place(env, [[0.0, 0.0, 0.0], [2.0, 0.3, 0.1]])
    env.render()
    assert (env.gtd["depth_range_pixels"] < 2 * RADIUS).all()
    own = FIRST_INSTANCE_ID + torch.arange(2).view(1, 2, 1, 1, 1)
    assert (env.gtd["segmentation_pixels"] == own).all()


def obstacle_view(env: EnvManager, name: str, sensor: str, v: int) -> dict[str, Tensor]:
    """Return the images of a sensor of vehicle ``v`` of a kind, with all other vehicles as obstacles of a scene."""
    shapes, rows, ids, first = [], [], [], 0
    for kind, group in env.kinds.items():
        parts = tuple(replace(part, link="base") for part in group.kind.robot.appearance)
        for other in range(group.kind.count):
            if (kind, other) != (name, v):
                shapes.append(ShapeCfg(kind="compound", parts=parts))
                rows.append(group.gtd["robot_state_tensor"][:, other])
                ids.append(FIRST_INSTANCE_ID + env.cfg.num_assets + first + other)
        first += group.kind.count
    semantic_ids = torch.tensor(ids)
    scene = Scene(
        shapes, shape_index=torch.arange(len(shapes)), semantic_id=semantic_ids, asset_state=torch.stack(rows, dim=1),
        fixed=() if env.cfg.ground_part is None else (env.cfg.ground_part,),
    )  # fmt: skip
    group = env.kinds[name]
    cfg = group.sensor_manager.casters[sensor].cfg
    keys = {"position": "robot_position", "attitude": "robot_orientation", "lin_vel": "robot_linvel"}
    motion = {field: group.gtd[key][:, v].clone() for field, key in keys.items()}
    carrier = Carrier(**motion, ang_vel=group.gtd["robot_body_angvel"][:, v].clone())
    caster = RayCaster(cfg, scene, make_images(cfg, E, device=env.device, poisoned=True), carrier)
    caster.cast()
    return dict(caster.images.items())


@pytest.mark.parametrize("kinds", rare_values([1, 2], [1]))
def test_another_vehicle_looks_as_an_obstacle_of_its_shape_and_motion(kinds: int, mount) -> None:
    """Cameras with flow, stereo pairs and lidars, also turning ones: every image, bit for bit."""
    sensors = (CAMERA, STEREO, LIDAR, TURNING)
    shown = mount(replace(QUAD, visual=(POD, MAST)), *sensors)
    robots = [(shown, 3)] if kinds == 1 else [(shown, 2), (mount(QUAD, LIDAR, CAMERA), 1)]
    env = build(*robots)
    place(env, [[0.0, 0.0, 0.0], [1.5, 0.3, 0.1], [2.5, -0.6, -0.1]])
    env.render()
    seen = set[int]()
    for name, group in env.kinds.items():
        for sensor, caster in group.sensor_manager.casters.items():
            for v in range(group.kind.count):
                expected = obstacle_view(env, name, sensor, v)
                result = {
                    key: image.unflatten(0, (E, -1))[:, v] for key, image in caster.images.items() if image is not None
                }
                assert_same(result, expected)
                seen |= set(result["segmentation"].unique().tolist())
    assert seen >= {100, 101, 102, 7, GROUND_ID}


def test_the_flow_of_a_moving_vehicle_is_the_difference_of_projections(mount) -> None:
    """The points seen are carried along by the other vehicle and projected again, 1 ms apart in both directions."""
    env = build((mount(replace(QUAD, visual=(POD, MAST)), CAMERA), 2))
    place(env, [[0.0, 0.0, 0.0], [1.0, 0.1, 0.0]])
    env.render()
    gtd, other = env.gtd, 1
    size = gtd["depth_range_pixels"][:, 0].shape
    camera = env.sensor_manager.casters["sensor0"]

    def per_pixel(key: str, v: int) -> Tensor:
        return gtd[key][:, v].double().view(E, 1, 1, 1, -1).expand(*size, -1)

    setting = {
        "place": per_pixel("robot_position", other), "velocity": per_pixel("robot_linvel", other),
        "spin": per_pixel("robot_angvel", other), "point": gtd["point_cloud_pixels"][:, 0].double(),
        "hit": torch.ones(*size, 1, dtype=torch.bool), "position": per_pixel("robot_position", 0),
        "attitude": per_pixel("robot_orientation", 0), "own_velocity": per_pixel("robot_linvel", 0),
        "rates": per_pixel("robot_body_angvel", 0), "ray": camera.direction.double().expand(*size, 3),
        "mount": quat_from_euler(torch.tensor(CAMERA.euler, dtype=torch.float64)).expand(*size, 4),
    }  # fmt: skip
    setting["attitude"] = setting["attitude"] / setting["attitude"].norm(dim=-1, keepdim=True)
    seen = gtd["segmentation_pixels"][:, 0] == FIRST_INSTANCE_ID + other
    assert seen.sum() > 50
    expected = 0.5 * (difference(CAMERA, setting, 1e-3) + difference(CAMERA, setting, -1e-3))[seen]
    result = gtd["optical_flow_pixels"][:, 0].double()[seen]
    assert result.norm(dim=-1).min() > 1.0
    torch.testing.assert_close(result, expected, rtol=1e-4, atol=1e-2)


def images(env: EnvManager) -> dict[str, Tensor]:
    """Return copies of all images, (E, V, ...), by kind and key."""
    views = {f"{name}.{key}": value for name, group in env.kinds.items() for key, value in group.gtd.items()}
    return {key: value.clone() for key, value in views.items() if key.endswith("_pixels")}


NOISY = replace(
    CAMERA, noise=NoiseCfg(std_b=0.05, dropout=0.1), position_low=(0.0, -0.1, 0.0), position_high=(0.2, 0.1, 0.1),
    euler_low=(-0.1,) * 3, euler_high=(0.1,) * 3, rate_hz=30.0, latency_s=0.03,
)  # fmt: skip


def test_vehicles_far_apart_see_what_single_vehicles_see_bit_for_bit(mount) -> None:
    """With noise, drawn places, a rate and a latency: body e V + v is environment e V + v of single vehicles."""
    wide = {name: (sign * 500.0,) * 3 for sign, side in ((-1, "lower"), (1, "upper")) for name in (
        f"bounds_{side}_low", f"bounds_{side}_high")}  # fmt: skip
    start = replace(QUAD.initial_state, position_ratio_low=(0.0, 0.0, 0.5), position_ratio_high=(1.0, 1.0, 0.5))
    robot = mount(replace(QUAD, initial_state=start), NOISY)
    env = replace(OPEN, **wide)
    many = build((robot, 3), env=env)
    alone = SimBuilder().build_env(
        sim_name="base_sim", controller_name="no_control", num_envs=3 * E, device="cpu", seed=3, env_name=env,
        robot_name=robot,
    )  # fmt: skip
    results = []
    for flown in (many, alone):
        flown.reset()
        for number in range(6):
            flown.step(torch.zeros(*flown.gtd["robot_position"].shape[:-1], 4))
            flown.render()
            if number == 2:
                mask = torch.arange(3 * E) == 4
                flown.reset(mask.view(flown.gtd["crashes"].shape))
        results.append({key: flown.gtd[key].clone() for key in flown.gtd if key.endswith("_pixels")})
    assert (results[1]["segmentation_pixels"] == GROUND_ID).any()
    assert_same({key: image.flatten(0, 1) for key, image in results[0].items()}, results[1])


def test_an_environment_sees_the_same_alone_and_among_others(mount) -> None:
    """Two kinds among obstacles whose order is drawn, with noise: environment 1 alone, and of two."""
    crowd = tuple(
        AssetCfg(
            name=kind, count=8, semantic_id=number, shapes=(ShapeCfg(kind=kind, radius=0.3, height=1.0),),
            position_ratio_low=(0.2, 0.0, 0.0), position_ratio_high=(1.0, 1.0, 1.0),
        )
        for number, kind in ((3, "cylinder"), (4, "capsule"))
    )  # fmt: skip
    env = replace(ENVIRONMENTS.get("env_with_obstacles"), reset_together=True, assets=crowd)
    results = []
    for num_envs, first in ((E, 0), (1, 1)):
        many = build((mount(QUAD, NOISY), 2), (mount(QUAD, LIDAR), 1), env=env, num_envs=num_envs, first_env=first)
        many.reset()
        for number in range(4):
            step(many)
            many.render()
            if number == 1:
                many.reset(torch.arange(first, first + num_envs) == 1)
        results.append({key: image[-1] for key, image in images(many).items()})
    assert_same(*results)


@pytest.mark.parametrize("by_vehicle", [False, True])
def test_images_of_a_mask_alone_are_taken(by_vehicle: bool, mount) -> None:
    env = build((mount(QUAD, CAMERA), 2), (mount(QUAD, LIDAR), 1))
    place(env, [[0.0, 0.0, 0.0], [1.5, 0.3, 0.1], [2.5, -0.6, -0.1]])
    mask = torch.tensor([[False, True, True], [False, False, False]]) if by_vehicle else torch.tensor([True, False])
    rows = mask if by_vehicle else mask.unsqueeze(1).expand(E, 3)
    before = images(env)
    env.render(mask)
    after = images(env)
    for key in before:
        own = rows[:, :2] if key.startswith("a") else rows[:, 2:]
        assert torch.equal(after[key][~own], before[key][~own])
        if own.any() and "depth" in key:
            assert (after[key][own] != before[key][own]).flatten(1).any(dim=1).all()


def test_links_of_another_vehicle_are_seen_where_they_are(mount) -> None:
    """An arm that bends is seen at the place of its link, by the camera of a rigid vehicle beside it."""
    pod = replace(POD, link="arm1", position=(0.1, 0.1, 0.0))
    bending = ROBOTS.get("morphy")
    link = bending.link_names[1]
    shown = replace(bending, visual=(replace(pod, link=link), MAST))
    env = build((mount(QUAD, CAMERA), 2), (shown, 2))
    place(env, [[0.0, 0.0, 0.0], [1.5, 0.3, 0.1], [1.0, -0.6, -0.1], [0.8, 0.5, 0.0]])
    env.render()
    places = env.kinds["b"].gtd["robot_link_state_tensor"]
    assert not torch.equal(places[:, :, 0, 3:7], places[:, :, 1, 3:7])
    rows, shapes = [], []
    parts = ((replace(pod, link="base"),), (MAST,))
    for v in range(2):
        for number, own in zip((1, 0), parts, strict=True):
            rows.append(places[:, v, number])
            shapes.append(ShapeCfg(kind="compound", parts=own))
    rows.append(env.kinds["a"].gtd["robot_state_tensor"][:, 1])
    shapes.append(ShapeCfg(kind="compound", parts=tuple(QUAD.appearance)))
    ids = torch.tensor([102, 102, 103, 103, 101])
    scene = Scene(
        shapes, shape_index=torch.arange(5), semantic_id=ids, asset_state=torch.stack(rows, dim=1),
        fixed=(OPEN.ground_part,),
    )  # fmt: skip
    group = env.kinds["a"]
    keys = {"position": "robot_position", "attitude": "robot_orientation", "lin_vel": "robot_linvel"}
    motion = {field: group.gtd[key][:, 0].clone() for field, key in keys.items()}
    carrier = Carrier(**motion, ang_vel=group.gtd["robot_body_angvel"][:, 0].clone())
    caster = RayCaster(CAMERA, scene, make_images(CAMERA, E, device=env.device), carrier)
    caster.cast()
    seen = group.sensor_manager.casters["sensor0"].images
    assert {102, 103} <= set(seen["segmentation"].unique().tolist())
    assert_same({name: image.unflatten(0, (E, 2))[:, 0] for name, image in seen.items()}, dict(caster.images.items()))
