"""Warp functions traced from torch functions of one environment."""

from functools import partial
from math import nan
from types import SimpleNamespace

import pytest
import torch
import warp as wp
from torch import Tensor

from aerial_gym.errors import CapabilityError
from aerial_gym.interop.streams import start_warp
from aerial_gym.math.random import uniform_draws
from aerial_gym.math.rows import by_element, choose
from aerial_gym.physics.fused.torch_trace import trace_to_warp

MATRIX = wp.types.matrix(shape=(2, 3), dtype=wp.float32)


@wp.struct
class Body:
    velocity: wp.vec3
    axes: MATRIX
    mass: float


def push(body: SimpleNamespace, factor: Tensor) -> tuple[Tensor, Tensor]:
    along = (body.axes * body.velocity.unsqueeze(1)).sum(-1)
    force = torch.linalg.cross(body.axes[:, 0], body.velocity) / body.mass.unsqueeze(-1)
    size = 1.0 / body.velocity.norm(dim=-1)
    return force * factor.unsqueeze(-1) + torch.diag_embed(body.velocity)[:, 0], along.clamp(-1.0, 0.5).sum(-1) * size


INPUTS, OUTPUTS = {"body": Body, "factor": float}, (wp.vec3, float)
trace_push = partial(trace_to_warp, "push", INPUTS, push, OUTPUTS)


def run(function: wp.Function, velocity: Tensor, axes: Tensor, mass: Tensor, factor: Tensor) -> tuple[Tensor, Tensor]:
    start_warp()

    @wp.kernel(module="unique")
    def kernel(
        velocity: wp.array[wp.vec3], axes: wp.array[MATRIX], mass: wp.array[float], factor: wp.array[float],
        force: wp.array[wp.vec3], number: wp.array[float],
    ):  # fmt: skip
        i = wp.tid()
        body = Body()
        body.velocity = velocity[i]
        body.axes = axes[i]
        body.mass = mass[i]
        pushed, share = function(body, factor[i])
        force[i] = pushed
        number[i] = share

    force, number = torch.full_like(velocity, nan), torch.full_like(mass, nan)
    given = [(velocity, wp.vec3), (axes, MATRIX), (mass, wp.float32), (factor, wp.float32)]
    given += [(force, wp.vec3), (number, wp.float32)]
    wp.launch(kernel, dim=len(mass), inputs=[wp.from_torch(rows, dtype=kind) for rows, kind in given], device="cpu")
    return force, number


@pytest.mark.parametrize("known", [False, True])
def test_traced_function_equals_torch(known: bool) -> None:
    generator = torch.Generator().manual_seed(3)
    velocity, axes, mass, factor = (torch.randn(50, *shape, generator=generator) for shape in ((3,), (2, 3), (), ()))
    if known:
        axes[:] = torch.tensor([[0.0, 0.0, 1.0], [-1.0, 0.0, 1.0]])
    function = trace_push(constants={"body.axes": axes[0]} if known else None)
    expected = push(SimpleNamespace(velocity=velocity, axes=axes, mass=mass), factor)
    for actual, wanted in zip(run(function, velocity, axes, mass, factor), expected, strict=True):
        torch.testing.assert_close(actual, wanted, rtol=1e-5, atol=1e-5)


def test_partly_known_constants_keep_other_entries() -> None:
    function = trace_push(constants={"body.axes": torch.tensor([[0.0, 0.0, nan], [1.0, nan, 0.0]])})
    axes = torch.tensor([[[0.0, 0.0, 2.0], [1.0, 3.0, 0.0]]])
    velocity, one = torch.tensor([[0.3, -0.2, 0.1]]), torch.ones(1)
    expected = push(SimpleNamespace(velocity=velocity, axes=axes, mass=one), one)
    for actual, wanted in zip(run(function, velocity, axes, one, one), expected, strict=True):
        torch.testing.assert_close(actual, wanted)


def branch(body: SimpleNamespace, factor: Tensor) -> tuple[Tensor, Tensor]:
    """Return rows by a branch on a value, which no kernel can have."""
    return (body.velocity if factor[0] > 0.0 else -body.velocity), factor


def test_untraceable_code_is_named_with_its_line_and_a_way_out() -> None:
    with pytest.raises(CapabilityError, match=r"branch: .*test_torch_trace\.py:\d+ .*factor\[0\] > 0\.0.*torch\.where"):
        trace_to_warp("branch", INPUTS, branch, OUTPUTS)


def search(x: Tensor, y: Tensor) -> Tensor:
    """Return a number by a loop that runs where x > 0 only."""

    def halve(high: Tensor) -> Tensor:
        for _ in range(3):
            high = torch.where(high > 1.0, 0.5 * high, high + 1.0)
        return high

    return y * choose(x > 0.0, halve, y, x + 1.0)


def element_function(body: SimpleNamespace, factor: Tensor) -> tuple[Tensor, Tensor]:
    """Return rows by a function of elements, and a number by bits, a small exponential and a choice of columns."""
    state = (1000.0 * factor).to(torch.int64)
    noise = uniform_draws(state, 3, 3, dtype=torch.float32) - 0.5
    chosen = body.velocity.index_select(1, torch.tensor([2, 0, 0]))
    return by_element(search, body.velocity, body.mass.unsqueeze(-1)) + noise, torch.expm1(1e-4 * chosen).sum(-1)


def test_functions_of_elements_and_integers_equal_torch() -> None:
    generator = torch.Generator().manual_seed(4)
    velocity, axes, mass, factor = (torch.randn(50, *shape, generator=generator) for shape in ((3,), (2, 3), (), ()))
    function = trace_to_warp("elements", INPUTS, element_function, OUTPUTS, constants={})
    expected = element_function(SimpleNamespace(velocity=velocity, mass=mass), factor)
    for actual, wanted in zip(run(function, velocity, axes, mass, factor), expected, strict=True):
        torch.testing.assert_close(actual, wanted, rtol=2e-6, atol=1e-9)


def test_function_of_elements_that_reads_other_numbers_is_refused() -> None:
    def closure(body: SimpleNamespace, factor: Tensor) -> tuple[Tensor, Tensor]:
        return by_element(lambda v: v * body.mass, body.velocity), factor

    with pytest.raises(CapabilityError, match="not among its arguments"):
        trace_to_warp("closure", INPUTS, closure, OUTPUTS, constants={})
