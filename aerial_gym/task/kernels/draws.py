"""Random numbers of a task: goals and numbers of a whole episode at reset, and noise in every step.

Frames: world of each environment, z up. Letters: E environments, N numbers, or entries with noise or dropout.
"""

from collections.abc import Mapping, Sequence

import torch
import warp as wp
from torch import Tensor

from aerial_gym.config.checks import Vec3
from aerial_gym.interop import ReusableLaunch, start_warp
from aerial_gym.math.draws import RandomArrays, draw_vec3, episode_stream, random_arrays, substream
from aerial_gym.math.random import Purpose, Randomness, copy_mask


class MaskLaunch:
    """A kernel over environments whose first input is the mask; all views are made at construction."""

    def __init__(
        self, kernel: wp.Kernel, dim: int | tuple[int, ...], inputs: list[object], outputs: list[object],
        random: Randomness,
    ) -> None:  # fmt: skip
        start_warp()
        self._mask = random.mask
        inputs = [self._mask, *inputs]
        self._launch = ReusableLaunch(kernel, dim=dim, inputs=inputs, outputs=outputs, device=self._mask.device)

    def draw(self, mask: Tensor) -> None:
        """Draw for the environments in ``mask``, bool (E,); launched on torch's current stream, not waited for."""
        copy_mask(self._mask, mask)
        self._launch.launch(self._mask)


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


class GoalDraws(MaskLaunch):
    """Draws the goals of masked environments."""

    def __init__(
        self, goal: Tensor, *, bounds: tuple[Tensor, Tensor], ratios: tuple[Vec3, Vec3], random: Randomness,
        draws: Randomness | None = None,
    ) -> None:  # fmt: skip
        """Take the goal (E, 3) to write, the lower and upper corner of the bounds [m], and the range of its share of them.
        ``random`` has the mask, ``draws`` the numbers if others are drawn."""
        inputs = [random_arrays(draws or random), *(wp.vec3(*ratio) for ratio in ratios), *bounds]
        super().__init__(_draw_goals, goal.shape[0], inputs, [goal], random)


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
        self, drawn: Tensor, ranges: Sequence[tuple[float, float]], *, purpose: Purpose, random: Randomness,
        whole: bool = False,
    ) -> None:  # fmt: skip
        """Take the tensor to write, (E, N), and the range of each number; ``whole`` ones include the highest."""
        low, high = (torch.tensor([each[i] for each in ranges], device=drawn.device).float() for i in (0, 1))
        inputs = [random_arrays(random), int(purpose), low, high, int(whole)]
        super().__init__(_draw_uniform, tuple(drawn.shape), inputs, [drawn], random)


@wp.kernel(enable_backward=False)
def _draw_noise(
    # params
    random: RandomArrays,
    purpose: int,
    step: wp.array[wp.int32],  # (E,) of the episode
    std: wp.array[float],  # (N,)
    dropout: wp.array[float],  # (N,) probability
    entry: wp.array[wp.int32],  # (N,) which of the observation each is
    # out
    noise_out: wp.array2d[float],  # (E, N)
):
    """Write normal draws of every environment at its present step, infinity where an entry is dropped."""
    env, i = wp.tid()
    state = substream(substream(episode_stream(random, env, purpose), step[env]), entry[i])
    noise = std[i] * wp.randn(state)
    noise_out[env, i] = wp.where(wp.randf(state) < dropout[i], wp.inf, noise)


class WhiteNoise:
    """Draws normal noise, and which are dropped, for the entries that ask for it; all views made at once."""

    def __init__(
        self, kinds: Mapping[int, tuple[float, float]], step: Tensor, random: Randomness, *,
        purpose: Purpose = Purpose.OBSERVATION,
    ) -> None:  # fmt: skip
        """Take standard deviation and dropout probability of each entry with either, by its number, and the step, int32 (E,).
        The purpose is that of draws for all but a last observation."""
        start_warp()
        self._purpose = purpose
        device = step.device
        self.noise = torch.zeros(random.num_envs, len(kinds), device=device)
        """Last draws, (E, N), in the order of the given entries; infinity for a dropped one."""
        stds, dropouts = (
            torch.tensor([kind[i] for kind in kinds.values()], device=device, dtype=torch.float32) for i in (0, 1)
        )
        entries = torch.tensor(list(kinds), device=device, dtype=torch.int32)
        given = [random_arrays(random), int(purpose)]
        given += [step, stds, dropouts, entries] if kinds else []
        self._command = None
        if kinds:
            self._command = ReusableLaunch(
                _draw_noise, dim=tuple(self.noise.shape), inputs=given, outputs=[self.noise], device=device
            )

    def draw(self, *, final: bool = False) -> None:
        """Draw the noise of the present step of the present episodes; the last observation of an episode has separate noise."""
        if self._command is not None:
            self._command.set_param_at_index(1, int(Purpose.FINAL_OBSERVATION if final else self._purpose))
            self._command.launch(self.noise)
