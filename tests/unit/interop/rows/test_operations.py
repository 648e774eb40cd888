"""Each operation of row kernels and of traced functions against NumPy or SciPy, which share no table with them.
Integers of a trace that unsigned arithmetic in 32 bits computes like int64.
"""

import re
from collections.abc import Callable

import numpy as np
import pytest
import torch
import warp as wp
from scipy.special import expit
from torch import Tensor

from aerial_gym.interop.rows import RowFunction
from aerial_gym.interop.rows.row_trace import trace
from aerial_gym.interop.rows.source import dependencies
from aerial_gym.interop.rows.warp_function import body_lines, fits_32_bits
from aerial_gym.interop.warp_start import start_warp
from aerial_gym.math.random import uniform_draws
from aerial_gym.physics.fused.torch_trace import trace_to_warp

ROWS = 64
SAME = "neg negative|abs|exp|sin|cos|tan|atan arctan|sinh|cosh|tanh|floor|ceil|round|sign|square|expm1|nan_to_num"
"""Functions of one argument, by their names in torch and NumPy."""

Pair = tuple[Callable[..., Tensor], Callable[..., np.ndarray]]

ONE: dict[str, Pair] = {
    **{
        names.split()[0]: (getattr(torch, names.split()[0]), getattr(np, names.split()[-1]))
        for names in SAME.split("|")
    },
    "sqrt": (lambda a: (a * a).sqrt(), np.abs),
    "rsqrt": (lambda a: (a * a + 1.0).rsqrt(), lambda a: (a * a + 1.0) ** -0.5),
    "reciprocal": (lambda a: (a * a + 1.0).reciprocal(), lambda a: 1.0 / (a * a + 1.0)),
    "log": (lambda a: (a.abs() + 0.1).log(), lambda a: np.log(np.abs(a) + 0.1)),
    "asin": (lambda a: (0.45 * a).asin(), lambda a: np.arcsin(0.45 * a)),
    "acos": (lambda a: (0.45 * a).acos(), lambda a: np.arccos(0.45 * a)),
    "sigmoid": (torch.sigmoid, expit),
    "relu": (torch.relu, lambda a: np.maximum(a, 0.0)),
    "clamp": (lambda a: a.clamp(-0.7, 0.9), lambda a: np.clip(a, -0.7, 0.9)),
    "clamp_min": (lambda a: a.clamp_min(-0.3), lambda a: np.maximum(a, -0.3)),
    "clamp_max": (lambda a: a.clamp_max(0.4), lambda a: np.minimum(a, 0.4)),
    "rsub": (lambda a: 1.0 - a, lambda a: np.subtract(1.0, a)),
    "cube": (lambda a: a**3, lambda a: np.power(a, 3)),
    "first power": (lambda a: a**1, np.array),
    "root": (lambda a: a.abs() ** 0.5, lambda a: np.sqrt(np.abs(a))),
    "power": (lambda a: a.abs() ** 1.7, lambda a: np.power(np.abs(a), 1.7)),
    "sum": (lambda a: a.sum(-1), lambda a: a.sum(-1)),
    "mean": (lambda a: a.mean(-1), lambda a: a.mean(-1)),
    "prod": (lambda a: a.prod(-1), lambda a: a.prod(-1)),
    "amin": (lambda a: a.amin(-1), lambda a: a.min(-1)),
    "amax": (lambda a: a.amax(-1), lambda a: a.max(-1)),
    "norm": (lambda a: a.norm(dim=-1), lambda a: np.linalg.norm(a, axis=-1)),
    "norm of order 1": (lambda a: torch.linalg.vector_norm(a, 1, dim=-1), lambda a: np.linalg.norm(a, 1, axis=-1)),
    "norm of order inf": (
        lambda a: torch.linalg.vector_norm(a, torch.inf, dim=-1),
        lambda a: np.linalg.norm(a, np.inf, axis=-1),
    ),
    "any": (lambda a: (a > 1.0).any(-1).to(a.dtype), lambda a: (a > 1.0).any(-1)),
    "all": (lambda a: (a > -1.0).all(-1).to(a.dtype), lambda a: (a > -1.0).all(-1)),
    "cumprod": (lambda a: a.cumprod(-1), lambda a: np.cumprod(a, -1)),
    "diag_embed": (lambda a: torch.diag_embed(a).flatten(1), lambda a: np.stack([np.diag(row).ravel() for row in a])),
    "flip and roll": (lambda a: a.flip(-1).roll(1, -1), lambda a: np.roll(a[:, ::-1], 1, axis=1)),
}
"""The same function in torch and in NumPy, of rows (E, 3)."""

