"""Optical flow: closed forms of turning and moving cameras, and finite differences of projected material points."""

from collections.abc import Sequence
from dataclasses import replace
from math import radians, tan

import pytest
import torch
from torch import Tensor

from aerial_gym.assets import Scene
from aerial_gym.config.environment import PartCfg, ShapeCfg
from aerial_gym.config.sensor import CameraCfg, FisheyeCfg, LidarCfg, NoiseCfg, RangeSensorCfg, RayTableCfg, StereoCfg
from aerial_gym.errors import ConfigError, ShapeError
from aerial_gym.math.quaternion import quat_exp, quat_from_euler, quat_multiply, quat_rotate, quat_rotate_inverse
from aerial_gym.registry import GlobalTensorDictionary
from aerial_gym.robots import ROBOTS
from aerial_gym.sensors import SENSORS, RayCaster, SensorManager, make_images
from aerial_gym.sensors.mounts import Carrier
from tests.builders import simulation
from tests.physics.sensor_rig import LEVEL, make_wall, shoot

pytestmark = pytest.mark.usefixtures("few_rays")

COMMON = {
    "summary": "test", "width": 36, "height": 28, "min_range": 0.0, "max_range": 20.0, "optical_flow": True,
    "source": "chosen for the test",
}  # fmt: skip
PINHOLE = CameraCfg(**COMMON, hfov_deg=80.0)
STEREO = StereoCfg(**COMMON, hfov_deg=80.0, baseline=-0.1)
FISHEYE = FisheyeCfg(**{**COMMON, "width": 35, "height": 27}, hfov_deg=200.0)
"""Odd numbers of pixels: one looks along the axis."""

FOCAL = 18.0 / tan(radians(40.0))


def sense_flow(
    cfg: RangeSensorCfg, scene: Scene, *, velocity: Sequence[float] = (0.0,) * 3, rates: Sequence[float] = (0.0,) * 3
) -> Tensor:
    caster = shoot(cfg, scene, lin_vel=torch.tensor([velocity]), ang_vel=torch.tensor([rates]))
    return caster.images.optical_flow[0, 0].cpu()


def pixels(cfg: RangeSensorCfg) -> tuple[Tensor, Tensor]:
    """Return the offsets of every pixel right of and below the image centre, (H, W) each."""
    right = torch.arange(cfg.width) + 0.5 - 0.5 * cfg.width
    down = torch.arange(cfg.height) + 0.5 - 0.5 * cfg.height
    v, u = torch.meshgrid(down, right, indexing="ij")
    return u, v


def close(result: Tensor, right: Tensor, down: Tensor) -> None:
    expected = torch.stack((right.expand_as(result[..., 0]), down.expand_as(result[..., 0])), dim=-1)
    torch.testing.assert_close(result, expected, rtol=0.0, atol=4e-6 * float(expected.abs().max() + 1.0))


def test_noise_and_limits_of_the_distance_leave_the_flow_alone(device: torch.device) -> None:
    scene, velocity = make_wall(4.0, device), (1.0, 0.5, 0.0)
    noisy = replace(PINHOLE, noise=NoiseCfg(std_c=0.3, dropout=0.3), min_range=4.5)
    assert torch.equal(sense_flow(noisy, scene, velocity=velocity), sense_flow(PINHOLE, scene, velocity=velocity))


TREE = ShapeCfg(
    kind="compound",
    parts=(
        PartCfg(shape=ShapeCfg(kind="cylinder", radius=0.3, height=2.0), position=(0.0, 0.0, -0.5)),
        PartCfg(
            shape=ShapeCfg(kind="capsule", radius=0.3, height=1.0), position=(0.2, 0.1, 1.0), euler=(0.5, 1.0, 0.2)
        ),
    ),
)
SHAPES = [TREE, ShapeCfg(kind="box", size=(1.0, 1.4, 0.8)), ShapeCfg(kind="sphere", radius=0.8), ShapeCfg(kind="plane")]


def crowd(device: torch.device) -> Scene:
    draw = torch.Generator().manual_seed(4)
    state = torch.zeros(2, 4, 13)
    order = torch.tensor([[0, 1, 2, 3], [2, 3, 1, 0]])
    places = torch.tensor([[3.0, 1.2, 0.3], [3.0, -0.4, 0.2], [3.5, -2.0, 1.0], [0.0, 0.0, -1.5]])
    state[..., :3] = places[order] + 0.2 * torch.rand(2, 4, 3, generator=draw)
    state[..., 3:7] = quat_from_euler(0.4 * torch.rand(2, 4, 3, generator=draw) - 0.2)
    state[..., 7:] = 2.0 * torch.rand(2, 4, 6, generator=draw) - 1.0
    ids = torch.arange(4).repeat(2, 1)
    return Scene(SHAPES, shape_index=order, semantic_id=ids, asset_state=state.to(device))


