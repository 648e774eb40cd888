"""Benjamini-Hochberg with e-values."""

import numpy as np

from aerial_gym.fleet.statistics import benjamini_hochberg


def test_rejections_by_hand() -> None:
    """Of four with level 0.1, one needs e = 40, two need 20 each, three need 13.3 each."""
    assert benjamini_hochberg(np.log([39.0, 1.0, 1.0, 1.0]), 0.1).tolist() == [False] * 4
    assert benjamini_hochberg(np.log([41.0, 1.0, 19.0, 1.0]), 0.1).tolist() == [True, False, False, False]
    assert benjamini_hochberg(np.log([21.0, 1.0, 22.0, 1.0]), 0.1).tolist() == [True, False, True, False]
    assert benjamini_hochberg(np.log([14.0, 14.0, 14.0, 1.0]), 0.1).tolist() == [True, True, True, False]


def test_no_hypotheses() -> None:
    assert benjamini_hochberg(np.zeros(0), 0.01).size == 0
    assert benjamini_hochberg(np.array([-np.inf]), 0.01).tolist() == [False]