TWO: dict[str, Pair] = {
    "add": (torch.add, np.add),
    "alpha": (lambda a, b: torch.sub(a, b, alpha=0.5), lambda a, b: a - b / 2.0),
    "mul": (torch.mul, np.multiply),
    "div": (torch.div, np.divide),
    "minimum": (torch.minimum, np.minimum),
    "maximum": (torch.maximum, np.maximum),
    "atan2": (torch.atan2, np.arctan2),
    "remainder": (torch.remainder, np.mod),
    "cross": (lambda a, b: torch.linalg.cross(a, b, dim=-1), np.cross),
    "product": (
        lambda a, b: torch.bmm(a.unsqueeze(2) * b.unsqueeze(1), b.unsqueeze(2)).squeeze(2),
        lambda a, b: a * (b * b).sum(1, keepdims=True),
    ),
    "where": (lambda a, b: torch.where((a < b) | (a > 1.0), a, b), lambda a, b: np.where((a < b) | (a > 1.0), a, b)),
    "truths": (
        lambda a, b: (((a <= b) & ~(b >= 0.5)) ^ (a != a)).to(a.dtype),
        lambda a, b: np.logical_and(a <= b, b < 0.5),
    ),
}
"""The same of two rows."""


def draw_rows() -> tuple[Tensor, Tensor, np.ndarray]:
    """Return two inputs in float32, and the expected results of all functions side by side."""
    rng = np.random.default_rng(0)
    a, b = (rng.uniform(-2.0, 2.0, (ROWS, 3)).astype(np.float32) for _ in range(2))
    exact = [function(a.astype(np.float64)) for _, function in ONE.values()]
    exact += [function(a.astype(np.float64), b.astype(np.float64)) for _, function in TWO.values()]
    return torch.from_numpy(a), torch.from_numpy(b), np.concatenate([rows.reshape(ROWS, -1) for rows in exact], axis=1)


def all_results(a: Tensor, b: Tensor) -> Tensor:
    rows = [function(a) for function, _ in ONE.values()] + [function(a, b) for function, _ in TWO.values()]
    return torch.cat([row.reshape(len(a), -1) for row in rows], dim=1)


@pytest.mark.parametrize(("dtype", "error"), [(torch.float32, 2e-5), (torch.float64, 1e-12)])
def test_operations_of_row_kernels_are_numpys(dtype: torch.dtype, error: float) -> None:
    a, b, expected = draw_rows()
    out = [torch.full(expected.shape, torch.nan, dtype=dtype)]
    actual = RowFunction(all_results, [a.to(dtype), b.to(dtype)])(a.to(dtype), b.to(dtype), out=out)
    actual = actual if isinstance(actual, Tensor) else actual[0]
    np.testing.assert_allclose(actual.double().numpy(), expected, rtol=error, atol=error)


def test_operations_of_traced_functions_are_numpys() -> None:
    start_warp()
    a, b, expected = draw_rows()
    width = wp.types.vector(length=expected.shape[1], dtype=wp.float32)
    traced = trace_to_warp("operations", {"a": wp.vec3, "b": wp.vec3}, all_results, (width,), constants={})

    @wp.kernel(module="unique", enable_backward=False)
    def kernel(a: wp.array[wp.vec3], b: wp.array[wp.vec3], out: wp.array[width]):
        i = wp.tid()
        out[i] = traced(a[i], b[i])

    out = torch.full(expected.shape, torch.nan)
    arrays = [wp.from_torch(rows, dtype=kind) for rows, kind in ((a, wp.vec3), (b, wp.vec3), (out, width))]
    wp.launch(kernel, dim=ROWS, inputs=arrays, device="cpu")
    np.testing.assert_allclose(out.double().numpy(), expected, rtol=2e-5, atol=2e-5)


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
    constants = re.findall(r"wp\.uint32\((-?\d+)", "\n".join(body_lines(traced, needed, lambda k, _: f"input_{k}")))
    assert all(-(2**31) <= int(value) < 2**31 for value in constants)
