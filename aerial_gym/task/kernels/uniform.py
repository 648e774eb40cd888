"""Numbers drawn at reset for a whole episode: delays, phases.

Letters: E environments, N numbers.
"""

from collections.abc import Sequence

import torch
import warp as wp
from torch import Tensor

from aerial_gym.math.draws import RandomArrays, episode_stream, random_arrays, substream
from aerial_gym.math.random import Purpose, Randomness
from aerial_gym.task.kernels.mask_launch import MaskLaunch


@wp.kernel(enable_backward=False)
def _draw_uniform(
    mask: wp.array[wp.bool],  # (E,)
    # params
    random: RandomArrays,
    purpose: int,
    low: wp.array[float],  # (N,)
    high: wp.array[float],  # (N,)
    whole: int,  # 1: whole numbers from low to high, both included
    # out
    drawn_out: wp.array2d[float],  # (E, N)
):
    """Write uniform draws where the mask says so; leave every other row alone."""
    env, i = wp.tid()
    if not mask[env]:
        return
    share = wp.randf(substream(episode_stream(random, env, purpose), i))
    value = low[i] + share * (high[i] - low[i])
    if whole == 1:
        value = wp.min(wp.floor(low[i] + share * (high[i] - low[i] + 1.0)), high[i])
    drawn_out[env, i] = value


class UniformDraws(MaskLaunch):
    """Draws numbers of masked environments."""

    def __init__(
        self,
        drawn: Tensor,
        ranges: Sequence[tuple[float, float]],
        *,
        purpose: Purpose,
        random: Randomness,
        whole: bool = False,
    ) -> None:
        """Take the tensor to write, (E, N), and the range of each number; ``whole`` ones include the highest."""
        low, high = (torch.tensor([each[i] for each in ranges], device=drawn.device).float() for i in (0, 1))
        inputs = [random_arrays(random), int(purpose), low, high, int(whole)]
        super().__init__(_draw_uniform, tuple(drawn.shape), inputs, [drawn], random)
