"""Rows written by a mask: from an input that the kernel makes, with other work done to the same rows beside it."""

import re
from math import nan

import pytest
import torch
import warp as wp
from torch import Tensor

from aerial_gym.interop import start_warp
from aerial_gym.interop.rows import KernelInput, RowFunction, RowUpdate, RowWork
from aerial_gym.interop.rows.transport import LARGEST
from aerial_gym.interop.streams import BLOCK_DIM

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


def transform_rows(a: Tensor, quad: Tensor) -> tuple[Tensor, ...]:
    """Return rows of 2, 3, 4, 13 and more than ``LARGEST`` numbers, a flag, and two mirrored over what they come from."""
    wide = torch.cat([a] * (LARGEST // 13 + 1), dim=-1)
    return a[:, :2], a[:, 4:7], a[:, 5:9], quad, a + 1.0, wide, a[:, 0] > 100.0, a.flip(-1), quad.flip(-1)


def poison(num_rows: int, width: int, device: str, *, gap: int, shift: int) -> tuple[Tensor, Tensor]:
    """Return memory full of NaN, and rows in it that lie ``gap`` numbers apart, the first after ``shift`` numbers."""
    memory = torch.full((shift + num_rows * (width + gap),), nan, device=device)
    return memory, memory[shift:].view(num_rows, width + gap)[:, :width]


def check_transport(num_rows: int, device: str) -> None:
    """Store whole numbers, which no rounding changes, into poisoned memory: together, apart, and not aligned."""
    numbers = torch.arange(num_rows * 13.0, device=device).view(num_rows, 13)
    for gap, shift in ((0, 0), (0, 1), (3, 0), (9, 1)):
        memory, (a, quad) = [], (numbers, -numbers[:, 9:])
        wanted = transform_rows(a, quad)
        out: list[Tensor] = []
        for result in wanted:
            if result.dtype == torch.bool:
                out.append(torch.zeros_like(result))
                memory.append(out[-1])
            else:
                whole, rows = poison(num_rows, result.shape[1], device, gap=gap, shift=shift)
                memory.append(whole)
                out.append(rows)
        out[-2].copy_(a)
        out[-1].copy_(quad)
        RowFunction(transform_rows, (out[-2], out[-1]))(out[-2], out[-1], out=out)
        for i, (results, expected, whole) in enumerate(zip(out, wanted, memory, strict=True)):
            assert torch.equal(results, expected), (i, gap, shift)
            results.zero_()
            assert int(whole.isnan().sum()) == whole.numel() - results.numel(), (i, gap, shift)


@pytest.mark.parametrize("num_rows", [1, 33])
def test_rows_arrive_as_they_are(num_rows: int) -> None:
    check_transport(num_rows, "cpu")


def test_a_block_has_room_for_all_rows_that_are_staged() -> None:
    """48 KB of shared memory for 64 threads: of three rows of 100 numbers one is staged, and a narrow one beside it."""
    numbers = torch.rand(5, 100)
    rows = RowFunction(lambda a: (a + 1.0, a + 2.0, a + 3.0, a[:, :7] + 4.0), [numbers])
    results = rows(numbers)
    widths = [int(width) for width in re.findall(r"store_row\(out_\d, row, vector_(\d+)", rows.code)]
    assert widths == [100, 7]
    assert sum(width | 1 for width in widths) * 4 * BLOCK_DIM <= 48 * 1024
    for k in range(3):
        assert torch.equal(results[k], numbers + (k + 1.0))
