"""Bayes factors of a change of one effect in some flights of a vehicle, against no change.

With a change d in the columns C, flight i has ``x_i = base + g_i d``. The base is integrated out, which leaves the information
matrix P and the gradient q of d. Given ``d ~ N(0, s²)``: ``2 log BF = s² q' (1 + s² P)^-1 q - log det(1 + s² P)``.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy.special import logsumexp

from aerial_gym.fleet.statistics.moments import TRTRS, Columns, integrate_flights, solve_lower, whitening
from aerial_gym.sim2real.arrays import Array, Flags, Indices

SIZES = tuple((0.03 * 10.0 ** np.linspace(0.0, 2.0, 9)).tolist())
"""Prior standard deviations of a change in units of the parameter's scale, equally probable. A scale is a moderate change."""

CHUNK = 64  # Patterns of a change in memory at a time


@dataclass(frozen=True, kw_only=True)
class Hypotheses:
    """Effects whose parameters may change: each cause once for each start of its linearisation."""

    causes: tuple[tuple[str, int], ...]  # Effect and rotor
    cause: Indices  # Index of each hypothesis' cause, (H,)
    columns: tuple[Indices, ...]  # Columns of each hypothesis
    log_prior: Array  # Logarithm of each prior probability, (H,): equal for causes, then for the starts of a cause

    @classmethod
    def from_columns(cls, columns: Columns, shown: Flags) -> "Hypotheses":
        """Return the hypotheses on the shown columns, (K,)."""
        groups: dict[tuple[str, int], dict[int, list[int]]] = {}
        for place in np.flatnonzero(shown).tolist():
            column = columns[place]
            if column.effect:
                groups.setdefault((column.effect, column.rotor), {}).setdefault(column.start, []).append(place)
        causes = sorted(groups)
        places = tuple(np.array(own) for cause in causes for own in groups[cause].values())
        numbers = np.repeat(np.arange(len(causes)), [len(groups[cause]) for cause in causes])
        log_prior = -np.log(np.bincount(numbers)[numbers] * max(len(causes), 1))
        return cls(causes=tuple(causes), cause=numbers, columns=places, log_prior=log_prior)

    def select(self, hypotheses: Sequence[int] | Indices) -> "Hypotheses":
        """Return some hypotheses with their prior probabilities, by indices."""
        columns = tuple(self.columns[k] for k in hypotheses)
        return replace(self, cause=self.cause[hypotheses], columns=columns, log_prior=self.log_prior[hypotheses])


