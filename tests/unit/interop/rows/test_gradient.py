"""Kernels of gradients against torch's own."""

import pytest
import torch
from torch import Tensor

from aerial_gym.interop.rows import DifferentiableRows, UntraceableError
from tests.unit.interop.rows.test_function import MOVING, POINTWISE, ROWS


@pytest.fixture
def rows() -> tuple[Tensor, Tensor]:
    generator = torch.Generator().manual_seed(1)
    a, b = (0.9 * torch.rand(ROWS, 3, generator=generator) + 0.05 for _ in range(2))  # slopes of all are finite
    a[2] *= -1.0
    a[1, 1] = b[1, 1]  # where functions have a corner, as torch decides
    return a.requires_grad_(), b.requires_grad_()


def test_gradients_are_those_of_torch(rows: tuple[Tensor, Tensor]) -> None:
    without = ("sums", "constants")  # a product has none in a kernel, and a factor is infinite
    table = {name: function for name, function in {**POINTWISE, **MOVING}.items() if name not in without}
    table = {name: function for name, function in table.items() if function(*rows).requires_grad}
    assert len(table) > 20

    def call_all(a: Tensor, b: Tensor) -> tuple[Tensor, ...]:
        return tuple(function(a, b) for function in table.values())

    results = DifferentiableRows(call_all, rows)(*rows)
    generator = torch.Generator().manual_seed(2)
    for name, result in zip(table, results, strict=True):
        expected = table[name](*rows)
        seed = torch.randn(expected.shape, generator=generator)
        actual = torch.autograd.grad(result, rows, seed, retain_graph=True)
        reference = torch.autograd.grad(expected, rows, seed, allow_unused=True)
        for local, other in zip(actual, reference, strict=True):
            other = torch.zeros_like(local) if other is None else other
            torch.testing.assert_close(local, other, atol=1e-5, rtol=1e-5, msg=lambda m, n=name: f"{n}: {m}")


def test_tensors_from_elsewhere_are_read_at_every_call(rows: tuple[Tensor, Tensor]) -> None:
    """One row for all (stride 0) and a row for each; written in place, they are seen; no gradient goes to them."""
    shared = torch.tensor([1.0, 2.0, 3.0]).as_strided((ROWS, 3), (0, 1))
    own = torch.arange(1.0, ROWS + 1.0)

    def function(a: Tensor, b: Tensor) -> tuple[Tensor, ...]:
        return (a * a * shared + b * own.unsqueeze(-1),)

    actual = DifferentiableRows(function, rows, lifts=True)
    for _ in range(2):
        (results,), (expected,) = actual(*rows), function(*rows)
        torch.testing.assert_close(results, expected)
        grads = torch.autograd.grad(results.sum(), rows, retain_graph=True)
        for local, reference in zip(grads, torch.autograd.grad(expected.sum(), rows), strict=True):
            torch.testing.assert_close(local, reference)
        shared[0] *= 2.0
        own += 1.0
    with pytest.raises(RuntimeError, match="modified by an inplace operation"):
        results.sum().backward()


@pytest.mark.parametrize(
    ("elsewhere", "lifts"),
    [(torch.ones(ROWS, 3), False), (torch.ones(4), True), (torch.ones(ROWS, 3, requires_grad=True), True)],
    ids=["not lifted", "without rows", "with a gradient of its own"],
)
def test_other_tensors_from_elsewhere_are_refused(elsewhere: Tensor, lifts: bool, rows: tuple[Tensor, Tensor]) -> None:
    with pytest.raises(UntraceableError, match="not among its arguments"):
        DifferentiableRows(lambda a, b: (a * b * elsewhere.sum(),), rows, lifts=lifts)


def test_numbers_that_are_no_floats_have_no_gradient(rows: tuple[Tensor, Tensor]) -> None:
    steps, level = torch.arange(ROWS, dtype=torch.int32), torch.tensor(0.5)

    def function(a: Tensor, steps: Tensor, level: Tensor) -> tuple[Tensor, ...]:
        return a * level * steps.unsqueeze(-1), steps + 1, a[:, 0] > 0.0

    scaled, more, above = DifferentiableRows(function, (rows[0], steps, level))(rows[0], steps, level)
    (results,) = torch.autograd.grad(scaled.sum(), rows[0])
    assert torch.equal(results, (0.5 * steps.float()).unsqueeze(-1).expand(ROWS, 3))
    assert more.tolist() == [1, 2, 3, 4, 5]
    assert not more.requires_grad
    assert not above.requires_grad
