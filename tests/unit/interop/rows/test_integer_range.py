"""Integers of a trace that unsigned arithmetic in 32 bits computes like int64."""

from collections.abc import Callable

import pytest
import torch
from torch import Tensor

from aerial_gym.interop.rows.row_trace import trace
from aerial_gym.interop.rows.source import dependencies
from aerial_gym.interop.rows.warp_function import fits_32_bits
from aerial_gym.math.random import uniform_draws

CASES: dict[str, tuple[Callable[[Tensor, Tensor], Tensor], bool]] = {
    "draws": (lambda state, _: uniform_draws(state, 1, 2, dtype=torch.float32), True),
    "low bits of a sum": (lambda state, _: ((state + 5) & 0xFFFF).float(), True),
    "comparison of a sum": (lambda state, _: (state + 5 > 9).float(), False),
    "sum of few bits": (lambda state, _: ((state >> 8) * 255 > 9).float(), True),
    "shift of a sum": (lambda state, _: ((state + 5) >> 3).float(), False),
    "low bits of a negative count": (lambda state, count: ((state ^ count.long()) & 0xFFFF).float(), True),
    "size of a count": (lambda _, count: count.long().float(), False),
}


@pytest.mark.parametrize("case", CASES)
def test_range_of_integers(case: str) -> None:
    function, expected = CASES[case]
    inputs = [torch.zeros(2, dtype=dtype) for dtype in (torch.int64, torch.int32)]
    traced = trace(function, inputs, constants={})
    needed = dependencies(traced, [n for numbers, _, _ in traced.outputs for n in numbers])
    assert fits_32_bits(traced, needed) is expected
