"""Goals drawn at reset.

Frames: world of each environment, z up. Letters: E environments.
"""

import warp as wp
from torch import Tensor

from aerial_gym.config.robot import Vec3
from aerial_gym.math.draws import RandomArrays, draw_vec3, episode_stream, random_arrays
from aerial_gym.math.random import Purpose, Randomness
from aerial_gym.task.kernels.mask_launch import MaskLaunch


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


class Goals(MaskLaunch):
    """Draws the goals of masked environments."""

    def __init__(
        self, goal: Tensor, *, bounds: tuple[Tensor, Tensor], ratios: tuple[Vec3, Vec3], random: Randomness
    ) -> None:
        """Take the goal (E, 3) to write, the lower and upper corner of the bounds [m], and the range of its share of them."""
        inputs = [random_arrays(random), *(wp.vec3(*ratio) for ratio in ratios), *bounds]
        super().__init__(_draw_goals, goal.shape[0], inputs, [goal], random)
