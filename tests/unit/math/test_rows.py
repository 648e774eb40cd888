"""A row has the same result in every batch, however many threads work on it, bit for bit."""

from collections.abc import Iterator

import pytest
import torch
from torch import Tensor

from aerial_gym.math.rows import atan2, make_batch_invariant, times

COUNTS = (*range(1, 20), 63, 64, 65, 127, 130, 1000, 33001)
NUM_ROWS = 40003
"""More than torch gives to one thread (32,768 elements), and no multiple of anything."""


@pytest.fixture(params=[1, 3])
def threads(request: pytest.FixtureRequest) -> Iterator[int]:
    before = torch.get_num_threads()
    torch.set_num_threads(request.param)
    yield request.param
    torch.set_num_threads(before)


def numbers(*shape: int, dtype: torch.dtype) -> Tensor:
    return torch.randn(*shape, dtype=torch.float64, generator=torch.Generator().manual_seed(0)).to(dtype)


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_an_angle_does_not_depend_on_its_place(threads: int, dtype: torch.dtype) -> None:
    y, x = numbers(2, NUM_ROWS, dtype=dtype)
    whole = atan2(y, x)
    assert all(torch.equal(atan2(y[:n].clone(), x[:n].clone()), whole[:n]) for n in COUNTS)
    assert all(torch.equal(atan2(y[n:].clone(), x[n:].clone()), whole[n:]) for n in (1, 17, 35000))


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
@pytest.mark.parametrize(("num_terms", "width"), [(3, 3), (4, 3), (3, 12), (7, 32)])
def test_a_product_does_not_depend_on_the_number_of_rows(threads, num_terms, width, dtype) -> None:
    rows, matrix = numbers(NUM_ROWS, num_terms, dtype=dtype), numbers(num_terms, width, dtype=dtype)
    whole = times(rows, matrix)
    assert all(torch.equal(times(rows[:n].clone(), matrix), whole[:n]) for n in COUNTS)
    torch.testing.assert_close(whole, (rows.unsqueeze(-1) * matrix).sum(1))


def test_gradients_go_through_rows() -> None:
    y, x = numbers(2, 5, dtype=torch.float64).requires_grad_().unbind()
    assert torch.autograd.gradcheck(atan2, (y, x))
    rows, matrix = (numbers(*shape, dtype=torch.float64).requires_grad_() for shape in ((5, 3), (3, 4)))
    assert torch.autograd.gradcheck(times, (rows, matrix))


def test_a_function_of_others_is_given_whole_vectors() -> None:
    rows = numbers(192, dtype=torch.float32).abs()
    whole = torch.pow(rows, 1.3 * rows)
    for n in (1, 5, 63, 65):
        function = make_batch_invariant(lambda a: torch.pow(a, 1.3 * a), n, rows.device)
        assert torch.equal(function(rows[:n]), whole[:n])
