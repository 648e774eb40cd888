"""Draws of randomised quantities inside a kernel, for the environments of a mask.

Letters: E environments, K drawn numbers.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from math import inf, log
from zlib import crc32

import numpy as np
import warp as wp
from torch import Tensor

from aerial_gym.config.randomize import DISTRIBUTIONS, RandomizeCfg
from aerial_gym.interop import start_warp
from aerial_gym.interop.rows import Before
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


@wp.struct
class DrawnRows:
    """Everything that a draw reads and writes."""

    random: RandomArrays
    draws: wp.array[Draw]  # (K,)
    value: wp.array2d[float]  # (E, K), written


@wp.func
def draw_row(env: int, given: DrawnRows):
    """Write the numbers of one environment anew."""
    episode = stream_of(given.random, env, wp.static(int(Purpose.PARAMETERS)))
    for k in range(given.draws.shape[0]):
        draw = given.draws[k]
        state = substream(substream(episode, draw.stream), draw.element)
        share = draw.low + (draw.high - draw.low) * wp.randf(state)
        value = share
        if draw.kind == LOG_UNIFORM:
            value = wp.exp(share)
        if draw.kind == NORMAL:  # the inverse of the cumulative distribution
            value = draw.mean + draw.std * wp.sqrt(2.0) * wp.erfinv(wp.clamp(2.0 * share - 1.0, -0.9999999, 0.9999999))
        given.value[env, k] = wp.clamp(value, draw.least, draw.most)


def drawing(drawn: Sequence[Drawn], value: Tensor, random: Randomness) -> Before:
    """Return the draw of a row for a kernel; ``value`` (E, K) receives the numbers and must be kept alive."""
    start_warp()
    rows = np.zeros(value.shape[1], dtype=Draw.numpy_dtype())  # type: ignore[call-overload]
    for each in drawn:
        width = each.columns.stop - each.columns.start
        for i, numbers in enumerate(each.cfg.components(width)):
            _fill(rows[each.columns.start + i], each, i, *numbers)
    given = DrawnRows()
    given.random, given.value = random_arrays(random), wp.from_torch(value)
    given.draws = wp.array(rows, dtype=Draw, device=wp.device_from_torch(value.device))
    return Before(function=draw_row, given_type=DrawnRows, given=given)


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
