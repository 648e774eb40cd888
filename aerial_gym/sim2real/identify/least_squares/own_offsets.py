"""Offsets of single flights, integrated out: a battery that was put in anew, a sensor that has warmed up.

A channel of a flight is ``r = J x + o + noise``, with noise of weight w in each of n rows and o normal with standard deviation
s, anew in each flight. Without o the likelihood of x is that of rows from which the share ``1 - 1 / sqrt(1 + n w s²)`` of
their mean is taken: the inverse root of ``1 / w + s² 1 1^T`` is ``sqrt(w) (1 - share 1 1^T / n)``.

Letters: C channels, K parameters.

Source: Laird, Ware (1982), Random-effects models for longitudinal data, Biometrics 38 (marginal covariance, section 3).
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from aerial_gym.sim2real.arrays import Array


@dataclass(frozen=True, kw_only=True)
class OwnOffsets:
    """How large offsets of flights are, and how much noise they are told from."""

    size: Array
    """Standard deviation s in each channel, (C,); 0 where flights have none."""

    weight: Array
    """Of one row, w, (C,)."""

    most: Array
    """How large s is at most, whatever the flights of which it was estimated, (C,)."""

    @property
    def any(self) -> bool:
        """Return whether there are any."""
        return bool(self.size.any())

    def taken_out(self, parts: Sequence[Array]) -> list[Array]:
        """Return residuals (rows, C), or derivatives (rows, C, K), of flights without the share of their means."""
        if not self.any:
            return list(parts)
        return [part - self.share(len(part)).reshape(-1, *(1,) * (part.ndim - 2)) * part.mean(axis=0) for part in parts]

    def share(self, rows: int) -> Array:
        """Return the share of the mean of so many rows that is taken out of each channel, (C,)."""
        return 1.0 - 1.0 / np.sqrt(self._beyond_noise(rows))

    def log_likelihood(self, rows: Sequence[int]) -> float:
        """Return the log likelihood of flights of so many rows beyond the squares: ``-sum log(1 + n w s²) / 2``."""
        return -0.5 * float(sum(np.log(self._beyond_noise(count)).sum() for count in rows))

    def _beyond_noise(self, rows: int) -> Array:
        return 1.0 + rows * self.weight * self.size**2


def no_offsets(weight: Array) -> OwnOffsets:
    """Return those of flights that have none, with the weight of one row, (C,)."""
    return OwnOffsets(size=np.zeros(weight.size), weight=weight, most=np.zeros(weight.size))