def project(cfg: RangeSensorCfg, point: Tensor) -> Tensor:
    """Return the image coordinates of a point in the sensor's frame, right of and below the centre [pixel], (..., 2)."""
    x, y, z = point.unbind(-1)
    if isinstance(cfg, FisheyeCfg):
        off_axis = torch.arccos((x / point.norm(dim=-1)).clamp(-1.0, 1.0))
        radius = cfg.width / radians(cfg.hfov_deg) * off_axis
        bearing = torch.atan2(-z, -y)
        return torch.stack((radius * torch.cos(bearing), radius * torch.sin(bearing)), dim=-1)
    return 0.5 * cfg.width / tan(0.5 * radians(cfg.hfov_deg)) * torch.stack((-y / x, -z / x), dim=-1)


def difference(cfg: RangeSensorCfg, setting: dict[str, Tensor], dt: float) -> Tensor:
    """Return the optical flow of the material points [pixel/s]: the difference of two projections ``dt`` apart, in float64."""

    def image(t: float) -> Tensor:
        turned = quat_exp(setting["spin"] * t)
        at_instance = setting["place"] + setting["velocity"] * t
        world = at_instance + quat_rotate(turned, setting["point"] - setting["place"])
        attitude = quat_multiply(setting["attitude"], quat_exp(setting["rates"] * t))
        position = setting["position"] + setting["own_velocity"] * t
        sky = quat_rotate(setting["attitude"], quat_rotate(setting["mount"], setting["ray"]))
        body = quat_rotate_inverse(attitude, world - position) - torch.tensor(cfg.position, dtype=torch.float64)
        body = torch.where(setting["hit"], body, quat_rotate_inverse(attitude, sky))
        return project(cfg, quat_rotate_inverse(setting["mount"], body))

    return (image(dt) - image(0.0)) / dt


@pytest.mark.parametrize("cfg", [PINHOLE, STEREO, FISHEYE], ids=lambda cfg: cfg.model)
def test_flow_is_the_limit_of_the_differences_of_projected_points(cfg: RangeSensorCfg, device: torch.device) -> None:
    """The points seen are carried along by obstacles and projected again: forward differences converge with the first order
    in dt, and their extrapolation agrees. Two environments with two sensors each, anywhere on the robot."""
    cfg = replace(cfg, points="world", count=2, position=(0.3, -0.2, 0.1), euler=(0.2, 0.1, -0.3), kind="range")
    scene = crowd(device)
    draw = torch.Generator().manual_seed(5)
    position, lin_vel, ang_vel = (0.6 * torch.rand(2, 3, generator=draw) - 0.3 for _ in range(3))
    attitude = quat_from_euler(0.4 * torch.rand(2, 3, generator=draw) - 0.2)
    lin_vel, ang_vel = 3.0 * lin_vel, 3.0 * ang_vel
    caster = shoot(cfg, scene, position=position, attitude=attitude, lin_vel=lin_vel, ang_vel=ang_vel)
    images = caster.images
    ids, size = images.segmentation.cpu(), images.segmentation.shape
    assert all((ids == instance).any() for instance in (-2, 0, 1, 2, 3))

    def per_pixel(of_env: Tensor) -> Tensor:
        return of_env.double().view(2, 1, 1, 1, -1).expand(*size, -1)

    state = scene.asset_state.cpu().double()
    seen = torch.stack([state[env][ids[env].clamp(min=0).long()] for env in range(2)])
    setting = {
        "place": seen[..., :3], "velocity": seen[..., 7:10], "spin": seen[..., 10:13],
        "point": images.points.cpu().double(), "hit": (ids >= 0).unsqueeze(-1),
        "position": per_pixel(position), "attitude": per_pixel(attitude / attitude.norm(dim=-1, keepdim=True)),
        "own_velocity": per_pixel(lin_vel), "rates": per_pixel(ang_vel),
        "ray": caster.direction.cpu().double().expand(*size, 3),
        "mount": quat_from_euler(torch.tensor(cfg.euler, dtype=torch.float64)).expand(*size, 4),
    }  # fmt: skip
    results = images.optical_flow.cpu().double()
    at_rest = torch.zeros_like(setting["rates"])
    shown = difference(
        cfg, {**setting, "rates": at_rest, "own_velocity": at_rest, "spin": at_rest, "velocity": at_rest}, 1
    )
    assert (shown == 0.0).all()
    near = (
        results.norm(dim=-1) < 200.0
    )  # what passes at a hand's breadth does not move evenly for a thousandth of a second
    if isinstance(cfg, StereoCfg):
        near &= images.distance.cpu() > 0.0  # a pixel that the second camera does not share has no point
        near |= ids < 0
    assert near.float().mean() > 0.5
    steps = [2e-3, 1e-3, 5e-4]
    coarse = [difference(cfg, setting, dt)[near] for dt in steps]
    errors = torch.stack([(one - results[near]).norm(dim=-1).mean() for one in coarse]).log2()
    orders = errors[:-1] - errors[1:]
    assert ((orders - 1.0).abs() < 0.1).all(), orders
    extrapolated = 2.0 * coarse[2] - coarse[1]
    error = (extrapolated - results[near]).norm(dim=-1) / (1.0 + results[near].norm(dim=-1))
    assert error.max() < 1e-3
    assert error.mean() < 1e-5


