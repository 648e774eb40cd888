# pyright: reportArgumentType=false, reportCallIssue=false, reportIndexIssue=false, reportOperatorIssue=false
# pyright: reportGeneralTypeIssues=false, reportAttributeAccessIssue=false, reportOptionalMemberAccess=false
# (Warp compiles the kernels from their source; Python's type rules do not describe them.)
"""Goals drawn at reset. A draw depends on the seed, its environment and how often that was reset, on nothing else.

Frames: world of each environment, z up. Letters: E environments.
"""

import torch
import warp as wp
from torch import Tensor

from aerial_gym.config.robot import Vec3
from aerial_gym.interop import on_torch_stream
from aerial_gym.math.draws import draw_vec3

_STREAM = 0x60A15EED
"""Added to the seed, so that goals, robots and obstacles, which are drawn alike, have different numbers."""


@wp.kernel(enable_backward=False)
def _draw_goals(
    mask: wp.array[wp.bool],  # (E,)
    # params
    seed: wp.array[wp.int32],  # (1,)
    ratio_low: wp.vec3,  # share of the bounds
    ratio_high: wp.vec3,
    bounds_min: wp.array[wp.vec3],  # (E,) world [m]
    bounds_max: wp.array[wp.vec3],  # (E,) world [m]
    # out
    episode_out: wp.array[wp.int32],  # (E,) counted up
    goal_out: wp.array[wp.vec3],  # (E,) world [m]
):
    """Write a new goal where the mask says so; leave every other row alone."""
    env = wp.tid()
    if not mask[env]:
        return
    episode = episode_out[env]
    episode_out[env] = episode + 1
    random = wp.rand_init(int(wp.rand_init(seed[0], env)), episode)
    ratio = draw_vec3(random, 0, ratio_low, ratio_high)
    goal_out[env] = bounds_min[env] + wp.cw_mul(ratio, bounds_max[env] - bounds_min[env])


class Goals:
    """Draws the goals of masked environments, with all views made at construction."""

    def __init__(self, goal: Tensor, *, bounds: tuple[Tensor, Tensor], ratios: tuple[Vec3, Vec3], seed: int) -> None:
        """Take what is written and what it depends on.

        Args:
            goal: Written where a mask says so [m], world, (E, 3).
            bounds: Lower and upper corner [m], world, each (E, 3); read at every draw.
            ratios: Lowest and highest goal as a share of the bounds.
            seed: Of all draws.
        """
        envs, device = goal.shape[0], goal.device
        self._mask = torch.zeros(envs, dtype=torch.bool, device=device)
        self._seed = torch.zeros(1, dtype=torch.int32, device=device)
        self._episode = torch.zeros(envs, dtype=torch.int32, device=device)
        self._kept_alive = (goal, bounds)
        self.restart(seed)
        inputs = [wp.from_torch(self._mask), wp.from_torch(self._seed), *(wp.vec3(*ratio) for ratio in ratios)]
        self._command = wp.launch(
            _draw_goals,
            dim=envs,
            inputs=[*inputs, *(wp.from_torch(corner, dtype=wp.vec3) for corner in bounds)],
            outputs=[wp.from_torch(self._episode), wp.from_torch(goal, dtype=wp.vec3)],
            device=wp.device_from_torch(device),
            record_cmd=True,
        )

    def restart(self, seed: int) -> None:
        """Begin the draws of a seed anew."""
        self._seed.fill_((seed + _STREAM) % 2**31)
        self._episode.zero_()

    def draw(self, mask: Tensor) -> None:
        """Draw for the environments in ``mask``, bool (E,); launched on torch's current stream, not waited for."""
        self._mask.copy_(mask)
        with on_torch_stream(self._mask):
            self._command.launch()
