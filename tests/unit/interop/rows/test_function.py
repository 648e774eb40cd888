"""Row kernels against the torch functions from which they were traced, and everything that must be refused."""

import re
import subprocess
import sys
from collections.abc import Callable
from math import inf, nan

import pytest
import torch
import warp as wp
from torch import Tensor

from aerial_gym.interop import start_warp
from aerial_gym.interop.launches import BLOCK_DIM
from aerial_gym.interop.rows import (
    DifferentiableRows,
    KernelInput,
    RowFunction,
    RowUpdate,
    RowWork,
    UntraceableError,
    row_trace,
    trace,
)
from aerial_gym.interop.rows.transport import LARGEST
from aerial_gym.math.quaternion import (
    euler_from_quat,
    quat_from_euler,
    quat_multiply,
    quat_rotate_inverse,
    quat_without_tilt,
)

ROWS = 5

POINTWISE: dict[str, Callable[[Tensor, Tensor], Tensor]] = {
    "arithmetic": lambda a, b: (a + 2 * b) / (1.5 - b) - (3 - a) * -b,
    "alpha": lambda a, b: torch.sub(torch.add(a, b, alpha=0.5), b, alpha=2),
    "powers": lambda a, b: a**2 + b**3 + (a.abs() + 1.0) ** 0.5 + (b.abs() + 0.1) ** 1.3 + a.square(),
    "roots": lambda a, b: (a * a).sqrt() + torch.rsqrt(b * b + 1.0) + (b + 3.0).reciprocal(),
    "exponentials": lambda a, b: torch.exp(-a * a) + torch.log(b.abs() + 0.5) + torch.tanh(a) + torch.sigmoid(b),
    "angles": lambda a, b: torch.sin(a) + torch.cos(b) + torch.tan(0.1 * a) + torch.atan2(a, b) + torch.atan(b),
    "arcs": lambda a, b: torch.asin(torch.tanh(a)) + torch.acos(torch.tanh(b)) + torch.asin(a),
    "hyperbolas": lambda a, b: torch.sinh(a) + torch.cosh(b),
    "finite": lambda a, b: a.nan_to_num() + b.nan_to_num(1.0, 2.0, 3.0),
    "steps": lambda a, b: torch.floor(a) + torch.ceil(b) + torch.round(3.0 * a) + torch.sign(b),
    "limits": lambda a, b: a.clamp(-0.5, 0.5) + b.clamp_min(0.0) + a.clamp(max=0.2) + torch.relu(b),
    "wraps": lambda a, b: torch.remainder(a, 0.7) + torch.remainder(b, -1.1) + (a + 3.0) % 2.0,
    "extremes": lambda a, b: torch.maximum(a, b) - torch.minimum(a, 2.0 * b),
    "choices": lambda a, b: (
        torch.where(a > b, a, 0.0) + torch.where(a.isnan(), 1.0, -1.0) + b.masked_fill(b < 0.0, 3.0)
    ),
    "truths": lambda a, b: ((a > 0) & (b <= 1) | ~(a != b)) ^ torch.logical_not(b >= a) & (a < 3) & torch.isfinite(b),
    "types": lambda a, b: (a > 0).float() + (b == b).to(torch.int32) + (a > b).double().float(),
    "constants": lambda a, b: a * torch.tensor([1.0, -2.0, inf]) + torch.zeros_like(b) + torch.full_like(b, 2.0),
}

