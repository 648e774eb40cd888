"""Marginal likelihood with random offsets of single flights, as from a new battery or a warm sensor.

In ``r = J x + o + noise`` with noise weight w in n rows, o is normal with standard deviation s. Integrated over o, the
likelihood is that of rows minus the share ``1 - 1 / sqrt(1 + n w s²)`` of their mean. Letters: C channels, K parameters.

Source: Laird, Ware (1982), Random-effects models for longitudinal data, Biometrics 38 (marginal covariance, section 3).
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from aerial_gym.sim2real.arrays import Array


@dataclass(frozen=True, kw_only=True)
class FlightOffsets:
    """Prior of the flight offsets, with the noise weights."""

    size: Array  # Standard deviation s in each channel, (C,); 0 without offsets
    weight: Array  # Weight w of one row, (C,)
    most: Array  # Upper limit of s, independent of the flights that estimated it, (C,)

    @property
    def has_offsets(self) -> bool:
        """Return whether any channel has offsets."""
        return bool(self.size.any())

    def remove_offsets(self, parts: Sequence[Array]) -> list[Array]:
        """Return residuals (rows, C), or derivatives (rows, C, K), minus the share of their flight means."""
        if not self.has_offsets:
            return list(parts)
        return [
            part - self.share_of_mean(len(part)).reshape(-1, *(1,) * (part.ndim - 2)) * part.mean(axis=0)
            for part in parts
        ]

    def share_of_mean(self, rows: int) -> Array:
        """Return the subtracted share of the mean in each channel for so many rows, (C,)."""
        return 1.0 - 1.0 / np.sqrt(self._variance_ratio(rows))

    def log_likelihood(self, rows: Sequence[int]) -> float:
        """Return the log likelihood term of flights with these numbers of rows: ``-sum log(1 + n w s²) / 2``."""
        return -0.5 * float(sum(np.log(self._variance_ratio(count)).sum() for count in rows))

    def _variance_ratio(self, rows: int) -> Array:
        return 1.0 + rows * self.weight * self.size**2


def no_offsets(weight: Array) -> FlightOffsets:
    """Return a model without offsets, given the weight of one row, (C,)."""
    return FlightOffsets(size=np.zeros(weight.size), weight=weight, most=np.zeros(weight.size))
