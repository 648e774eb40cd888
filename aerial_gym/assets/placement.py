"""Random draws at a reset: bounds of environments, kinds of obstacles and their places.

Frames: world of each environment, z up. Letters: E environments, A instances.
"""

import torch
import warp as wp
from torch import Tensor

from aerial_gym.assets.obstacles import Obstacles, draw_instance, park_instance
from aerial_gym.assets.scene import PARKED_Z
from aerial_gym.config.environment import AssetCfg, EnvironmentCfg
from aerial_gym.interop import ReusableLaunch, start_warp
from aerial_gym.math.draws import RandomArrays, draw_vec3, episode_stream, random_arrays
from aerial_gym.math.random import Purpose, Randomness, copy_mask, state_of_count, uniform_draw


@wp.kernel(enable_backward=False)
def _draw_bounds(
    mask: wp.array[wp.bool],  # (E,)
    # params
    random: RandomArrays,
    lower_low: wp.vec3,  # [m] world
    lower_high: wp.vec3,
    upper_low: wp.vec3,
    upper_high: wp.vec3,
    # out
    lower_out: wp.array[wp.vec3],  # (E,) [m] world
    upper_out: wp.array[wp.vec3],
):
    """Draw new corners for masked environments; leave all other rows alone."""
    env = wp.tid()
    if not mask[env]:
        return
    stream = episode_stream(random, env, wp.static(int(Purpose.BOUNDS)))
    lower_out[env] = draw_vec3(stream, 0, lower_low, lower_high)
    upper_out[env] = draw_vec3(stream, 1, upper_low, upper_high)


class Bounds:
    """Draws of the bounds of masked environments; all views are made at construction."""

    def __init__(self, cfg: EnvironmentCfg, *, lower: Tensor, upper: Tensor, random: Randomness) -> None:
        """Record the launch, and set the corners [m], world, (E, 3), to the smallest ones until the first reset."""
        start_warp()
        envs, device = lower.shape[0], lower.device
        limits = (cfg.bounds_lower_low, cfg.bounds_lower_high, cfg.bounds_upper_low, cfg.bounds_upper_high)
        lower.copy_(torch.tensor(limits[0], device=device))
        upper.copy_(torch.tensor(limits[2], device=device))
        self._mask = random.mask
        self._command: ReusableLaunch | None = None
        if limits[0] != limits[1] or limits[2] != limits[3]:
            self._command = ReusableLaunch(
                _draw_bounds,
                dim=envs,
                inputs=[self._mask, random_arrays(random), *(wp.vec3(*limit) for limit in limits)],
                outputs=[lower, upper],
                device=device,
            )

    def draw(self, mask: Tensor) -> None:
        """Launch the draw for the environments in ``mask``, bool (E,), on torch's current stream."""
        if self._command is not None:
            copy_mask(self._mask, mask)
            self._command.launch(self._mask)


def draw_kinds(assets: tuple[AssetCfg, ...], random: Randomness) -> tuple[Tensor, Tensor]:
    """Draw asset index and shape index of each instance, both int64 (E, A), valid for all episodes of the seed.

    Kept assets come first, in the order of the configuration. The rest are shuffled in each environment, so that their
    first n are a fair sample.
    """
    device, num_envs = random.seed.device, random.num_envs
    kept = [i for i, asset in enumerate(assets) if asset.keep for _ in range(asset.count)]
    rest = [i for i, asset in enumerate(assets) if not asset.keep for _ in range(asset.count)]
    key = _random_state_of_obstacles(random, Purpose.ASSETS, len(rest))
    order = key.argsort(dim=1, stable=True)
    shuffled = torch.tensor(rest, device=device, dtype=torch.int64)[order]
    fixed = torch.tensor(kept, device=device, dtype=torch.int64).expand(num_envs, -1)
    asset = torch.cat((fixed, shuffled), dim=1)
    choices = torch.tensor([len(a.shapes) for a in assets], device=device, dtype=torch.int64)[asset]
    share = uniform_draw(_random_state_of_obstacles(random, Purpose.SHAPES, asset.shape[1]), dtype=torch.float64)
    return asset, (share * choices).long()


def _random_state_of_obstacles(random: Randomness, purpose: Purpose, count: int) -> Tensor:
    """Return a random state for each of ``count`` obstacles, int64, (E, count)."""
    return state_of_count(
        random.stream_of_all_episodes(purpose).unsqueeze(-1), torch.arange(count, device=random.seed.device)
    )


@wp.kernel(enable_backward=False)
def _place_instances(
    mask: wp.array[wp.bool],  # (E,)
    # params
    num_kept: int,
    num_others: wp.array[wp.int32],  # (1,) assets not kept that are placed
    parked_z: float,  # [m]
    # out
    obstacles_out: Obstacles,
):
    """Draw new states in masked environments, and park the rows beyond the number of obstacles."""
    env, a = wp.tid()
    if not mask[env]:
        return
    draw_instance(obstacles_out, env, a, 0)
    if a >= num_kept + num_others[0]:
        park_instance(obstacles_out, env, a, parked_z)


class Placement:
    """Draws of obstacles in masked environments; all views are made at construction."""

    def __init__(self, obstacles: Obstacles, *, mask: Tensor, num_kept: int, num_others: Tensor) -> None:
        """Record the launch; mask, bool (E,), and number of instances not always kept, int32 (1,), are read anew."""
        self._mask = mask
        asked = wp.from_torch(mask)
        self._command = ReusableLaunch(
            _place_instances, dim=obstacles.asset.shape, inputs=[asked, num_kept, num_others, PARKED_Z],
            outputs=[obstacles], device=asked.device,
        )  # fmt: skip

    def draw(self) -> None:
        """Launch the placement of obstacles on torch's current stream."""
        self._command.launch(self._mask)