MOVING: dict[str, Callable[[Tensor, Tensor], Tensor]] = {
    "columns": lambda a, b: torch.stack((a[:, 0], b[:, 2], a[:, 1] * b[:, 0]), dim=-1),
    "sides": lambda a, b: torch.cat((a, b[:, 1:], a.new_zeros(a.shape[0], 1)), dim=-1),
    "unbound": lambda a, b: torch.stack([x * y for x, y in zip(a.unbind(-1), b.unbind(-1), strict=True)], dim=1),
    "matrices": lambda a, b: (a.unsqueeze(-1) * b.unsqueeze(-2)).transpose(1, 2).flatten(1).flip(-1),
    "padded": lambda a, b: torch.nn.functional.pad(a, (1, 2), value=7.0).roll(1, -1),
    "split": lambda a, b: torch.cat(torch.split(a.expand(-1, 3), [1, 2], dim=1)[::-1], dim=1).view(-1, 3),
    "sums": lambda a, b: torch.stack((a.sum(-1), b.mean(dim=1), a.prod(-1), a.amin(-1), b.amax(-1)), dim=-1),
    "norms": lambda a, b: a / a.norm(dim=-1, keepdim=True).clamp_min(1e-6) + b.norm(p=1, dim=-1, keepdim=True),
    "unit": lambda a, b: torch.nn.functional.normalize(a, dim=-1) + torch.linalg.norm(b, ord=inf, dim=-1, keepdim=True),
    "products": lambda a, b: torch.bmm(torch.einsum("ei,ej->eij", a, b), b.unsqueeze(-1))[..., 0] + a @ torch.eye(3),
    "any": lambda a, b: torch.stack(((a > 0.0).any(-1), (b < 2.0).all(-1)), dim=-1),
    "attitudes": lambda a, b: quat_rotate_inverse(
        quat_without_tilt(quat_multiply(quat_from_euler(a), quat_from_euler(b))), a
    ),
    "euler": lambda a, b: euler_from_quat(quat_from_euler(0.3 * torch.tanh(a))) + b,
}


@pytest.fixture(scope="module")
def rows() -> tuple[Tensor, Tensor]:
    generator = torch.Generator().manual_seed(0)
    a, b = (torch.randn(ROWS, 3, generator=generator) for _ in range(2))
    a[1, 1], a[3, 0], b[2, 2] = nan, 0.0, inf
    return a, b


def test_kernels_do_what_torch_does(rows: tuple[Tensor, Tensor]) -> None:
    """Within 4 ulp of the terms, which are of order one; NaN, infinities and truth values exactly; all in one kernel."""
    table = {**POINTWISE, **MOVING}

    def call_all(a: Tensor, b: Tensor) -> tuple[Tensor, ...]:
        return tuple(function(a, b) for function in table.values())

    for (name, function), result in zip(table.items(), RowFunction(call_all, rows)(*rows), strict=True):
        expected = function(*rows)
        assert result.dtype == expected.dtype, name
        close = {"atol": 2e-6, "rtol": 2e-6, "equal_nan": True}
        torch.testing.assert_close(result, expected, **close, msg=lambda m, n=name: f"{n}: {m}")


def test_products_in_inference_mode_are_those_of_torch(rows: tuple[Tensor, Tensor], monkeypatch) -> None:
    """They arrive whole there, and torch's own decomposition imports sympy for seconds."""
    monkeypatch.setattr(torch._ops.OpOverload, "decompose", lambda *_, **__: pytest.fail("decomposed by torch"))

    def multiply(a: Tensor, b: Tensor) -> tuple[Tensor, ...]:
        outer, fixed = a.unsqueeze(2) * b.unsqueeze(1), torch.arange(9.0).view(3, 3)
        return outer @ outer.transpose(1, 2), outer @ fixed, fixed @ outer, outer @ fixed[0], a @ fixed, a @ fixed[0]

    with torch.inference_mode():
        finite = tuple(part.nan_to_num(1.0, 1.0) for part in rows)
        for result, expected in zip(RowFunction(multiply, finite)(*finite), multiply(*finite), strict=True):
            torch.testing.assert_close(result, expected, atol=1e-5, rtol=1e-5)


