"""Rows written by a mask: from an input that the kernel makes, with other work done to the same rows beside it."""

from collections.abc import Callable

import pytest
import torch
import warp as wp
from torch import Tensor

from aerial_gym.interop import start_warp
from aerial_gym.interop.rows import Made, MaskedRows, RowWork

MASK = (True, False, True, True, False)


@wp.struct
class Given:
    """What both read and one writes."""

    scale: wp.array[float]  # (E,)
    marks: wp.array[wp.int32]  # (E,)


@wp.func
def scaled(given: Given, row: int, number: float) -> float:
    """Return a number times the scale of the row."""
    return number * given.scale[row]


@wp.func
def mark(row: int, given: Given):
    """Count the row."""
    given.marks[row] = given.marks[row] + 1


def unfollowed(made: Tensor, base: Tensor) -> tuple[Tensor, ...]:
    """Return what ``followed`` does, in a way that does not fit into a row kernel."""
    return (base + torch.cumsum(made, 0).diff(dim=0, prepend=torch.zeros(1, 2)),)


def followed(made: Tensor, base: Tensor) -> tuple[Tensor, ...]:
    """Return the sum."""
    return (base + made,)


@pytest.mark.parametrize("function", [followed, unfollowed])
def test_rows_of_the_mask_are_made_followed_and_worked_on_and_others_stay(
    function: Callable[..., tuple[Tensor, ...]],
) -> None:
    """Numbers 2 and 3 times the scale of the row; five rows are no whole number of blocks."""
    start_warp()
    count, mask = len(MASK), torch.tensor(MASK)
    scale, marks = torch.arange(1.0, count + 1.0), torch.zeros(count, dtype=torch.int32)
    given = Given()
    given.scale, given.marks = wp.from_torch(scale), wp.from_torch(marks)
    made = Made(
        lines=("made_0 = scaled(given, row, 2.0)", "made_1 = scaled(given, row, 3.0)"),
        names={"scaled": scaled},
        given_type=Given,
        given=given,
    )
    numbers, base, sums = torch.full((count, 2), -1.0), torch.full((count, 2), 10.0), torch.full((count, 2), -1.0)
    rows = MaskedRows(
        function,
        (numbers, base),
        (sums,),
        mask=mask,
        made=made,
        beside=RowWork(function=mark, given_type=Given, given=given),
    )
    assert bool(rows.why_slow) == (function is unfollowed)
    rows()
    expected = torch.where(mask.unsqueeze(-1), torch.outer(scale, torch.tensor([2.0, 3.0])), -1.0)
    assert torch.equal(numbers, expected)
    assert torch.equal(sums, torch.where(mask.unsqueeze(-1), 10.0 + expected, -1.0))
    assert marks.tolist() == [int(each) for each in MASK]
    mask.copy_(~mask)
    rows()
    assert marks.tolist() == [1] * count
    assert torch.equal(numbers, torch.outer(scale, torch.tensor([2.0, 3.0])))
