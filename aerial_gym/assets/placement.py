"""Where a reset puts bounds and obstacles: pure functions of configurations, tensors and a generator.

Frames: world of each environment, z up. Letters: E environments, A instances.
"""

from dataclasses import dataclass

import torch
from torch import Tensor

from aerial_gym.config.environment import AssetCfg, EnvironmentCfg
from aerial_gym.math.quaternion import quat_from_euler
from aerial_gym.math.random import uniform


@dataclass(frozen=True, kw_only=True)
class PlacementRanges:
    """From what the pose of every instance is drawn."""

    ratio_low: Tensor
    """Lowest position as a share of the bounds, (E, A, 3)."""

    ratio_high: Tensor
    """Highest position, likewise, (E, A, 3)."""

    offset: Tensor
    """Added to the position [m], world, (E, A, 3)."""

    euler_low: Tensor
    """Lowest ZYX roll, pitch, yaw [rad], (E, A, 3)."""

    euler_high: Tensor
    """Highest roll, pitch, yaw [rad], (E, A, 3)."""


def bounds_ranges(cfg: EnvironmentCfg, *, device: torch.device) -> Tensor:
    """Return the limits of the bounds [m], world, (2, 2, 3): lower and upper corner, each from lowest to highest."""
    lower = (cfg.bounds_lower_low, cfg.bounds_lower_high)
    return torch.tensor((lower, (cfg.bounds_upper_low, cfg.bounds_upper_high)), device=device)


def draw_bounds(ranges: Tensor, *, num_envs: int, generator: torch.Generator) -> tuple[Tensor, Tensor]:
    """Return lower and upper corners [m], world, each (E, 3), uniform within ``bounds_ranges``."""
    shape = (num_envs, 3)
    lower = uniform(ranges[0, 0], ranges[0, 1], shape, generator=generator)
    return lower, uniform(ranges[1, 0], ranges[1, 1], shape, generator=generator)


def draw_kinds(assets: tuple[AssetCfg, ...], *, num_envs: int, generator: torch.Generator) -> tuple[Tensor, Tensor]:
    """Return which asset and which of its shapes each instance is, both int64 (E, A), on the generator's device.

    Kept assets come first, in the order of the configuration; the rest are shuffled in each environment, so that the
    first n of them are a fair sample.
    """
    device = generator.device
    kept = [i for i, asset in enumerate(assets) if asset.keep for _ in range(asset.count)]
    rest = [i for i, asset in enumerate(assets) if not asset.keep for _ in range(asset.count)]
    order = torch.rand(num_envs, len(rest), device=device, generator=generator).argsort(dim=1)
    shuffled = torch.tensor(rest, device=device, dtype=torch.int64)[order]
    fixed = torch.tensor(kept, device=device, dtype=torch.int64).expand(num_envs, -1)
    asset = torch.cat((fixed, shuffled), dim=1)
    choices = torch.tensor([len(a.shapes) for a in assets], device=device, dtype=torch.int64)[asset]
    draw = torch.rand(asset.shape, device=device, generator=generator)
    return asset, torch.minimum((draw * choices).long(), choices - 1)


def placement_ranges(assets: tuple[AssetCfg, ...], asset: Tensor, *, device: torch.device) -> PlacementRanges:
    """Return the ranges of every instance, given which asset it is, integer (E, A)."""

    def per_instance(name: str) -> Tensor:
        rows = torch.tensor([getattr(a, name) for a in assets], device=device, dtype=torch.float32).view(-1, 3)
        return rows[asset]

    return PlacementRanges(
        ratio_low=per_instance("position_ratio_low"),
        ratio_high=per_instance("position_ratio_high"),
        offset=per_instance("offset"),
        euler_low=per_instance("euler_low"),
        euler_high=per_instance("euler_high"),
    )


def draw_states(ranges: PlacementRanges, lower: Tensor, upper: Tensor, *, generator: torch.Generator) -> Tensor:
    """Return poses at rest for all environments, (E, A, 13): position, attitude xyzw, zero velocities; world.

    Args:
        ranges: From what to draw.
        lower: Lower corner of the bounds [m], world, (E, 3).
        upper: Upper corner [m], world, (E, 3).
        generator: Source of chance, on the device of the tensors.
    """
    shape = tuple(ranges.offset.shape)
    ratio = uniform(ranges.ratio_low, ranges.ratio_high, shape, generator=generator)
    euler = uniform(ranges.euler_low, ranges.euler_high, shape, generator=generator)
    # Weighing the corners gives each of them exactly at ratio 0 and 1, which lower + ratio * (upper - lower) does not.
    position = (1.0 - ratio) * lower[:, None] + ratio * upper[:, None] + ranges.offset
    still = torch.zeros(*shape[:2], 6, device=position.device, dtype=position.dtype)
    return torch.cat((position, quat_from_euler(euler), still), dim=-1)
