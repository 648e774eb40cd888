"""Noise of what a policy observes.

Letters: E environments, O entries of an observation.
"""

import torch
import warp as wp
from torch import Tensor

from aerial_gym.interop import RecordedLaunch, on_torch_stream, start_warp
from aerial_gym.math.draws import RandomArrays, random_arrays, stream_of, substream
from aerial_gym.math.random import Purpose, Randomness


@wp.kernel(enable_backward=False)
def _draw_noise(
    # params
    random: RandomArrays,
    purpose: int,
    step: wp.array[wp.int32],  # (E,) of the episode
    std: wp.array[float],  # (O,)
    # out
    noise_out: wp.array2d[float],  # (E, O)
):
    """Write normal draws of every environment at its present step."""
    env, i = wp.tid()
    state = substream(substream(stream_of(random, env, purpose), step[env]), i)
    noise_out[env, i] = std[i] * wp.randn(state)


class ObservationNoise:
    """Adds normal noise to observations, with all views made at construction; nothing where no term has any."""

    def __init__(self, std: Tensor, step: Tensor, random: Randomness) -> None:
        """Take what the draws depend on.

        Args:
            std: Standard deviation of each entry, (O,).
            step: Step of the episode, int32, (E,); read at every draw.
            random: Of the draws.
        """
        start_warp()
        self._noise = torch.zeros(random.num_envs, std.shape[0], device=std.device)
        self._any, self._kept_alive = bool(std.any()), (std, step, random)
        given = [random_arrays(random), int(Purpose.OBSERVATION), wp.from_torch(step), wp.from_torch(std)]
        self._command = RecordedLaunch(
            _draw_noise,
            dim=tuple(self._noise.shape),
            inputs=given,
            outputs=[wp.from_torch(self._noise)],
            device=wp.device_from_torch(std.device),
        )

    def draw(self, *, final: bool = False) -> None:
        """Draw the noise of the present step of the present episodes; the last observation of one has noise of its own."""
        if self._any:
            self._command.set_param_at_index(1, int(Purpose.FINAL_OBSERVATION if final else Purpose.OBSERVATION))
            with on_torch_stream(self._noise):
                self._command.launch()

    def add(self, observation: Tensor) -> Tensor:
        """Return an observation (E, O) with the noise that was drawn last."""
        return observation + self._noise if self._any else observation
