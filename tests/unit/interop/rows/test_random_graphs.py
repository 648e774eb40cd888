"""Traced functions against torch on random expression graphs: values in both float types, poisoned outputs, gradients."""

from collections.abc import Callable, Sequence

import numpy as np
import pytest
import torch
import warp as wp
from torch import Tensor

from aerial_gym.interop.rows import DifferentiableRows, RowFunction
from aerial_gym.interop.warp_start import start_warp
from aerial_gym.physics.fused.torch_trace import trace_to_warp
from tests.repetitions import frequent_values
from tests.unit.interop.rows.random_graphs import SHAPES, random_function

ROWS, GRAPHS = 96, 25
"""Rows of each graph, and graphs of one kernel."""

MATRIX = wp.types.matrix(shape=(3, 3), dtype=wp.float32)


def draw_inputs(seed: int, dtype: torch.dtype) -> list[Tensor]:
    generator = torch.Generator().manual_seed(seed)
    rows = [4.0 * torch.rand(ROWS, *shape, generator=generator, dtype=torch.float32) - 2.0 for shape in SHAPES]
    return [each.to(dtype) for each in rows]


def random_graphs(seed: int, count: int, *, smooth: bool = False) -> list[Callable[..., Tensor]]:
    rng = np.random.default_rng(seed)
    return [random_function(rng, smooth=smooth) for _ in range(count)]


def evaluate_all(functions: Sequence[Callable[..., Tensor]], inputs: Sequence[Tensor]) -> Tensor:
    """Return the results of graphs side by side, (E, 3 G)."""
    return torch.cat([function(*inputs) for function in functions], dim=1)


def error_bound_of_rounding(
    functions: Sequence[Callable[..., Tensor]], inputs: Sequence[Tensor], exact: Tensor
) -> Tensor:
    """Return the allowed error of float32: eight times the largest error of torch over the rows of a result, and 1e-5."""
    single = evaluate_all(functions, [each.float() for each in inputs]).double()
    return 8.0 * (single - exact).abs().amax(0) + 1e-5


BATCHES = frequent_values(list(range(400)), [0])


@pytest.mark.parametrize("seed", BATCHES)
def test_row_kernels_equal_torch(seed: int) -> None:
    functions = random_graphs(seed, GRAPHS)
    exact = evaluate_all(functions, draw_inputs(seed, torch.float64))
    for dtype in (torch.float32, torch.float64):
        inputs = draw_inputs(seed, dtype)
        kernel = RowFunction(lambda *rows: tuple(f(*rows) for f in functions), inputs)
        out = [torch.full((ROWS, 3), float("nan"), dtype=dtype) for _ in functions]
        actual = torch.cat(kernel(*inputs, out=out), dim=1).double()
        bound = error_bound_of_rounding(functions, inputs, exact) if dtype == torch.float32 else torch.tensor(1e-11)
        assert bool(((actual - exact).abs() <= bound).all())


@pytest.mark.parametrize("seed", BATCHES)
def test_warp_functions_equal_torch(seed: int) -> None:
    start_warp()
    functions, inputs = random_graphs(1000 + seed, GRAPHS), draw_inputs(seed, torch.float32)
    width = wp.types.vector(length=3 * GRAPHS, dtype=wp.float32)
    traced = trace_to_warp(
        "graphs", {"number": float, "vector": wp.vec3, "matrix": MATRIX},
        lambda number, vector, matrix: evaluate_all(functions, (number, vector, matrix)), (width,),
    )  # fmt: skip

    @wp.kernel(module="unique", enable_backward=False)
    def kernel(
        number: wp.array[float], vector: wp.array[wp.vec3], matrix: wp.array[MATRIX], out: wp.array[width]
    ):  # fmt: skip
        i = wp.tid()
        out[i] = traced(number[i], vector[i], matrix[i])

    out = torch.full((ROWS, 3 * GRAPHS), float("nan"))
    kinds = (wp.float32, wp.vec3, MATRIX, width)
    arrays = [wp.from_torch(rows, dtype=kind) for rows, kind in zip((*inputs, out), kinds, strict=True)]
    wp.launch(kernel, dim=ROWS, inputs=arrays, device="cpu")
    exact = evaluate_all(functions, [each.double() for each in inputs])
    assert bool(((out.double() - exact).abs() <= error_bound_of_rounding(functions, inputs, exact)).all())


@pytest.mark.parametrize("seed", BATCHES)
def test_gradients_equal_central_differences(seed: int) -> None:
    functions, step = random_graphs(2000 + seed, 10, smooth=True), 1e-6
    inputs = [each.requires_grad_() for each in draw_inputs(seed, torch.float64)]
    rows = DifferentiableRows(lambda *given: tuple(f(*given).sum(-1) for f in functions), inputs)
    gradients = torch.autograd.grad(sum(result.sum() for result in rows(*inputs)), inputs)
    generator = torch.Generator().manual_seed(seed)
    with torch.no_grad():
        ways = [torch.randn(each.shape, generator=generator, dtype=each.dtype) for each in inputs]
        ahead, behind = (
            evaluate_all(functions, [each + sign * step * way for each, way in zip(inputs, ways, strict=True)]).sum(-1)
            for sign in (1.0, -1.0)
        )
        expected = (ahead - behind) / (2.0 * step)
        actual = sum((g * way).reshape(ROWS, -1).sum(-1) for g, way in zip(gradients, ways, strict=True))
    torch.testing.assert_close(actual, expected, rtol=1e-5, atol=1e-5)
