"""Sums over blocks of time."""

import numpy as np

from aerial_gym.sim2real.identify.least_squares.moments import block_moments


def test_parts_of_a_derivative_give_the_sums_of_the_whole_one() -> None:
    rng = np.random.default_rng(0)
    times = [np.arange(rows) / 50.0 for rows in (310, 120)]
    residuals = [rng.normal(size=(time.size, 2)) for time in times]
    parts = [[rng.normal(size=(time.size, 2, width)) for width in (3, 0, 4)] for time in times]
    whole = block_moments(times, residuals, [np.concatenate(own, axis=2) for own in parts], length=1.0)
    apart = block_moments(times, residuals, parts, length=1.0)
    for name in ("count", "square", "gradient", "product", "flight"):
        np.testing.assert_array_equal(getattr(apart, name), getattr(whole, name))
    first = np.einsum("rck,rcl->ckl", *[np.concatenate(parts[0], axis=2)] * 2)
    np.testing.assert_allclose(whole.product[whole.flight == 0].sum(axis=0), first, rtol=1e-12)
