"""Moments of the flights of one vehicle, and their integrals over Gaussian deviations."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Self

import numpy as np
from scipy.linalg import get_lapack_funcs

from aerial_gym.sim2real.arrays import Array, Indices

if TYPE_CHECKING:  # needs torch
    from aerial_gym.sim2real.flight_evidence.columns import EvidenceColumn

POTRF, TRTRS = get_lapack_funcs(("potrf", "trtrs"), dtype=np.float64)

ROUNDING = 2.0**-19
"""Information of a column that is added to itself, relative. It exceeds the rounding of moments stored as float32."""


Columns = Sequence["EvidenceColumn"]


@dataclass(frozen=True, kw_only=True)
class VehicleFlights:
    """Moments of one vehicle's flights in order of time."""

    vehicle: str
    product: Array  # Information matrices of the flights, (N, K, K)
    gradient: Array  # Gradients of their log likelihoods at neutral, (N, K)
    time: Array  # Times of the flights [s], or their numbers, (N,)
    firmware: tuple[str, ...]  # Firmware of each flight, (N,)
    is_timed: bool = True  # Whether times are not numbers

    def select(self, flights: Indices | Sequence[int]) -> Self:
        """Return some flights, by indices."""
        chosen = np.asarray(flights, dtype=int)
        return replace(
            self, product=self.product[chosen], gradient=self.gradient[chosen], time=self.time[chosen],
            firmware=tuple(self.firmware[k] for k in chosen),
        )  # fmt: skip


def usable_times(time: Array) -> tuple[Array, bool]:
    """Return the times, (N,), and whether they are in order; else flight numbers from 1 (times missing, equal or unordered)."""
    time = np.asarray(time, dtype=float)
    is_ordered = bool(np.isfinite(time).all() and (np.diff(time) >= 0.0).all() and time.size and time[-1] > time[0])
    return (time if is_ordered else np.arange(1.0, time.size + 1.0)), is_ordered


def integrate_flights(product: Array, gradient: Array, variance: Array) -> tuple[Array, Array]:
    """Return moments (N, K, K) and (N, K) after integration over each flight's own deviation.

    ``A' = A - A S (1 + S A S)^-1 S A`` with the standard deviations S, and ``b'`` likewise, which also holds for singular A.

    Args:
        variance: Variances of the deviations, (K,) or (N, K).
    """
    products, gradients = np.array(product, dtype=float, order="C"), np.array(gradient, dtype=float)
    for flight, root in enumerate(np.sqrt(np.broadcast_to(variance, gradients.shape))):
        own = products[flight]
        np.fill_diagonal(own, own.diagonal() * (1.0 + ROUNDING))
        lower = whitening(own, root)
        both = solve_lower(lower, root[:, None] * np.column_stack((own, gradients[flight])))
        own -= both[:, :-1].T @ both[:, :-1]
        gradients[flight] -= both[:, :-1].T @ both[:, -1]
    return products, gradients


def whitening(product: Array, root: Array) -> Array:
    """Return the lower Cholesky factor of ``1 + S A S``, (K, K), with the standard deviations S = ``root``."""
    lower, status = POTRF(np.eye(root.size) + root[:, None] * product * root, lower=1, clean=1)
    if status:
        raise ValueError(
            "the moments of a flight are not positive semidefinite: they are damaged, so read the log again"
        )
    return lower


def solve_lower(lower: Array, right: Array) -> Array:
    """Return ``L^-1 right``, (K, any)."""
    return TRTRS(lower, right, lower=1)[0] if right.size else right