def test_integers_and_shared_numbers() -> None:
    steps, done = torch.tensor([3, 10, 11], dtype=torch.int32), torch.tensor([True, False, False])
    level = torch.tensor(0.5)

    def ends(steps: Tensor, done: Tensor, level: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        truncated = (steps >= 10) & ~done
        return truncated, level * steps, steps + 1

    function = RowFunction(ends, (steps, done, level))
    for share in (0.5, 0.25):
        level.fill_(share)
        for result, expected in zip(function(steps, done, level), ends(steps, done, level), strict=True):
            assert result.dtype == expected.dtype
            assert torch.equal(result, expected)


def test_limits_of_integers_are_not_asked_for_nan() -> None:
    steps, other = torch.tensor([-3, 1, 12], dtype=torch.int32), torch.tensor([2, 0, 9], dtype=torch.int32)

    def limit(a: Tensor, b: Tensor) -> tuple[Tensor, ...]:
        return a.clamp(0, 5), torch.maximum(a, b), torch.minimum(a, b)

    function = RowFunction(limit, (steps, other))
    assert "!=" not in function.code
    for result, expected in zip(function(steps, other), limit(steps, other), strict=True):
        assert result.dtype == expected.dtype
        assert torch.equal(result, expected)


def test_results_are_written_where_asked_even_over_an_input() -> None:
    total, reward, kept = torch.tensor([1.0, 2.0]), torch.tensor([0.5, -1.0]), torch.full((2,), nan)
    function = RowFunction(lambda t, r: (t + r, torch.where(r < 0.0, 0.0, t + r)), (total, reward))
    result, over = function(total, reward, out=(kept, total))
    assert result is kept
    assert over is total
    assert result.tolist() == [1.5, 1.0]
    assert total.tolist() == [1.5, 0.0]


def test_a_row_is_the_same_alone() -> None:
    """Every row is computed by its own thread from its own numbers: bit for bit the same in every batch."""
    a = torch.randn(9, 3, generator=torch.Generator().manual_seed(1))
    function = RowFunction(lambda a: torch.tanh(a).norm(dim=-1) * torch.exp(a[:, 0]), (a,))
    together = function(a)[0]
    for i in range(9):
        assert torch.equal(function(a[i : i + 1].clone())[0], together[i : i + 1])


def test_views_of_larger_tensors_are_read_in_place() -> None:
    state = torch.arange(26.0).view(2, 13)
    function = RowFunction(lambda p, q: p * q[:, :3], (state[:, :3], state[:, 3:7]))
    assert torch.equal(function(state[:, :3], state[:, 3:7])[0], state[:, :3] * state[:, 3:6])


def test_the_same_computation_is_done_once() -> None:
    traced = trace(lambda a: a.norm(dim=-1) + a.norm(dim=-1), (torch.zeros(4, 3),))
    assert sum(scalar.kind == "sqrt" for scalar in traced.scalars) == 1


ELSEWHERE = torch.rand(3)

REFUSED: dict[str, tuple[Callable[[Tensor], object], str]] = {
    "branch": (lambda a: a if a.sum() > 0 else -a, "over the rows"),
    "host": (lambda a: a * a[0, 0].item(), "mixes rows"),
    "mean": (lambda a: a - a.mean(), "torch.mean over the rows"),
    "other rows": (lambda a: a.flip(0), "mixes rows"),
    "first row": (lambda a: a + a[0], "mixes rows"),
    "product of rows": (lambda a: a[:, :1] + a[:, 0], "mixes rows"),
    "cumsum": (lambda a: a.cumsum(0), "torch.cumsum is not a supported operation"),
    "random": (lambda a: a + torch.rand(3), "torch.rand draws random numbers"),
    "elsewhere": (lambda a: a * ELSEWHERE, "not among its arguments"),
    "in place": (lambda a: a.add_(1.0), "torch.add_ writes in place"),
    "rounded division": (lambda a: torch.div(a, 2.0, rounding_mode="floor"), "rounding_mode"),
    "no rows": (lambda a: torch.ones(3), "does not have a row"),
    "error": (lambda a: a.nothing, "AttributeError"),
}


@pytest.mark.parametrize("name", REFUSED)
def test_what_is_not_done_row_by_row_is_refused(name: str) -> None:
    function, reason = REFUSED[name]
    with pytest.raises(UntraceableError, match=reason):
        trace(function, (torch.rand(4, 3),))


def test_tracing_does_not_load_compilers_of_torch() -> None:
    code = (
        "import sys, torch\nfrom aerial_gym.interop.rows import RowFunction\n"
        "RowFunction(lambda a: a.norm(dim=-1), (torch.zeros(2, 3),))\n"
        "print([m for m in ('sympy', 'torch._dynamo', 'torch._inductor') if m in sys.modules])"
    )
    out = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert out.stdout.strip() == "[]"


@pytest.mark.parametrize("shape", [(3,), (row_trace.ROWS, 2)])
def test_a_number_below_zero_is_no_scalar(shape: tuple[int, ...]) -> None:
    with pytest.raises(UntraceableError, match="mixes rows"):
        row_trace._remove_marks(torch.full(shape, -1))


@pytest.fixture
def draw_rows() -> tuple[Tensor, Tensor]:
    generator = torch.Generator().manual_seed(1)
    a, b = (0.9 * torch.rand(ROWS, 3, generator=generator) + 0.05 for _ in range(2))  # slopes of all are finite
    a[2] *= -1.0
    a[1, 1] = b[1, 1]  # where functions have a corner, as torch decides
    return a.requires_grad_(), b.requires_grad_()


def test_gradients_are_those_of_torch(draw_rows: tuple[Tensor, Tensor]) -> None:
    without = ("sums", "constants")  # a product has none in a kernel, and a factor is infinite
    table = {name: function for name, function in {**POINTWISE, **MOVING}.items() if name not in without}
    table = {name: function for name, function in table.items() if function(*draw_rows).requires_grad}
    assert len(table) > 20

    def call_all(a: Tensor, b: Tensor) -> tuple[Tensor, ...]:
        return tuple(function(a, b) for function in table.values())

    results = DifferentiableRows(call_all, draw_rows)(*draw_rows)
    generator = torch.Generator().manual_seed(2)
    for name, result in zip(table, results, strict=True):
        expected = table[name](*draw_rows)
        seed = torch.randn(expected.shape, generator=generator)
        actual = torch.autograd.grad(result, draw_rows, seed, retain_graph=True)
        reference = torch.autograd.grad(expected, draw_rows, seed, allow_unused=True)
        for local, other in zip(actual, reference, strict=True):
            other = torch.zeros_like(local) if other is None else other
            torch.testing.assert_close(local, other, atol=1e-5, rtol=1e-5, msg=lambda m, n=name: f"{n}: {m}")


def test_tensors_from_elsewhere_are_read_at_every_call(draw_rows: tuple[Tensor, Tensor]) -> None:
    """One row for all (stride 0) and a row for each; written in place, they are seen; no gradient goes to them."""
    shared = torch.tensor([1.0, 2.0, 3.0]).as_strided((ROWS, 3), (0, 1))
    own = torch.arange(1.0, ROWS + 1.0)

    def function(a: Tensor, b: Tensor) -> tuple[Tensor, ...]:
        return (a * a * shared + b * own.unsqueeze(-1),)

    actual = DifferentiableRows(function, draw_rows, lifts=True)
    for _ in range(2):
        (results,), (expected,) = actual(*draw_rows), function(*draw_rows)
        torch.testing.assert_close(results, expected)
        grads = torch.autograd.grad(results.sum(), draw_rows, retain_graph=True)
        for local, reference in zip(grads, torch.autograd.grad(expected.sum(), draw_rows), strict=True):
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
def test_other_tensors_from_elsewhere_are_refused(
    elsewhere: Tensor, lifts: bool, draw_rows: tuple[Tensor, Tensor]
) -> None:
    with pytest.raises(UntraceableError, match="not among its arguments"):
        DifferentiableRows(lambda a, b: (a * b * elsewhere.sum(),), draw_rows, lifts=lifts)


def test_numbers_that_are_no_floats_have_no_gradient(draw_rows: tuple[Tensor, Tensor]) -> None:
    steps, level = torch.arange(ROWS, dtype=torch.int32), torch.tensor(0.5)

    def function(a: Tensor, steps: Tensor, level: Tensor) -> tuple[Tensor, ...]:
        return a * level * steps.unsqueeze(-1), steps + 1, a[:, 0] > 0.0

    scaled, more, above = DifferentiableRows(function, (draw_rows[0], steps, level))(draw_rows[0], steps, level)
    (results,) = torch.autograd.grad(scaled.sum(), draw_rows[0])
    assert torch.equal(results, (0.5 * steps.float()).unsqueeze(-1).expand(ROWS, 3))
    assert more.tolist() == [1, 2, 3, 4, 5]
    assert not more.requires_grad
    assert not above.requires_grad


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