@dataclass(frozen=True, kw_only=True)
class ChangeScan:
    """Flights with their own deviations integrated out, and the posterior of their common base."""

    product: Array  # (N, K, K)
    gradient: Array  # At the mean of the base's prior, (N, K)
    root: Array  # Prior standard deviations of the base, (K,)

    @classmethod
    def from_flights(cls, product: Array, gradient: Array, mean: Array, var_flight: Array, root: Array) -> "ChangeScan":
        """Return the scan of flights with moments at neutral; ``mean`` is that of the base's prior."""
        product, gradient = integrate_flights(product, gradient - product @ mean, var_flight)
        return cls(product=product, gradient=gradient, root=root)

    @cached_property
    def lower(self) -> Array:
        """Return the Cholesky factor of the base's posterior precision in units of ``root``, (K, K)."""
        return whitening(self.product.sum(axis=0), self.root)

    @cached_property
    def white(self) -> Array:
        """Return the whitened gradient of the base, (K,)."""
        return solve_lower(self.lower, self.root * self.gradient.sum(axis=0))

    @property
    def log_marginal(self) -> float:
        """Return the log likelihood without a change, base integrated out, up to a constant of the flights."""
        return float(0.5 * self.white @ self.white - np.log(self.lower.diagonal()).sum())

    def with_scatter(self, places: Indices, extra: Array) -> tuple["ChangeScan", float]:
        """Return the scan with extra variance between flights in some columns, (P,), and the change of the constant.

        The extra variance may be negative, down to that which is integrated out.
        """
        cross, right = self.product[:, :, places], self.gradient[:, places, None]
        block = np.eye(places.size) + extra[:, None] * cross[:, places]
        solved = np.linalg.solve(block, extra[:, None] * np.concatenate((cross.swapaxes(1, 2), right), axis=2))
        product, gradient = self.product - cross @ solved[..., :-1], self.gradient - (cross @ solved[..., -1:])[..., 0]
        constant = 0.5 * ((right[..., 0] * solved[..., -1]).sum() - np.linalg.slogdet(block)[1].sum())
        return ChangeScan(product=product, gradient=gradient, root=self.root), float(constant)

    def base(self, white: Array | None = None) -> Array:
        """Return the base's posterior mean from the prior's, (K,), or shifts (any, K) for whitened gradients (any, K)."""
        rows = np.atleast_2d(self.white if white is None else white)
        solved = TRTRS(self.lower, rows.reshape(-1, self.root.size).T, lower=1, trans=1)[0].T * self.root
        return solved[0] if white is None else solved.reshape(rows.shape)

    def base_cov(self, places: Indices) -> Array:
        """Return the posterior covariance of the base in some columns, (P, P)."""
        side = solve_lower(self.lower, np.diag(self.root)[:, places])
        return side.T @ side

    def log_factors(self, patterns: Array, hypotheses: Hypotheses, flights: slice = slice(None)) -> Array:
        """Return log Bayes factors (J, H, sizes) of changes that follow patterns g, (J, N), over the flights of a slice."""
        widths = [own.size for own in hypotheses.columns]
        table = np.zeros((len(patterns), len(widths), len(SIZES)))
        for width in sorted(set(widths)):
            members = np.flatnonzero(np.equal(widths, width))
            places = np.array([hypotheses.columns[k] for k in members])
            product, gradient, _ = self.change_moments(patterns, places, flights)
            table[:, members] = log_factors_by_size(product, gradient)
        return table

    def log_factors_of_flights(self, hypotheses: Hypotheses) -> Array:
        """Return log Bayes factors of a change in one flight alone, (N, H)."""
        count = len(self.product)
        chunks = [slice(k, min(k + CHUNK, count)) for k in range(0, count, CHUNK)]
        tables = [self.log_factors(np.eye(part.stop - part.start), hypotheses, part) for part in chunks]
        return log_sum(np.concatenate(tables), axis=2) - np.log(len(SIZES))

    def change_moments(
        self, patterns: Array, places: Indices, flights: slice = slice(None)
    ) -> tuple[Array, Array, Array]:
        """Return P, (J, h, P, P), q, (J, h, P), and the whitened coupling to the base, (J, h, P, K), of changes.

        Args:
            patterns: Shares of the change in the flights of the slice, (J, N).
            places: Columns of h hypotheses of equal size, (h, P).
        """
        own, width = self.product[flights], self.root.size
        first = np.tensordot(patterns, own[:, places.ravel()], axes=1) * self.root  # rows of K: no copy
        second = np.tensordot(patterns**2, own[:, places[:, :, None], places[:, None, :]], axes=1)
        side = solve_lower(self.lower, first.reshape(-1, width).T).T.reshape(-1, *places.shape, width)
        right = np.tensordot(patterns, self.gradient[flights][:, places], axes=1) - side @ self.white
        return second - side @ side.swapaxes(-1, -2), right, side

    def cohort_moments(self, changed: Flags) -> tuple[Array, Array]:
        """Return the information (2 K, 2 K) and gradient (2 K,) of the prior's mean and a change in some flights, (N,)."""
        own, total = self.product[changed].sum(axis=0), self.product.sum(axis=0)
        right = np.concatenate((self.gradient.sum(axis=0), self.gradient[changed].sum(axis=0)))
        side = solve_lower(self.lower, self.root[:, None] * np.concatenate((total, own), axis=1))
        return np.block([[total, own], [own, own]]) - side.T @ side, right - side.T @ self.white


def log_sum(logs: Array, axis: int | tuple[int, ...] | None = None) -> Array:
    """Return the logarithm of the sum of exponentials."""
    return np.asarray(logsumexp(logs, axis=axis))


def log_factors_by_size(product: Array, gradient: Array) -> Array:
    """Return log Bayes factors (any, sizes) for each prior deviation of ``SIZES``, from P (any, P, P) and q (any, P)."""
    values, vectors = np.linalg.eigh(product)
    along = np.square((gradient[..., None, :] @ vectors)[..., 0, :])[..., None, :]
    variance = np.square(SIZES)[:, None]
    spread = 1.0 + variance * np.maximum(values, 0.0)[..., None, :]
    return 0.5 * (variance * along / spread - np.log(spread)).sum(axis=-1)


def change_posterior(product: Array, gradient: Array) -> tuple[Array, Array, Array]:
    """Return probability (any, sizes), mean (any, sizes, P) and covariance (any, sizes, P, P) of a change by prior size."""
    logs = log_factors_by_size(product, gradient)
    cov = np.linalg.inv(product[..., None, :, :] + np.eye(gradient.shape[-1]) / np.square(SIZES)[:, None, None])
    mean = (cov @ gradient[..., None, :, None])[..., 0]
    return np.exp(logs - log_sum(logs, axis=-1)[..., None]), mean, cov


def mixture_moments(weight: Array, mean: Array, cov: Array) -> tuple[Array, Array]:
    """Return mean and covariance of a mixture with weights (M,), means (M, P) and covariances (M, P, P)."""
    weight = weight / weight.sum()
    total = weight @ mean
    away = mean - total
    return total, np.tensordot(weight, cov + away[:, :, None] * away[:, None, :], axes=1)
