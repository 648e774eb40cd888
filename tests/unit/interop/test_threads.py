"""Threads on the CPU."""

import numpy as np
import torch
from scipy.linalg import solve_triangular
from threadpoolctl import threadpool_info

from aerial_gym.interop import one_thread


def threads() -> list[int]:
    """Return the number of threads of each linear-algebra library, and of torch as the last."""
    return [library["num_threads"] for library in threadpool_info()] + [torch.get_num_threads()]


def test_torch_and_linear_algebra_run_on_one_thread_inside_and_as_before_after_it() -> None:
    np.testing.assert_allclose(solve_triangular(np.eye(2), np.ones(2)), 1.0)
    torch.set_num_threads(2)
    before = threads()
    try:
        with one_thread():
            assert set(threads()) == {1}
            raise KeyError
    except KeyError:
        pass
    assert len(before) >= 3
    assert threads() == before
