"""What is given back to the system is no longer resident."""

import ctypes
from pathlib import Path

import numpy as np
import pytest

from aerial_gym.sim2real.memory import give_back_memory

RESIDENT = Path("/proc/self/statm")


def resident() -> int:
    return int(RESIDENT.read_text(encoding="utf-8").split()[1])


@pytest.mark.skipif(
    not RESIDENT.exists() or not hasattr(ctypes.CDLL(None), "malloc_trim"), reason="needs Linux with the GNU C library"
)
def test_memory_between_what_is_kept_goes_back() -> None:
    """Every 64th row of 50 MB of short ones is kept: the rest is free, and stays with the process until it is asked for."""
    rows = [np.ones(1600) for _ in range(4096)]
    kept = rows[::64]
    del rows
    before = resident()
    give_back_memory()
    assert before - resident() > 0.8 * 4096 * 1600 * 8 / 4096
    assert all(row.sum() == 1600 for row in kept)
