"""Scenes and casters for tests of range sensors, on level bodies at rest at the origin unless told otherwise."""

from collections.abc import Sequence

import torch
from torch import Tensor

from aerial_gym.assets import Scene
from aerial_gym.config.environment import LampCfg, ShapeCfg
from aerial_gym.config.sensor import RangeSensorCfg
from aerial_gym.math.quaternion import quat_from_euler
from aerial_gym.math.random import Randomness
from aerial_gym.sensors import RayCaster, make_images
from aerial_gym.sensors.mounts import Carrier

LEVEL = torch.tensor([0.0, 0.0, 0.0, 1.0])
WALL = ShapeCfg(kind="box", size=(0.2, 60.0, 60.0))


def make_scene(
    shapes: Sequence[ShapeCfg], position: Tensor, attitude: Tensor | None = None, *, device: torch.device,
    ids: Tensor | None = None, twist: Sequence[float] = (0.0,) * 6, lamps: tuple[LampCfg, ...] = (),
) -> Scene:  # fmt: skip
    """Return a scene whose instance a is shape a, at poses (E, A, 3), (E, A, 4), level unless given."""
    rows, size = torch.arange(len(shapes)), position.shape[:2]
    turn = LEVEL.expand(*size, 4) if attitude is None else attitude
    state = torch.cat((position, turn, torch.tensor(twist).expand(*size, 6)), dim=-1).float().to(device)
    return Scene(
        list(shapes), shape_index=rows, semantic_id=rows if ids is None else ids, asset_state=state, lamps=lamps
    )


def place_shapes(
    shapes: Sequence[ShapeCfg], poses: Sequence[tuple[Sequence[float], Sequence[float]]], device: torch.device, *,
    num_envs: int = 1, lamps: tuple[LampCfg, ...] = (),
) -> Scene:  # fmt: skip
    """Return a scene with each shape at a position and Euler angles, the same in every environment."""
    position, euler = (torch.tensor([pose[k] for pose in poses]).repeat(num_envs, 1, 1) for k in range(2))
    return make_scene(shapes, position, quat_from_euler(euler), device=device, lamps=lamps)


def make_wall(depth: float, device: torch.device, *, num_envs: int = 1, twist: Sequence[float] = (0.0,) * 6) -> Scene:
    """Return a wall across the x axis with its near side at a depth, in each environment."""
    place = torch.tensor([depth + 0.1, 0.0, 0.0]).repeat(num_envs, 1, 1)
    return make_scene([WALL], place, device=device, twist=twist)


def make_caster(cfg: RangeSensorCfg, scene: Scene, *, seed: int = 0, **state: Tensor) -> RayCaster:
    """Return a caster with poisoned images, on bodies with this ``position``, ``attitude``, ``lin_vel`` and ``ang_vel``."""
    num_envs, device = scene.num_envs, scene.device
    zero = torch.zeros(num_envs, 3)
    body = {"position": zero, "attitude": LEVEL.repeat(num_envs, 1), "lin_vel": zero, "ang_vel": zero, **state}
    images = make_images(cfg, num_envs, device=device, poisoned=True)
    random = Randomness(num_envs, device=device, seed=seed)
    carrier = Carrier(**{name: rows.float().clone().to(device) for name, rows in body.items()})
    return RayCaster(cfg, scene, images, carrier, random=random)


def shoot(cfg: RangeSensorCfg, scene: Scene, *, seed: int = 0, **state: Tensor) -> RayCaster:
    """Return a caster that has taken one image."""
    caster = make_caster(cfg, scene, seed=seed, **state)
    caster.cast()
    return caster
