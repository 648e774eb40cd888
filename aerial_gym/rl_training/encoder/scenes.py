"""A fixed set of images: scenes of registered environments, seen by a robot's camera from drawn poses.

The collision distance of a pixel is the free flight distance of a ball along its ray. Unlike a range it tells directly whether
the robot fits. Letters: B images, H x W pixels, N = H W rays.
Equal for equal settings, seed and kind of device. Letters: E environments, N images, H x W pixels.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from math import pi

import torch
from torch import Tensor

from aerial_gym.assets.cores import body_reach
from aerial_gym.config.range_sensor import RangeSensorCfg
from aerial_gym.config.robot import InitialStateCfg, RobotCfg
from aerial_gym.env_manager import EnvManager, SimBuilder
from aerial_gym.errors import ConfigError
from aerial_gym.math.rows import dot
from aerial_gym.rl_training.encoder.settings import EncoderTrainingCfg
from aerial_gym.robots.catalog import robot_by_name
from aerial_gym.sensors import ray_table
from aerial_gym.sensors.encoder.file import normalize_image

PAIRS = {"cpu": 1 << 18, "cuda": 1 << 24}  # Pairs of rays and points per block: 1 MB fit a cache, 64 MB fill a GPU


def collision_distance(distance: Tensor, rays: Tensor, *, radius: float, largest: float) -> Tensor:
    """Return the free distance of a ball along each ray before a point of the image, ``t = p.u - sqrt(r² - |p x u|²)``.

    It is exact for the points of the image; hidden surfaces and those between rays are ignored. A ball that
    touches a point at the start flies 0.

    Args:
        distance: Along each ray to the hit [m], ``largest`` or more without a hit, (B, H, W).
        rays: Unit directions u, sensor frame, (H, W, 3).
        radius: Of the ball r [m], > 0.
        largest: Result for a ray without a touch [m], > 0.

    Returns:
        Distance [m], 0 to ``largest``, (B, H, W).

    Source:
        The idea of encoding collisions in place of distances: Kulkarni and Alexis (2023), Task-Driven Compression for
        Collision Encoding Based on Depth Images. Derived: the ball's centre t u is r from p where |p - t u|² = r².
    """
    directions = rays.reshape(-1, 3).to(distance)
    flat = distance.reshape(len(distance), -1)
    result = torch.empty_like(flat)
    pairs = PAIRS.get(flat.device.type, PAIRS["cuda"])
    for block in torch.arange(len(directions), device=flat.device).split(max(1, pairs // len(directions))):
        cosine = dot(directions[block].unsqueeze(1), directions).clamp(-1.0, 1.0)  # of rays and points
        sine2 = (1.0 - cosine.square()).clamp_min(0.0)
        for images in torch.arange(len(flat), device=flat.device).split(max(1, pairs // cosine.numel())):
            result[images.unsqueeze(1), block] = _touch_distance(flat[images], cosine, sine2, radius, largest)
    return result.reshape(distance.shape)


def _touch_distance(distance: Tensor, cosine: Tensor, sine2: Tensor, radius: float, largest: float) -> Tensor:
    """Return the least t over all points, (B, R), of distances (B, N), by cosine and squared sine of R rays and N points."""
    points = distance.unsqueeze(1)  # (B, 1, N)
    within = radius * radius - points.square() * sine2
    touches = points * cosine - within.clamp_min(0.0).sqrt()
    behind = (cosine <= 0.0) & (points >= radius)
    missed = (within < 0.0) | (points >= largest) | behind
    return touches.masked_fill(missed, largest).amin(-1).clamp(0.0, largest)


SIDE_BY_SIDE = 512  # Environments that are rendered at once

POSES = InitialStateCfg(
    position_ratio_low=(0.03, 0.05, 0.05), position_ratio_high=(0.97, 0.95, 0.95), euler_low=(-0.35, -0.35, -pi),
    euler_high=(0.35, 0.35, pi),
)  # fmt: skip
"""Anywhere in the bounds, any heading, tilted by up to 20 degrees; the environment keeps its clearance about it."""

ProgressReport = Callable[[str, float], None]  # Receives a description of the work and the share that is done


@dataclass(frozen=True, kw_only=True)
class ImageSet:
    """Images of one sensor, each a share of its largest distance."""

    seen: Tensor  # Sensor images, (N, H, W)
    target: Tensor  # Images to be reconstructed, (N, H, W)
    env: Tensor  # Number of the environment in the settings, (N,)

    def __len__(self) -> int:
        return len(self.seen)


def image_sensor(cfg: EncoderTrainingCfg) -> RangeSensorCfg:
    """Return the first camera or lidar of the robot, from a small simulation; raise ``ConfigError`` if it has none."""
    with_one = _build_simulation(cfg, cfg.envs[0], num_envs=1, seed=0, device=cfg.device)
    try:
        casters = with_one.sensor_manager.casters
        if not casters:
            raise ConfigError(f"robot {cfg.robot} has no camera or lidar to encode. Choose one with a sensor")
        return next(iter(casters.values())).cfg
    finally:
        with_one.close()


def render_images(
    cfg: EncoderTrainingCfg, count: int, *, seed: int, device: torch.device, tell: ProgressReport = lambda _, __: None
) -> ImageSet:
    """Return ``count`` images of the settings' environments, each of another scene with a random number of obstacles."""
    sensor, robot = image_sensor(cfg), robot_by_name(cfg.robot)
    parts = []
    for number, env in enumerate(cfg.envs):
        share = count // len(cfg.envs) + (number < count % len(cfg.envs))
        images = _environment_images(cfg, env, share, seed=seed, device=device, tell=tell)
        parts.append((normalize_image(images, sensor), torch.full((share,), number, device=device)))
    seen, env = torch.cat([part for part, _ in parts]), torch.cat([part for _, part in parts])
    target = seen if cfg.target == "distance" else collision_images(seen, sensor, radius=collision_radius(cfg, robot))
    return ImageSet(seen=seen, target=target, env=env)


