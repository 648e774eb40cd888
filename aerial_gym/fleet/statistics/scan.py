"""Bayes factors of a change of one effect in some flights of a vehicle, against no change.

With a change d in the columns C, flight i has ``x_i = base + g_i d``. The base is integrated out, which leaves the information
matrix P and the gradient q of d. Given ``d ~ N(0, s²)``: ``2 log BF = s² q' (1 + s² P)^-1 q - log det(1 + s² P)``.
"""

from collections.abc import Iterator
from dataclasses import dataclass, field

import numpy as np
from scipy.linalg import lapack
from scipy.special import logsumexp

from aerial_gym.fleet.statistics.moments import Columns, integrate_flights, solve_lower, whitening
from aerial_gym.sim2real.arrays import Array, Flags, Indices

SIZES = (0.03, 0.1, 0.3, 1.0, 3.0)
"""Prior standard deviations of a change in units of the parameter's scale, equally probable. A scale is a moderate change."""

CHUNK = 64  # Patterns of a change in memory at a time


@dataclass(frozen=True, kw_only=True)
class Hypotheses:
    """Effects whose parameters may change: each cause once for each start of its linearisation."""

    causes: tuple[tuple[str, int], ...]  # Effect and rotor
    cause: Indices  # Index of each hypothesis' cause, (H,)
    columns: tuple[Indices, ...]  # Columns of each hypothesis

    @classmethod
    def from_columns(cls, columns: Columns, information: Array) -> "Hypotheses":
        """Return the hypotheses whose columns have information, (K,)."""
        groups: dict[tuple[str, int], dict[int, list[int]]] = {}
        for place, column in enumerate(columns):
            if column.effect and information[place] > 0.0:
                groups.setdefault((column.effect, column.rotor), {}).setdefault(column.start, []).append(place)
        causes = sorted(groups)
        pairs = [(k, np.array(places)) for k, cause in enumerate(causes) for places in groups[cause].values()]
        number, places = zip(*pairs, strict=True) if pairs else ((), ())
        return cls(causes=tuple(causes), cause=np.array(number, dtype=int), columns=tuple(places))

    @property
    def log_prior(self) -> Array:
        """Return the logarithm of each prior probability, (H,): equal for causes, then for the starts of a cause."""
        return -np.log(np.bincount(self.cause)[self.cause] * max(len(self.causes), 1))


