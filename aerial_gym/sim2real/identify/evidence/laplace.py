"""Log evidence ``log integral L(x) p(x) dx`` of a set of effects by Laplace's approximation.

The model is linear about a point: residual r = J x + noise. x holds the parameters of a set's effects in units of scale,
with Cauchy priors about neutral, whose tails permit values ten times larger, and deviations within the tolerances, with
normal priors. Letters: K columns of a library, k columns of one set, P of them parameters of effects.

Sources: Kass, Raftery (1995), Bayes factors, Journal of the American Statistical Association 90 (Laplace, section 4.1);
Jeffreys (1961), Theory of Probability, section 5.2 (Cauchy priors).
"""

from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.linalg import get_lapack_funcs
from scipy.special import log_ndtr

from aerial_gym.sim2real.arrays import Array, Flags, Indices

Model = tuple[int, ...]  # Ascending indices of the candidates in a set
MOST_STEPS = 30  # Most iterations for the posterior mode under the Cauchy priors
CONVERGED = 1e-4  # Convergence limit of a step in units of scale
AT_ONCE = 512  # Number of sets evaluated in one batch

LOG_2PI = float(np.log(2.0 * np.pi))

(_solve_triangular,) = get_lapack_funcs(("trtrs",), dtype=np.float64)  # without scipy's slower argument checks


@dataclass(frozen=True, kw_only=True)
class NormalEquations:
    """Normal equations: the log likelihood is ``gradient x - x product x / 2`` plus a constant."""

    product: Array  # ``sum w J J^T``, (K, K)
    gradient: Array  # ``sum w J r``, (K,)
    constant: float = 0.0  # Constant of the log likelihood

    def integrate_out(self, columns: Indices, kept: Indices) -> "NormalEquations":
        """Return the sums of the ``kept`` columns, with others integrated out exactly over their normal priors."""
        return MarginalSums(self, columns, kept).sums_of_columns(kept)

    def marginal(self, columns: Indices) -> "NormalEquations":
        """Return all sums with columns that all sets share integrated out and set to zero."""
        kept = np.setdiff1d(np.arange(self.gradient.size), columns)
        reduced = self.integrate_out(columns, kept)
        product, gradient = np.zeros_like(self.product), np.zeros_like(self.gradient)
        product[kept[:, None], kept], gradient[kept] = reduced.product, reduced.gradient
        return NormalEquations(product=product, gradient=gradient, constant=reduced.constant)


class MarginalSums:
    """Sums with some columns integrated out exactly over their normal priors."""

    def __init__(self, normal: NormalEquations, columns: Indices, kept: Indices) -> None:
        there = columns[:, None]
        root = np.linalg.cholesky(normal.product[there, columns] + np.eye(columns.size))
        solved = _solve_lower(root, np.column_stack((normal.product[there, kept], normal.gradient[columns])))
        across, right = np.zeros((columns.size, normal.gradient.size)), solved[:, -1]
        across[:, kept] = solved[:, :-1]
        self._normal, self._columns, self._root, self._across, self._right = normal, columns, root, across, right
        self._constant = normal.constant + 0.5 * float(right @ right) - _half_log_det(root)

    def sums_of_columns(self, kept: Indices) -> NormalEquations:
        """Return the sums of some columns."""
        across = self._across[:, kept]
        product, gradient = self._normal.product[kept[:, None], kept], self._normal.gradient[kept]
        return NormalEquations(
            product=product - across.T @ across, gradient=gradient - across.T @ self._right, constant=self._constant
        )

    def sums_with_columns_at_zero(self, gone: Indices, kept: Indices) -> NormalEquations:
        """Return the sums of ``kept`` columns if the integrated columns ``gone`` are fixed at zero instead."""
        inverse = _solve_lower(self._root, (self._columns[:, None] == gone).astype(np.float64))
        steps = inverse.T @ np.column_stack((self._across[:, kept], self._right))
        root = np.linalg.cholesky(inverse.T @ inverse)
        solved, sums = _solve_lower(root, steps), self.sums_of_columns(kept)
        across, right = solved[:, :-1], solved[:, -1]
        return NormalEquations(
            product=sums.product + across.T @ across,
            gradient=sums.gradient + across.T @ right,
            constant=sums.constant - 0.5 * float(right @ right) - _half_log_det(root),
        )


def _solve_lower(root: Array, right: Array) -> Array:
    """Return ``root^-1 right`` for a lower triangular matrix."""
    return _solve_triangular(root.T, right, trans=1)[0] if root.size and right.size else right


def _half_log_det(root: Array) -> float:
    """Return half the log determinant from a Cholesky factor."""
    return float(np.log(np.diag(root)).sum())


@dataclass(frozen=True, kw_only=True)
class Posterior:
    """Posterior of one set: most probable parameters, their covariance, and the evidence."""

    columns: Indices  # Columns of the set, tolerances last, (k,)
    step: Array  # Most probable values in units of scale or tolerance, (k,)
    covariance: Array  # Covariance of the normal approximation, (k, k)
    log_evidence: float = -np.inf
    log_likelihood: float = -np.inf  # That of the best parameters, with the priors of deviations and structures only