def collision_radius(cfg: EncoderTrainingCfg, robot: RobotCfg) -> float:
    """Return the radius of a robot's collision ball [m]."""
    radius = body_reach(robot.collision.shapes) if cfg.radius_m is None else cfg.radius_m
    if radius <= 0.0:
        raise ConfigError(f"robot {cfg.robot}: has no shape to collide with. Give radius_m")
    return radius


def collision_images(seen: Tensor, sensor: RangeSensorCfg, *, radius: float) -> Tensor:
    """Return ``collision_distance`` images of range images (N, H, W), both as shares of the largest distance."""
    rays = ray_table(sensor, device=seen.device)
    ahead = rays[..., 0] if sensor.kind == "depth" else torch.ones_like(rays[..., 0])
    largest = sensor.max_range / float(ahead.min())  # beyond what any ray measures
    along = torch.where(seen >= 1.0, largest, seen * sensor.max_range / ahead)
    return (collision_distance(along, rays, radius=radius, largest=largest) * ahead / sensor.max_range).clamp_max(1.0)


def _environment_images(
    cfg: EncoderTrainingCfg, env: str, count: int, *, seed: int, device: torch.device, tell: ProgressReport
) -> Tensor:
    """Return the images of one environment in the unit of the sensor, (N, H, W)."""
    simulation = _build_simulation(cfg, env, num_envs=min(SIDE_BY_SIDE, count), seed=seed, device=device)
    removable = simulation.cfg.num_assets - simulation.cfg.num_kept
    generator = torch.Generator().manual_seed(seed)
    images: list[Tensor] = []
    while (done := sum(len(part) for part in images)) < count:
        tell(f"rendering {env}", done / count)
        if simulation.cfg.num_assets:
            obstacles = int(torch.randint(0, removable + 1, (), generator=generator))
            simulation.asset_manager.set_num_obstacles(obstacles)
        simulation.reset()
        simulation.render()
        images.append(simulation.gtd["depth_range_pixels"][: count - done, 0].clone())
    simulation.close()
    return torch.cat(images)


def _build_simulation(
    cfg: EncoderTrainingCfg, env: str, *, num_envs: int, seed: int, device: torch.device | str
) -> EnvManager:
    return SimBuilder().build_env(
        sim_name="base_sim", env_name=env, robot_name=replace(robot_by_name(cfg.robot), initial_state=POSES),
        controller_name="lee_velocity_control", num_envs=num_envs, device=device, seed=seed,
    )  # fmt: skip