@dataclass(frozen=True, kw_only=True)
class ChangeScan:
    """Flights with their own deviations integrated out, and the posterior of their common base."""

    product: Array  # (N, K, K)
    gradient: Array  # At the mean of the base's prior, (N, K)
    root: Array  # Prior standard deviations of the base, (K,)
    lower: Array = field(init=False)  # Cholesky factor of the base's precision in units of ``root``, (K, K)
    white: Array = field(init=False)  # ``lower^-1 root gradient``, (K,)

    def __post_init__(self) -> None:
        object.__setattr__(self, "lower", whitening(self.product.sum(axis=0), self.root))
        object.__setattr__(self, "white", solve_lower(self.lower, self.root * self.gradient.sum(axis=0)))

    @classmethod
    def from_flights(cls, product: Array, gradient: Array, mean: Array, var_flight: Array, root: Array) -> "ChangeScan":
        """Return the scan of flights with moments at neutral; ``mean`` is that of the base's prior."""
        product, gradient = integrate_flights(product, gradient - product @ mean, var_flight)
        return cls(product=product, gradient=gradient, root=root)

    def without_flight(self, flight: int) -> "ChangeScan":
        """Return the scan without one flight."""
        keep = np.arange(self.product.shape[0]) != flight
        return ChangeScan(product=self.product[keep], gradient=self.gradient[keep], root=self.root)

    def log_factors(self, patterns: Array, hypotheses: Hypotheses) -> Array:
        """Return log Bayes factors of changes that follow patterns g over the flights, (J, N), as (J, H)."""
        rows = [
            self._log_factors(*self._sums(part), hypotheses)
            for part in np.split(patterns, range(CHUNK, len(patterns), CHUNK))
        ]
        return np.concatenate(rows)

    def log_factors_of_flights(self, hypotheses: Hypotheses) -> Array:
        """Return log Bayes factors of a change in one flight alone, (N, H)."""
        parts = range(0, self.product.shape[0], CHUNK)
        chunks = [(self.product[k : k + CHUNK], self.gradient[k : k + CHUNK]) for k in parts]
        return np.concatenate([self._log_factors(product, product, right, hypotheses) for product, right in chunks])

    def _sums(self, patterns: Array) -> tuple[Array, Array, Array]:
        """Return ``sum g A``, ``sum g² A`` and ``sum g b`` of each pattern, (J, K, K) and (J, K)."""
        first, second = (np.tensordot(weight, self.product, axes=1) for weight in (patterns, patterns**2))
        return first, second, patterns @ self.gradient

    def _log_factors(self, first: Array, second: Array, right: Array, hypotheses: Hypotheses) -> Array:
        log_factors = np.zeros((len(first), len(hypotheses.columns)))
        for members, product, gradient in self._change_moments(first, second, right, hypotheses):
            log_factors[:, members] = logsumexp(log_factors_by_size(product, gradient), axis=-1) - np.log(len(SIZES))
        return log_factors

    def _change_moments(
        self, first: Array, second: Array, right: Array, hypotheses: Hypotheses
    ) -> Iterator[tuple[Indices, Array, Array]]:
        """Yield hypotheses of equal size with P, (J, h, P, P), and q, (J, h, P)."""
        used = np.unique(np.concatenate(hypotheses.columns))
        sides = (self.root[:, None] * first[:, :, used]).transpose(1, 0, 2)
        whitened = solve_lower(self.lower, sides.reshape(self.root.size, -1)).reshape(sides.shape).transpose(1, 2, 0)
        right = right[:, used] - whitened @ self.white
        widths = np.array([places.size for places in hypotheses.columns])
        for width in np.unique(widths):
            members = np.flatnonzero(widths == width)
            places = np.array([hypotheses.columns[k] for k in members])
            own = np.searchsorted(used, places)
            sides = whitened[:, own]  # (J, h, P, K)
            product = second[:, places[:, :, None], places[:, None, :]] - sides @ sides.swapaxes(-1, -2)
            yield members, product, right[:, own]

    def base(self) -> Array:
        """Return the posterior mean of the base without a change, from the prior's mean, (K,)."""
        return self._back(self.white)

    def _back(self, right: Array) -> Array:
        return (
            self.root.reshape((-1,) + (1,) * (right.ndim - 1)) * lapack.dtrtrs(self.lower, right, lower=1, trans=1)[0]
        )

    def change_moments(self, pattern: Array, places: Indices) -> tuple[Array, Array, Array]:
        """Return P, (P, P), and q, (P,), of a change with a pattern (N,), and the shift of the base per change, (K, P)."""
        first = np.tensordot(pattern, self.product[:, :, places], axes=1)
        second = np.tensordot(pattern**2, self.product[np.ix_(range(pattern.size), places, places)], axes=1)
        side = solve_lower(self.lower, self.root[:, None] * first)
        right = pattern @ self.gradient[:, places] - side.T @ self.white
        return second - side.T @ side, right, -self._back(side)

    def cohort_moments(self, changed: Flags) -> tuple[Array, Array]:
        """Return the information (2 K, 2 K) and gradient (2 K,) of the prior's mean and a change in some flights, (N,)."""
        own, total = self.product[changed].sum(axis=0), self.product.sum(axis=0)
        right = np.concatenate((self.gradient.sum(axis=0), self.gradient[changed].sum(axis=0)))
        side = solve_lower(self.lower, self.root[:, None] * np.concatenate((total, own), axis=1))
        return np.block([[total, own], [own, own]]) - side.T @ side, right - side.T @ self.white

    def base_cov(self, places: Indices) -> Array:
        """Return the posterior covariance of the base in some columns, without a change, (P, P)."""
        side = solve_lower(self.lower, np.diag(self.root)[:, places])
        return side.T @ side


def log_factors_by_size(product: Array, gradient: Array) -> Array:
    """Return log Bayes factors (any, sizes) for each prior deviation of ``SIZES``, from P (any, P, P) and q (any, P)."""
    values, vectors = np.linalg.eigh(product)
    along = np.square(np.einsum("...pk,...p->...k", vectors, gradient))[..., None, :]
    variance = np.square(SIZES)[:, None]
    spread = 1.0 + variance * np.maximum(values, 0.0)[..., None, :]
    return 0.5 * (variance * along / spread - np.log(spread)).sum(axis=-1)


def change_by_size(product: Array, gradient: Array) -> tuple[Array, Array]:
    """Return means (sizes, P) and covariances (sizes, P, P) of a change, for each prior deviation of ``SIZES``."""
    cov = np.linalg.inv(product + np.eye(gradient.size) / np.square(SIZES)[:, None, None])
    return cov @ gradient, cov
