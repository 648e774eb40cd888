"""Random draws: from a generator that is passed in, or from a seed and counters alone, the same as in Warp's kernels."""

from math import pi
from typing import TypeVar

import torch
from torch import Tensor

Word = TypeVar("Word", int, Tensor)
"""32 bits in an int, or in each element of an int64 tensor."""


def uniform(low: Tensor, high: Tensor, shape: tuple[int, ...], *, generator: torch.Generator) -> Tensor:
    """Return uniform draws between ``low`` and ``high``, which broadcast to ``shape``; same dtype and device."""
    draw = torch.rand(shape, dtype=low.dtype, device=low.device, generator=generator)
    return low + (high - low) * draw


def _scramble(state: Word) -> Word:
    """Return the next state of a generator of 32 bits, an int or int64: PCG as in Warp.

    Source: Jarzynski, Olano (2020), Hash functions for GPU rendering, JCGT 9(3).
    """
    word = (state * 747796405 + 2891336453) & 0xFFFFFFFF
    word = (((word >> ((word >> 28) + 4)) ^ word) * 277803737) & 0xFFFFFFFF
    return (word >> 22) ^ word


def counted_state(state: Tensor, count: Tensor | int) -> Tensor:
    """Return the random state that belongs to a count, int64: ``wp.rand_init(int(state), count)``."""
    if isinstance(count, Tensor):
        return _scramble((state.long() + _scramble(count.long() & 0xFFFFFFFF)) & 0xFFFFFFFF)
    return _scramble((state.long() + _scramble(count & 0xFFFFFFFF)) & 0xFFFFFFFF)


def counted_normal(state: Tensor, index: int, width: int, *, dtype: torch.dtype) -> Tensor:
    """Return normal draws (..., width); ``index`` tells the quantities of one random state apart.

    The same as ``wp.randn(stream)``, one after the other, with ``stream = wp.rand_init(int(state), index)``, but for round-off.
    """
    stream, draws = counted_state(state, index), []
    for _ in range(width):
        stream = _scramble(stream)
        radius = torch.sqrt(-2.0 * torch.log((stream >> 8).to(dtype) / 2**24 + 5.96e-8))
        stream = _scramble(stream)
        draws.append(radius * torch.cos(2.0 * pi * ((stream >> 8).to(dtype) / 2**24)))
    return torch.stack(draws, dim=-1)
