"""Where a reset puts bounds and obstacles, and which obstacles an environment has.

Frames: world of each environment, z up. Letters: E environments, A instances.
"""

import torch
import warp as wp
from torch import Tensor

from aerial_gym.assets.obstacles import Obstacles, draw_instance
from aerial_gym.assets.scene import PARKED_Z
from aerial_gym.config.environment import AssetCfg, EnvironmentCfg
from aerial_gym.interop import on_torch_stream
from aerial_gym.math.random import uniform


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


@wp.kernel(enable_backward=False)
def _begin_episode(
    mask: wp.array[wp.bool],  # (E,)
    # out
    episode_out: wp.array[wp.int32],  # (E,)
):
    """Count the resets of masked environments."""
    env = wp.tid()
    if mask[env]:
        episode_out[env] = episode_out[env] + 1


@wp.kernel(enable_backward=False)
def _place(
    mask: wp.array[wp.bool],  # (E,)
    # params
    num_kept: int,
    num_others: wp.array[wp.int32],  # (1,) assets not kept that are placed
    parked_z: float,  # [m]
    # out
    obstacles_out: Obstacles,
):
    """Write new states where the mask says so, and park the rows beyond the number; leave other environments alone."""
    env, a = wp.tid()
    if not mask[env]:
        return
    draw_instance(obstacles_out, env, a, 0)
    if a >= num_kept + num_others[0]:
        place = obstacles_out.position[env, a]
        obstacles_out.position[env, a] = wp.vec3(place[0], place[1], parked_z)
        obstacles_out.lin_vel[env, a] = wp.vec3(0.0, 0.0, 0.0)
        obstacles_out.ang_vel[env, a] = wp.vec3(0.0, 0.0, 0.0)


class Placement:
    """Draws the obstacles of masked environments, with all views made at construction."""

    def __init__(self, obstacles: Obstacles, *, mask: Tensor, num_kept: int, num_others: Tensor) -> None:
        """Take what is written and what it depends on.

        Args:
            obstacles: Written where the mask says so.
            mask: Environments to reset, bool, (E,); read at every launch.
            num_kept: Instances that are always present, the first rows.
            num_others: How many of the others are, int32, (1,); read at every launch.
        """
        self._mask, self._kept_alive = mask, (obstacles, num_others)
        asked = wp.from_torch(mask)
        self._commands = [
            wp.launch(
                _begin_episode,
                dim=mask.shape[0],
                inputs=[asked],
                outputs=[obstacles.episode],
                device=asked.device,
                record_cmd=True,
            ),
            wp.launch(
                _place,
                dim=obstacles.asset.shape,
                inputs=[asked, num_kept, wp.from_torch(num_others), PARKED_Z],
                outputs=[obstacles],
                device=asked.device,
                record_cmd=True,
            ),
        ]

    def draw(self) -> None:
        """Place the obstacles; launched on torch's current stream, not waited for."""
        with on_torch_stream(self._mask):
            for command in self._commands:
                command.launch()