EMPTY_POSTERIOR = Posterior(columns=np.zeros(0, dtype=np.int64), step=np.zeros(0), covariance=np.zeros((0, 0)))
"""Posterior of a fit whose prediction is not finite."""


@dataclass(frozen=True, kw_only=True)
class Candidates:
    """Candidates of which sets consist."""

    columns: tuple[Indices, ...]  # Columns of each candidate
    tolerances: Indices  # Columns of the tolerances
    low: Array  # Lowest possible step of each column in units of scale, (K,); minus infinity without a bound
    high: Array  # Highest possible step, (K,)
    exclusive: tuple[str, ...]  # Name of each candidate; a set has at most one per name, of one start or rotor
    apart: frozenset[frozenset[str]] = frozenset()  # Pairs that exclude each other: a general effect and a narrower one
    structures: frozenset[int] = frozenset()  # Candidates that are structures, with normal priors

    def columns_of_set(self, model: Model) -> tuple[Indices, int]:
        """Return the columns of a set, effects first and tolerances last, and the number that belongs to effects."""
        own = [self.columns[k] for k in model if k not in self.structures]
        rest = [self.columns[k] for k in model if k in self.structures]
        count = sum(columns.size for columns in own)
        return np.concatenate([*own, *rest, self.tolerances]).astype(np.int64), count

    def without_tolerances(self) -> "Candidates":
        """Return the candidates after the tolerances have been integrated out."""
        return replace(self, tolerances=self.tolerances[:0])


def posterior(candidates: Candidates, normal: NormalEquations, model: Model) -> Posterior:
    """Return the posterior of one set's parameters, and its evidence by Laplace's approximation.

    The Cauchy prior is a normal prior whose precision depends on the parameter. Bounds multiply the evidence by the
    posterior's share within them over the prior's, exact for a single parameter with a normal prior; 0.56 instead of 1 for
    an unobservable one.
    """
    columns, count = candidates.columns_of_set(model)
    effects, start = np.arange(columns.size)[None] < count, np.zeros((1, columns.size))
    alone = normal.integrate_out(columns[count:], columns[:count])  # normal priors have a constant precision
    start[:, :count] = _posterior_modes(alone.product[None], alone.gradient[None], effects[:, :count])
    product, gradient = normal.product[columns[:, None], columns], normal.gradient[columns]
    step, covariance, log_evidence = _laplace_approximation(
        candidates, product[None], gradient[None], columns[None], effects, start=start
    )
    best = step[0]
    fits = gradient @ best - 0.5 * best @ product @ best
    evidence = normal.constant + float(log_evidence[0])
    likelihood = normal.constant + float(fits - 0.5 * best[count:] @ best[count:])
    return Posterior(
        columns=columns, step=best, covariance=covariance[0], log_evidence=evidence, log_likelihood=likelihood
    )


