"""Draws of randomised quantities inside a kernel, for the environments of a mask.

Letters: E environments, K drawn numbers.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from math import inf, log
from zlib import crc32

import numpy as np
import torch
import warp as wp
from torch import Tensor

from aerial_gym.config.randomize import DISTRIBUTIONS, RandomizeCfg
from aerial_gym.interop import on_torch_stream, start_warp
from aerial_gym.math.draws import RandomArrays, random_arrays, stream_of, substream
from aerial_gym.math.random import Purpose, Randomness

UNIFORM, LOG_UNIFORM, NORMAL = (wp.constant(i) for i in range(len(DISTRIBUTIONS)))
"""Kinds of distribution, in the order of ``DISTRIBUTIONS``."""


@dataclass(frozen=True, kw_only=True)
class Drawn:
    """A quantity that is drawn, and where its numbers stand."""

    name: str
    """Of the quantity."""

    cfg: RandomizeCfg
    """How it is drawn."""

    shape: tuple[int, ...]
    """Of its draw in one environment."""

    columns: slice
    """Among the K numbers."""


@wp.struct
class Draw:
    """How one number is drawn."""

    kind: wp.int32
    stream: wp.int32  # tells quantities apart, by their names
    element: wp.int32
    low: wp.float32  # of the number; of its logarithm; of the normal probability
    high: wp.float32
    mean: wp.float32
    std: wp.float32
    least: wp.float32  # what round-off may not leave
    most: wp.float32


@wp.kernel(enable_backward=False)
def _draw(
    mask: wp.array[wp.bool],  # (E,)
    # params
    random: RandomArrays,
    draws: wp.array[Draw],  # (K,)
    # out
    value_out: wp.array2d[float],  # (E, K)
):
    """Write new numbers where the mask says so; leave every other row alone."""
    env = wp.tid()
    if not mask[env]:
        return
    episode = stream_of(random, env, wp.static(int(Purpose.PARAMETERS)))
    for k in range(draws.shape[0]):
        draw = draws[k]
        state = substream(substream(episode, draw.stream), draw.element)
        share = draw.low + (draw.high - draw.low) * wp.randf(state)
        value = share
        if draw.kind == LOG_UNIFORM:
            value = wp.exp(share)
        if draw.kind == NORMAL:  # the inverse of the cumulative distribution
            value = draw.mean + draw.std * wp.sqrt(2.0) * wp.erfinv(wp.clamp(2.0 * share - 1.0, -0.9999999, 0.9999999))
        value_out[env, k] = wp.clamp(value, draw.least, draw.most)


class ParameterDraws:
    """Draws the numbers of randomised quantities, with all views made at construction."""

    def __init__(self, drawn: Sequence[Drawn], value: Tensor, random: Randomness) -> None:
        """Take what is drawn, where it is written, (E, K), and the random numbers."""
        start_warp()
        envs, device = value.shape[0], value.device
        rows = np.zeros(value.shape[1], dtype=Draw.numpy_dtype())  # type: ignore[call-overload]
        for each in drawn:
            width = each.columns.stop - each.columns.start
            for i, numbers in enumerate(each.cfg.components(width)):
                _fill(rows[each.columns.start + i], each, i, *numbers)
        table = wp.array(rows, dtype=Draw, device=wp.device_from_torch(device))
        self._mask, self._kept_alive = torch.zeros(envs, dtype=torch.bool, device=device), (value, random, table)
        self._command = wp.launch(
            _draw,
            dim=envs,
            inputs=[wp.from_torch(self._mask), random_arrays(random), table],
            outputs=[wp.from_torch(value)],
            device=wp.device_from_torch(device),
            record_cmd=True,
        )

    def draw(self, mask: Tensor) -> None:
        """Draw for the environments in ``mask``, bool (E,); launched on torch's current stream, not waited for."""
        self._mask.copy_(mask)
        with on_torch_stream(self._mask):
            self._command.launch()


def _fill(row: np.void, drawn: Drawn, element: int, low: float, high: float, mean: float, std: float) -> None:
    row["kind"] = DISTRIBUTIONS.index(drawn.cfg.distribution)
    row["stream"], row["element"] = crc32(drawn.name.encode()) & 0x7FFFFFFF, element
    row["mean"], row["std"] = mean, std
    row["least"], row["most"] = max(low, -3e38), min(high, 3e38)
    if drawn.cfg.distribution == "normal":
        low, high = _normal_share(low, mean, std), _normal_share(high, mean, std)
    elif drawn.cfg.distribution == "log_uniform":
        low, high = log(low), log(high)
    row["low"], row["high"] = low, high


def _normal_share(limit: float, mean: float, std: float) -> float:
    """Return the probability of a normal number below a limit."""
    from statistics import NormalDist

    return float(limit > 0.0) if abs(limit) == inf else NormalDist(mean, std).cdf(limit)
