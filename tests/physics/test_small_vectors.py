"""Sums over short axes against numpy's own, and crossed vectors of rotors that sit alike or not."""

import numpy as np
import pytest
import torch

from aerial_gym.math.rows import dot, sum_slices
from aerial_gym.physics.effects.condition import sum_of_crosses
from tests.physics.vehicles import F64

RNG = np.random.default_rng(0)


def test_sums_are_those_of_numpy_for_any_leading_shape() -> None:
    a, b = RNG.standard_normal((5, 4, 3)), RNG.standard_normal((1, 4, 3))
    result = dot(torch.from_numpy(a), torch.from_numpy(b)).numpy()
    np.testing.assert_allclose(result, np.einsum("erk,ork->er", a, b), rtol=1e-13)
    for dim in range(3):
        np.testing.assert_allclose(sum_slices(torch.from_numpy(a), dim).numpy(), a.sum(axis=dim), atol=1e-14)


@pytest.mark.parametrize("rows", [1, 5])
def test_crosses_are_summed_in_their_order_for_hubs_of_all_rows_and_of_each(rows: int) -> None:
    """x cross y is +z; and numpy's cross product, of arms that all rows share or that each has."""
    x, y = torch.tensor([[[1.0, 0.0, 0.0]]], dtype=F64), torch.tensor([[[0.0, 1.0, 0.0]]], dtype=F64)
    assert sum_of_crosses(x, y).tolist() == [[0.0, 0.0, 1.0]]
    vector, arm = RNG.standard_normal((5, 4, 3)), RNG.standard_normal((rows, 4, 3))
    result = sum_of_crosses(torch.from_numpy(vector), torch.from_numpy(arm)).numpy()
    np.testing.assert_allclose(result, np.cross(vector, arm).sum(axis=1), atol=1e-13)
