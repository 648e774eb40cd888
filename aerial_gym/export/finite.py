"""The rule for numbers that are not finite, in torch and in C99: no command is made from NaN or infinity.

ReLU, limits and dead weights can each turn NaN into an ordinary number. Exported files therefore test the numbers themselves.
Letters: B rows, N numbers of a row.
"""

from math import nan

import torch
from torch import Tensor


def finite_rows(*parts: Tensor) -> Tensor:
    """Return whether all numbers of a row are finite, bool (B, 1); ``parts`` are (B, ...), integers are finite."""
    floats = [part for part in parts if part.is_floating_point()]
    return torch.stack([part.float().flatten(1).isfinite().all(-1) for part in floats]).all(0).unsqueeze(-1)


def nan_unless(finite: Tensor, numbers: Tensor) -> Tensor:
    """Return numbers (B, N), NaN in the rows that are not ``finite``, (B, 1)."""
    return torch.where(finite, numbers, nan)


C_FINITE = """/* Reads the bits: with -ffast-math, comparisons and isnan() do not see NaN. */
static int is_finite(const float *numbers, int count) {
    union { float number; uint32_t bits; } each;
    for (int i = 0; i < count; ++i) {
        each.number = numbers[i];
        if ((each.bits & 0x7f800000u) == 0x7f800000u) return 0;
    }
    return 1;
}
static void set_nan(float *numbers, int count) {
    const union { uint32_t bits; float number; } made = { 0x7fc00000u };
    for (int i = 0; i < count; ++i) numbers[i] = made.number;
}
"""
"""Functions that a C file uses for this; they need ``stdint.h``."""