def test_flow_stands_in_the_gtd_for_every_sensor_and_environment(device: torch.device) -> None:
    """Two cameras with their own prefix; the flow follows velocities that are written between two images."""
    gtd = GlobalTensorDictionary(device=device, sizes={"E": 1})
    pose = {"position": torch.zeros(1, 3, device=device), "attitude": LEVEL.repeat(1, 1).to(device)}
    twist = {"lin_vel": torch.zeros(1, 3, device=device), "ang_vel": torch.zeros(1, 3, device=device)}
    cameras = {"front": PINHOLE, "wide": FISHEYE, "late": replace(PINHOLE, latency_s=0.01)}
    manager = SensorManager(
        cameras, gtd, make_wall(4.0, device), Carrier(**pose, **twist), num_envs=1, device=device, dt=0.01
    )
    manager.capture()
    assert gtd["optical_flow_pixels"].shape == (1, 1, 28, 36, 2)
    assert (gtd["optical_flow_pixels"] == 0.0).all()
    twist["lin_vel"][0, 1] = 1.0
    manager.capture()
    close(gtd["optical_flow_pixels"][0, 0].cpu(), torch.tensor(FOCAL / 4.0), torch.tensor(0.0))
    assert gtd["wide_optical_flow_pixels"][0, 0, 13, 17, 0].item() == pytest.approx(
        35.0 / radians(200.0) / 4.0, rel=1e-5
    )
    assert (gtd["late_optical_flow_pixels"] == 0.0).all()


def test_flow_is_refused_where_there_is_no_image_plane_or_no_velocity(device: torch.device) -> None:
    common = {**COMMON, "width": 2, "height": 1}
    with pytest.raises(
        ConfigError, match=r"LidarCfg.optical_flow = True: a lidar has no image plane; a pinhole, stereo"
    ):
        LidarCfg(**common, elevation_low_deg=-10.0, elevation_high_deg=10.0)
    with pytest.raises(ConfigError, match=r"RayTableCfg.optical_flow = True: a ray_table has no image plane"):
        RayTableCfg(**common, rays=((1.0, 0.0, 0.0), (1.0, 1.0, 0.0)))
    scene, images = make_wall(4.0, device), make_images(PINHOLE, 1, device=device)
    pose = {"position": torch.zeros(1, 3, device=device), "attitude": LEVEL.repeat(1, 1).to(device)}
    with pytest.raises(ConfigError, match=r"CameraCfg.optical_flow needs lin_vel and ang_vel"):
        RayCaster(PINHOLE, scene, images, Carrier(**pose))
    with pytest.raises(ShapeError, match=r"optical_flow must be given exactly if the sensor has such an image"):
        RayCaster(replace(PINHOLE, optical_flow=False), scene, images, Carrier(**pose))
    twist = {"lin_vel": torch.zeros(2, 3, device=device), "ang_vel": torch.zeros(1, 3)}
    with pytest.raises(ShapeError, match=r"lin_vel is \(2, 3\)"):
        RayCaster(PINHOLE, scene, images, Carrier(**pose, **twist))


def test_the_environment_gives_its_cameras_the_velocities_of_the_robot() -> None:
    """A camera of a level robot that flies ahead at v and yaws at r about its origin: du = f r (1 + U²) + (u v + f r l) / Z
    at a depth Z, with the lever l = 0.1 m of the mount."""
    speed, rate = 1.5, 0.4
    env = simulation(
        replace(ROBOTS.get("base_quadrotor"), sensors=("base_optical_flow_camera",)),
        "lee_velocity_control",
        env="env_with_obstacles",
    )
    env.reset()
    env.gtd["robot_orientation"].copy_(LEVEL)
    env.gtd["robot_linvel"].copy_(torch.tensor([speed, 0.0, 0.0]))
    env.gtd["robot_body_angvel"].copy_(torch.tensor([0.0, 0.0, rate]))
    env.render()
    cfg = SENSORS.get("base_optical_flow_camera")
    u, _ = pixels(cfg)
    focal = 0.5 * cfg.width / tan(0.5 * radians(cfg.hfov_deg))
    depth, results = env.gtd["depth_range_pixels"][:, 0], env.gtd["optical_flow_pixels"][:, 0, ..., 0]
    seen = depth > 0.0
    assert seen.float().mean() > 0.02
    near = torch.where(seen, (u * speed + focal * rate * 0.1) / depth, 0.0)
    expected = focal * rate * (1.0 + (u / focal) ** 2) + near
    torch.testing.assert_close(results[seen], expected[seen], rtol=1e-4, atol=1e-3)
