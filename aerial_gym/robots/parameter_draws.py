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

from aerial_gym.config.randomize import DISTRIBUTIONS, Randomize, RandomizeCfg
from aerial_gym.errors import ConfigError
from aerial_gym.interop import start_warp
from aerial_gym.interop.rows import Before
from aerial_gym.math.draws import RandomArrays, random_arrays, stream_of, substream
from aerial_gym.math.random import Purpose, Randomness

UNIFORM, LOG_UNIFORM, NORMAL = (wp.constant(i) for i in range(len(DISTRIBUTIONS)))
"""Kinds of distribution, in the order of ``DISTRIBUTIONS``."""

JOINT = wp.constant(len(DISTRIBUTIONS))
"""A number of a joint normal distribution."""

ROUND_OFF = 1e-6
"""Share of independence in a joint distribution: of two numbers of which the sum alone is known, the matrix is singular, and
below zero by round-off. It widens what is known exactly by a thousandth of the standard deviation."""


def joint_factor(cfg: Randomize) -> tuple[tuple[str, ...], np.ndarray]:
    """Return which quantities are drawn together, and the lower Cholesky factor of their correlations, (N, N).

    Raises:
        ConfigError: If one of them is not drawn, not a normal single number, or if the correlations contradict each other.
    """
    stated = {(name, other): value for name, each in cfg.items() for other, value in each.correlation.items()}
    for name, other in stated:
        what = f"randomize: {name}: correlation with {other!r}"
        if other not in cfg:
            raise ConfigError(f"{what}, which is not drawn. Draw it, or drop the correlation")
        if name == other or (other, name) in stated:
            raise ConfigError(f"{what}: give each pair of two quantities once")
        for one in (name, other):
            if cfg[one].distribution != "normal" or cfg[one].each_rotor or cfg[one].widths() != {1}:
                raise ConfigError(f"{what}: {one} must be a normal distribution of one number")
    joint = tuple(name for name in cfg if any(name in pair for pair in stated))
    matrix = np.eye(len(joint))
    for (name, other), value in stated.items():
        i, j = joint.index(name), joint.index(other)
        matrix[i, j] = matrix[j, i] = value
    try:
        return joint, np.linalg.cholesky((1.0 - ROUND_OFF) * matrix + ROUND_OFF * np.eye(len(joint)))
    except np.linalg.LinAlgError:
        raise ConfigError(
            f"randomize: the correlations of {', '.join(joint)} contradict each other: their matrix is not positive definite"
        ) from None


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
    factor: wp.array2d[float]  # (K, K), lower Cholesky factor of the correlations of joint numbers
    value: wp.array2d[float]  # (E, K), written


@wp.func
def standard_normal(share: float) -> float:
    """Return the inverse of the cumulative normal distribution."""
    return wp.sqrt(2.0) * wp.erfinv(wp.clamp(2.0 * share - 1.0, -0.9999999, 0.9999999))


@wp.func
def joint_normal(k: int, episode: wp.uint32, given: DrawnRows) -> float:
    """Return number k of the joint distribution without its mean and deviation: row k of the factor times normal numbers."""
    total = wp.float32(0.0)
    for j in range(k + 1):
        weight = given.factor[k, j]
        if weight != 0.0:
            draw = given.draws[j]
            total += weight * standard_normal(wp.randf(substream(substream(episode, draw.stream), draw.element)))
    return total


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
        if draw.kind == NORMAL:
            value = draw.mean + draw.std * standard_normal(share)
        if draw.kind == JOINT:
            value = draw.mean + draw.std * joint_normal(k, episode, given)
        given.value[env, k] = wp.clamp(value, draw.least, draw.most)


def drawing(drawn: Sequence[Drawn], value: Tensor, random: Randomness) -> Before:
    """Return the draw of a row for a kernel; ``value`` (E, K) receives the numbers and must be kept alive."""
    start_warp()
    rows = np.zeros(value.shape[1], dtype=Draw.numpy_dtype())  # type: ignore[call-overload]
    for each in drawn:
        width = each.columns.stop - each.columns.start
        for i, numbers in enumerate(each.cfg.components(width)):
            _fill(rows[each.columns.start + i], each, i, *numbers)
    device = wp.device_from_torch(value.device)
    first = {each.name: each.columns.start for each in drawn}
    joint, small = joint_factor({each.name: each.cfg for each in drawn})
    columns, factor = [first[name] for name in joint], np.zeros((len(rows), len(rows)), dtype=np.float32)
    factor[np.ix_(columns, columns)] = small
    rows["kind"][columns] = JOINT
    given = DrawnRows()
    given.random, given.value = random_arrays(random), wp.from_torch(value)
    given.draws, given.factor = wp.array(rows, dtype=Draw, device=device), wp.array(factor, device=device)
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
