"""Noise of observations and commands.

Letters: E environments, N entries of an observation that have noise or drop out.
"""

from collections.abc import Mapping

import torch
import warp as wp
from torch import Tensor

from aerial_gym.interop import ReusableLaunch, start_warp
from aerial_gym.math.draws import RandomArrays, episode_stream, random_arrays, substream
from aerial_gym.math.random import Purpose, Randomness


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
        self,
        kinds: Mapping[int, tuple[float, float]],
        step: Tensor,
        random: Randomness,
        *,
        purpose: Purpose = Purpose.OBSERVATION,
    ) -> None:
        """Take standard deviation and dropout probability of each entry with either, by its number, and the step, int32 (E,).

        The purpose is that of draws for all but a last observation.
        """
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