def log_evidences(candidates: Candidates, normal: NormalEquations, models: Sequence[Model]) -> Array:
    """Return the log evidence of each set, (M,), as in ``posterior``.

    Structures and tolerances are integrated out once for all sets that share them; for a set of structures only, just the
    tolerances. Sets with similar numbers of columns form a batch, padded with null columns.
    """
    alone = np.array([bool(model) and candidates.structures.issuperset(model) for model in models])
    places = [
        candidates.columns_of_set(model if own else tuple(k for k in model if k not in candidates.structures))[0]
        for model, own in zip(models, alone, strict=True)
    ]
    places = [columns[: columns.size - candidates.tolerances.size] for columns in places]
    widths, results = np.array([columns.size for columns in places]), np.empty(len(models))
    beside: dict[Model, list[int]] = {}
    for row, model in enumerate(models):
        shared = () if alone[row] else tuple(k for k in model if k in candidates.structures)
        beside.setdefault(shared, []).append(row)
    products, gradients = {}, {}
    wanted = {one: np.unique(np.concatenate([places[row] for row in rows])) for one, rows in beside.items()}
    for structures, reduced in _marginal_sums(candidates, normal, wanted).items():
        for row in beside[structures]:
            own = np.searchsorted(wanted[structures], places[row])
            products[row], gradients[row] = reduced.product[own[:, None], own], reduced.gradient[own]
            results[row] = reduced.constant
    free = replace(candidates, low=np.append(candidates.low, -np.inf), high=np.append(candidates.high, np.inf))
    for chunk in np.array_split(np.argsort(widths, kind="stable"), -(-len(models) // AT_ONCE)):
        width = int(widths[chunk[-1]])
        product, gradient = np.zeros((chunk.size, width, width)), np.zeros((chunk.size, width))
        indices = np.full((chunk.size, width), normal.gradient.size)
        for place, row in enumerate(chunk.tolist()):
            size = int(widths[row])
            product[place, :size, :size], gradient[place, :size] = products[row], gradients[row]
            indices[place, :size] = places[row]
        effects = (indices < normal.gradient.size) & ~alone[chunk, None]
        results[chunk] += _laplace_approximation(free, product, gradient, indices, effects)[2]
    return results


def _marginal_sums(
    candidates: Candidates, normal: NormalEquations, wanted: Mapping[Model, Indices]
) -> dict[Model, NormalEquations]:
    """Return the ``wanted`` columns with each set of structures, and the tolerances, integrated out, by single changes."""
    larger: dict[Model, list[Model]] = {}
    for one in wanted:
        for less in _subsets_with_one_less(one):
            larger.setdefault(less, []).append(one)
    beside = {one: [one, *larger.get(one, []), *_subsets_with_one_less(one)] for one in wanted}
    count = Counter(other for rivals in beside.values() for other in rivals)
    alike: dict[Model, list[Model]] = {}
    for one, rivals in beside.items():
        alike.setdefault(max(rivals, key=count.__getitem__), []).append(one)
    results: dict[Model, NormalEquations] = {}
    for centre, sets in alike.items():
        own = {one: _columns_of_candidates(candidates, set(one).symmetric_difference(centre)) for one in sets}
        kept = np.unique(np.concatenate([*own.values(), *(wanted[one] for one in sets)]))
        columns = np.concatenate((_columns_of_candidates(candidates, centre), candidates.tolerances))
        shared = MarginalSums(normal, columns, kept)
        for one, columns in own.items():
            if len(one) > len(centre):
                both = np.arange(columns.size + wanted[one].size)
                sums = shared.sums_of_columns(np.concatenate((columns, wanted[one])))
                results[one] = sums.integrate_out(both[: columns.size], both[columns.size :])
            elif len(one) < len(centre):
                results[one] = shared.sums_with_columns_at_zero(columns, wanted[one])
            else:
                results[one] = shared.sums_of_columns(wanted[one])
    return results


def _columns_of_candidates(candidates: Candidates, model: Iterable[int]) -> Indices:
    """Return the columns of some candidates."""
    return np.concatenate([*(candidates.columns[k] for k in model), np.zeros(0)]).astype(np.int64)


def _subsets_with_one_less(model: Model) -> list[Model]:
    """Return the subsets with one member less."""
    return [model[:place] + model[place + 1 :] for place in range(len(model))]


def _posterior_modes(product: Array, gradient: Array, effects: Flags, start: Array | None = None) -> Array:
    """Return the most probable steps (M, k) by iteration of the prior's precision until convergence."""
    step, unit = np.zeros(gradient.shape) if start is None else start.copy(), np.eye(gradient.shape[1])
    moving = np.arange(len(gradient))
    for _ in range(MOST_STEPS):
        inner = product[moving] + _prior_precision(step[moving], effects[moving])[..., None] * unit
        before, step[moving] = step[moving], np.linalg.solve(inner, gradient[moving][..., None])[..., 0]
        moving = moving[np.abs(step[moving] - before).max(axis=1, initial=0.0) >= CONVERGED]
        if not moving.size:
            break
    return step


def _prior_precision(step: Array, effects: Flags) -> Array:
    return np.where(effects, 2.0 / (1.0 + step**2), 1.0)


def _laplace_approximation(
    candidates: Candidates, product: Array, gradient: Array, columns: Indices, effects: Flags, *,
    start: Array | None = None,
) -> tuple[Array, Array, Array]:  # fmt: skip
    """Return steps (M, k), covariances (M, k, k) and log evidences (M,) up to a constant, of equations (M, k, k), (M, k).

    ``effects`` (M, k): columns with Cauchy priors and bounds; others have normal priors. ``start``: initial steps (M, k).
    """
    step = _posterior_modes(product, gradient, effects, start)
    precision, unit = _prior_precision(step, effects), np.eye(columns.shape[1])
    inner = product + precision[..., None] * unit
    covariance = np.linalg.inv(inner)
    log_prior = np.where(effects, -np.log(np.pi * (1.0 + step**2)), -0.5 * (step**2 + LOG_2PI)).sum(axis=1)
    log_likelihood = (gradient * step).sum(axis=1) - 0.5 * np.einsum("mk,mkl,ml->m", step, product, step)
    log_volume = 0.5 * (columns.shape[1] * LOG_2PI - np.linalg.slogdet(inner)[1])
    bounded = effects & (np.isfinite(candidates.low) | np.isfinite(candidates.high))[columns]
    within = np.zeros(columns.shape)
    if bounded.any():
        low, high = candidates.low[columns[bounded]], candidates.high[columns[bounded]]
        std = np.sqrt(np.diagonal(covariance, axis1=1, axis2=2)[bounded])
        away = step[bounded]
        log_share = np.log((np.arctan(high) - np.arctan(low)) / np.pi)  # of the Cauchy prior
        within[bounded] = _log_normal_interval((low - away) / std, (high - away) / std) - log_share
    return step, covariance, log_likelihood + log_prior + log_volume + within.sum(axis=1)


def _log_normal_interval(low: Array, high: Array) -> Array:
    """Return the log probability of a standard normal variable between two bounds."""
    flip = low > 0.0  # the lower tail is accurate
    low, high = np.where(flip, -high, low), np.where(flip, -low, high)
    top, bottom = log_ndtr(high), log_ndtr(low)
    return top + np.log1p(-np.exp(np.minimum(bottom - top, -1e-15)))
