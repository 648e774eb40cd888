"""What is read from object files and programs of a GPU, which Warp compiles where there is none."""

import pytest
import warp as wp

from aerial_gym.interop import start_warp
from benchmarks.joints.kernel_size import compiled_size, count_operations

LENGTH = 64
VECTOR = wp.types.vector(length=LENGTH, dtype=wp.float32)


@wp.kernel(module="unique", enable_backward=False)
def _pick(places: wp.array[int], values_out: wp.array[float]):
    """Write an entry of a vector whose place is not known to the compiler: it is in local memory."""
    i = wp.tid()
    values = VECTOR()
    for k in range(places[1]):
        values[places[k]] = float(k)
    values_out[i] = values[places[i]]


@wp.kernel(module="unique", enable_backward=False)
def _double(values_out: wp.array[float]):
    i = wp.tid()
    values_out[i] = 2.0 * values_out[i]


def test_a_vector_with_unknown_places_is_in_local_memory() -> None:
    start_warp()
    size = compiled_size(_pick, arch=90)
    assert size.local_bytes >= 4 * LENGTH
    assert 8 <= size.registers <= 255


def test_a_kernel_of_one_product_is_small() -> None:
    """It needs no local memory; its one operation stands in the code twice, as the compiler peels the loop over threads."""
    start_warp()
    size = compiled_size(_double, arch=90)
    assert (size.local_bytes, size.operations) == (0, 2)
    assert size.instructions is not None
    assert size.registers < 64
    assert size.instructions < 256


@pytest.mark.parametrize(
    ("line", "count"),
    [
        ("fma.rn.f32 %f1, %f2, %f3, %f4;", 2),
        ("add.f32 %f1, %f2, %f3;", 1),
        ("div.approx.f32 %f1, %f2, %f3;", 1),
        ("neg.f32 %f1, %f2;", 0),
        ("add.s32 %r1, %r2, %r3;", 0),
        ("mul.f64 %fd1, %fd2, %fd3;", 0),
    ],
)
def test_operations_are_those_on_single_numbers(line: str, count: int) -> None:
    assert count_operations(f"\t{line}\n") == count
