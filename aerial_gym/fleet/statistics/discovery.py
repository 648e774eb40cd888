"""Rejection of many null hypotheses with a limited rate of false discoveries."""

import numpy as np

from aerial_gym.sim2real.arrays import Array, Flags


def benjamini_hochberg(log_e: Array, level: float) -> Flags:
    """Return the rejected hypotheses of M, (M,), by e-values: the n largest, with ``e >= M / (level n)`` and n maximal.

    The expected share of false rejections is at most ``level`` under any dependence.
    Source: Wang, Ramdas (2022), False discovery rate control with e-values, J. R. Stat. Soc. B 84, section 4.

    Args:
        log_e: Logarithms of the e-values, (M,).
    """
    log_e = np.asarray(log_e, dtype=float)
    falling = np.sort(log_e)[::-1]
    count = np.arange(1, falling.size + 1)
    enough = falling[falling + np.log(count) >= np.log(max(falling.size, 1) / level)]
    return log_e >= enough.min(initial=np.inf)
