"""Derivatives of candidates about a model that holds some of them."""

import numpy as np

from aerial_gym.sim2real.identify.candidates.library import exact_along


def test_derivatives_are_made_exact_along_a_step_and_kept_across_it() -> None:
    rng = np.random.default_rng(0)
    columns, change, step = rng.standard_normal((3, 2, 20)).T, rng.standard_normal((20, 2)), np.array([0.3, 0.0, -1.2])
    exact = columns.copy(order="K")
    exact_along([exact], step, [change])
    np.testing.assert_allclose(exact @ step, change, atol=1e-12)
    for across in ([1.2, 0.0, 0.3], [0.0, 1.0, 0.0]):
        np.testing.assert_allclose(exact @ across, columns @ across, atol=1e-12)
    assert exact.T.flags.c_contiguous  # rows are neighbours, as they are written and read
    kept = columns.copy(order="K")
    exact_along([kept], np.zeros(3), [change])
    np.testing.assert_array_equal(kept, columns)
