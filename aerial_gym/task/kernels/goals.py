"""Goals drawn at reset.

Frames: world of each environment, z up. Letters: E environments.
"""

import warp as wp
from torch import Tensor

from aerial_gym.config.robot import Vec3
from aerial_gym.interop import ReusableLaunch
from aerial_gym.interop.streams import BLOCK_DIM
from aerial_gym.math.draws import RandomArrays, draw_vec3, episode_stream, random_arrays
from aerial_gym.math.random import Purpose, Randomness, take_mask


@wp.kernel(enable_backward=False)
def _draw_goals(
    mask: wp.array[wp.bool],  # (E,)
    # params
    random: RandomArrays,
    ratio_low: wp.vec3,  # share of the bounds
    ratio_high: wp.vec3,
    bounds_min: wp.array[wp.vec3],  # (E,) world [m]
    bounds_max: wp.array[wp.vec3],  # (E,) world [m]
    # out
    goal_out: wp.array[wp.vec3],  # (E,) world [m]
):
    """Write a new goal where the mask says so; leave every other row alone."""
    env = wp.tid()
    if not mask[env]:
        return
    ratio = draw_vec3(episode_stream(random, env, wp.static(int(Purpose.GOAL))), 0, ratio_low, ratio_high)
    goal_out[env] = bounds_min[env] + wp.cw_mul(ratio, bounds_max[env] - bounds_min[env])


class Goals:
    """Draws the goals of masked environments, with all views made at construction."""

    def __init__(
        self, goal: Tensor, *, bounds: tuple[Tensor, Tensor], ratios: tuple[Vec3, Vec3], random: Randomness
    ) -> None:
        """Take the output and the inputs of the draws.

        Args:
            goal: Written where a mask says so [m], world, (E, 3).
            bounds: Lower and upper corner [m], world, each (E, 3); read at every draw.
            ratios: Lowest and highest goal as a share of the bounds.
        """
        envs, device = goal.shape[0], goal.device
        self._mask = random.mask
        self._command = ReusableLaunch(
            _draw_goals,
            dim=envs,
            inputs=[self._mask, random_arrays(random), *(wp.vec3(*ratio) for ratio in ratios), *bounds],
            outputs=[goal],
            device=device,
            block_dim=BLOCK_DIM,
        )

    def draw(self, mask: Tensor) -> None:
        """Draw for the environments in ``mask``, bool (E,); launched on torch's current stream, not waited for."""
        take_mask(self._mask, mask)
        self._command.launch(self._mask)
