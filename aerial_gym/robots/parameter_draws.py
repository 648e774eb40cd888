"""Random draws of quantities inside a kernel, for the environments of a mask.

Letters: E environments, K drawn numbers.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from math import inf, log
from zlib import crc32

import numpy as np
import torch
import warp as wp

from aerial_gym.config.randomize import Randomize, RandomizeCfg
from aerial_gym.errors import ConfigError
from aerial_gym.interop import start_warp
from aerial_gym.interop.rows import KernelInput
from aerial_gym.math.draws import RandomArrays, episode_stream, random_arrays, substream
from aerial_gym.math.random import Purpose, Randomness

ROUND_OFF = 1e-6
"""Share of independence in a joint distribution: of two numbers of which the sum alone is known, the matrix is singular, and
below zero by round-off. It widens exact correlations by a thousandth of the standard deviation."""


def correlation_factor(cfg: Randomize) -> tuple[tuple[str, ...], np.ndarray]:
    """Return the names of correlated quantities and the lower Cholesky factor of their correlations, (N, N).

    Raise ``ConfigError`` if one is not drawn, or is no normal single number, or if the correlations contradict each other.
    """
    stated = {(name, other): value for name, each in cfg.items() for other, value in each.correlation.items()}
    for name, other in stated:
        label = f"randomize: {name}: correlation with {other!r}"
        if other not in cfg:
            raise ConfigError(f"{label}, which is not drawn. Draw it, or drop the correlation")
        if name == other or (other, name) in stated:
            raise ConfigError(f"{label}: give each pair of two quantities once")
        for one in (name, other):
            if cfg[one].distribution != "normal" or cfg[one].each_rotor or cfg[one].component_counts() != {1}:
                raise ConfigError(f"{label}: {one} must be a normal distribution of one number")
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
class RandomQuantity:
    """A randomised quantity and its columns among the K numbers."""

    name: str  # Of the quantity
    cfg: RandomizeCfg  # Its distribution
    shape: tuple[int, ...]  # Of its draw in one environment
    columns: slice  # Among the K numbers


@wp.struct
class DrawLimits:
    """Distribution parameters and limits of one number."""

    low: wp.float32  # of the number; of its logarithm; of the normal probability
    high: wp.float32
    mean: wp.float32
    std: wp.float32
    least: wp.float32  # limits that rounding must not exceed
    most: wp.float32


@wp.struct
class DrawArrays:
    """Inputs of the draws of an environment."""

    random: RandomArrays
    draws: wp.array[DrawLimits]  # (K,)
    factor: wp.array2d[float]  # (K, K), lower Cholesky factor of the correlations of joint numbers


@wp.func
def uniform_value(draw: DrawLimits, state: wp.uint32) -> float:
    """Return a uniform draw between ``low`` and ``high``."""
    return draw.low + (draw.high - draw.low) * wp.randf(state)


@wp.func
def normal_quantile(share: float) -> float:
    """Return the inverse of the cumulative normal distribution."""
    return wp.sqrt(2.0) * wp.erfinv(wp.clamp(2.0 * share - 1.0, -0.9999999, 0.9999999))


@wp.func
def independent_normal(state: wp.uint32) -> float:
    """Return a normal draw of mean 0 and standard deviation 1."""
    return normal_quantile(wp.randf(state))


@wp.func
def uniform(draw: DrawLimits, state: wp.uint32) -> float:
    """Return a draw of a uniform distribution."""
    return wp.clamp(uniform_value(draw, state), draw.least, draw.most)


@wp.func
def log_uniform(draw: DrawLimits, state: wp.uint32) -> float:
    """Return a draw whose logarithm is uniform."""
    return wp.clamp(wp.exp(uniform_value(draw, state)), draw.least, draw.most)


@wp.func
def normal(draw: DrawLimits, state: wp.uint32) -> float:
    """Return a draw of a truncated normal distribution."""
    return wp.clamp(draw.mean + draw.std * normal_quantile(uniform_value(draw, state)), draw.least, draw.most)


@wp.func
def integer(draw: DrawLimits, state: wp.uint32) -> float:
    """Return a draw of whole numbers; ``high`` is one beyond the last."""
    return wp.clamp(wp.floor(uniform_value(draw, state)), draw.least, draw.most)


@wp.func
def joint(draw: DrawLimits, weighted: float) -> float:
    """Return a number of a joint normal distribution; ``weighted`` is its row of the factor times independent normal draws."""
    return wp.clamp(draw.mean + draw.std * weighted, draw.least, draw.most)


_CALLED = (episode_stream, substream, independent_normal, uniform, log_uniform, normal, integer, joint)


def draw_code(drawn: Sequence[RandomQuantity], random: Randomness, *, device: torch.device) -> KernelInput:
    """Return the kernel code of the draws of one environment, all independent."""
    start_warp()
    rows = np.zeros(drawn[-1].columns.stop, dtype=DrawLimits.numpy_dtype())  # type: ignore[call-overload]
    for each in drawn:
        width = each.columns.stop - each.columns.start
        for i, numbers in enumerate(each.cfg.component_distributions(width)):
            _fill_limits(rows[each.columns.start + i], each.cfg.distribution, *numbers)
    first = {each.name: each.columns.start for each in drawn}
    together, small = correlation_factor({each.name: each.cfg for each in drawn})
    columns, factor = [first[name] for name in together], np.zeros((len(rows), len(rows)), dtype=np.float32)
    factor[np.ix_(columns, columns)] = small
    given, target = DrawArrays(), wp.device_from_torch(device)
    given.random = random_arrays(random)
    given.draws, given.factor = wp.array(rows, dtype=DrawLimits, device=target), wp.array(factor, device=target)
    names = {function.key: function for function in _CALLED}
    return KernelInput(lines=tuple(_kernel_lines(drawn, columns)), names=names, given_type=DrawArrays, given=given)


def _kernel_lines(drawn: Sequence[RandomQuantity], joint_columns: Sequence[int]) -> Iterator[str]:
    """Yield the kernel lines that draw each number; ``joint_columns`` are the columns of the joint distribution."""
    yield f"episode = episode_stream(given.random, row, {int(Purpose.PARAMETERS)})"
    for i, each in enumerate(drawn):
        yield f"quantity_{i} = substream(episode, {crc32(each.name.encode()) & 0x7FFFFFFF})"
        for element, k in enumerate(range(each.columns.start, each.columns.stop)):
            state = f"substream(quantity_{i}, {element})"
            if k in joint_columns:
                yield f"normal_{k} = independent_normal({state})"
            else:
                yield f"made_{k} = {each.cfg.distribution}(given.draws[{k}], {state})"
    for i, k in enumerate(joint_columns):
        weighted = " + ".join(f"given.factor[{k}, {j}] * normal_{j}" for j in joint_columns[: i + 1])
        yield f"made_{k} = joint(given.draws[{k}], {weighted})"


def _fill_limits(row: np.void, distribution: str, low: float, high: float, mean: float, std: float) -> None:
    row["mean"], row["std"] = mean, std
    row["least"], row["most"] = max(low, -3e38), min(high, 3e38)
    if distribution == "normal":
        low, high = _normal_probability(low, mean, std), _normal_probability(high, mean, std)
    elif distribution == "log_uniform":
        low, high = log(low), log(high)
    elif distribution == "integer":
        high += 1.0
    row["low"], row["high"] = low, high


def _normal_probability(limit: float, mean: float, std: float) -> float:
    """Return the probability of a normal number below a limit."""
    from statistics import NormalDist

    return float(limit > 0.0) if abs(limit) == inf else NormalDist(mean, std).cdf(limit)
