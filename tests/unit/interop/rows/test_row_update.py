"""Rows written by a mask: from an input that the kernel makes, with other work done to the same rows beside it."""

import pytest
import torch
import warp as wp
from torch import Tensor

from aerial_gym.interop import start_warp
from aerial_gym.interop.rows import KernelInput, RowUpdate, RowWork

MASK = (True, False, True, True, False)


@wp.struct
class RowInput:
    scale: wp.array[float]  # (E,)
    marks: wp.array[wp.int32]  # (E,)


@wp.func
def scale_number(given: RowInput, row: int, number: float) -> float:
    return number * given.scale[row]


@wp.func
def mark(row: int, given: RowInput):
    given.marks[row] = given.marks[row] + 1


def sum_indirect(made: Tensor, base: Tensor) -> tuple[Tensor, ...]:
    """Compute the same as ``sum_rows``, with operations that do not fit into a row kernel."""
    return (base + torch.cumsum(made, 0).diff(dim=0, prepend=torch.zeros(1, 2)),)


def sum_rows(made: Tensor, base: Tensor) -> tuple[Tensor, ...]:
    return (base + made,)


@pytest.mark.parametrize("function", [sum_rows, sum_indirect])
def test_rows_of_the_mask_are_made_followed_and_worked_on_and_others_stay(function) -> None:
    start_warp()
    count, mask = len(MASK), torch.tensor(MASK)
    scale, marks = torch.arange(1.0, count + 1.0), torch.zeros(count, dtype=torch.int32)
    given = RowInput()
    given.scale, given.marks = wp.from_torch(scale), wp.from_torch(marks)
    lines = ("made_0 = scaled(given, row, 2.0)", "made_1 = scaled(given, row, 3.0)")
    made = KernelInput(lines=lines, names={"scaled": scale_number}, given_type=RowInput, given=given)
    numbers, base, sums = torch.full((count, 2), -1.0), torch.full((count, 2), 10.0), torch.full((count, 2), -1.0)
    beside = RowWork(function=mark, given_type=RowInput, given=given)
    rows = RowUpdate(function, (numbers, base), (sums,), mask=mask, made=made, beside=beside)
    assert bool(rows.why_slow) == (function is sum_indirect)
    rows()
    expected = torch.where(mask.unsqueeze(-1), torch.outer(scale, torch.tensor([2.0, 3.0])), -1.0)
    assert torch.equal(numbers, expected)
    assert torch.equal(sums, torch.where(mask.unsqueeze(-1), 10.0 + expected, -1.0))
    assert marks.tolist() == [int(each) for each in MASK]
    mask.copy_(~mask)
    rows()
    assert marks.tolist() == [1] * count
    assert torch.equal(numbers, torch.outer(scale, torch.tensor([2.0, 3.0])))
