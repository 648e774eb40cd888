"""The selection on many weightings of the same blocks at once, in a model that is linear in every candidate.

What decides on most candidates are sums over a fold, of which there are few; single blocks are looked at only where these
leave a candidate in. Letters: N resamples, B blocks, C channels, K columns, k columns of one model, F folds (flights, or
quarters of a single one), A parts (folds if these are drawn whole, else blocks).
"""

from itertools import combinations

import numpy as np
from numpy.typing import NDArray
from scipy import stats

from aerial_gym.sim2real.identify.least_squares.gauss_newton import FARTHEST_DEVIATION, WEAK_PRIOR
from aerial_gym.sim2real.identify.least_squares.moments import Moments
from aerial_gym.sim2real.identify.selection.library import Library
from aerial_gym.sim2real.identify.selection.scoring import LEAST_SCORE, is_relief, rises
from aerial_gym.sim2real.identify.selection.select import Selection

Array = NDArray[np.float64]
Indices = NDArray[np.int64]
Mask = NDArray[np.bool_]
Model = tuple[int, ...]
"""Places of the candidates that are in it."""

MOST_ROUNDS = 12


class _Parts:
    """Moments of parts that lie fold after fold, and the squares that steps of some columns leave of them."""

    def __init__(self, moments: Moments, fold: Indices, weight: Array) -> None:
        self.moments = moments
        ends = np.flatnonzero(np.diff(fold, append=fold[-1] + 1)) + 1
        self.folds = [slice(int(a), int(b)) for a, b in zip([0, *ends[:-1]], ends, strict=True)]
        self.product = np.einsum("c,bckl->bkl", weight, moments.product)
        self.gradient = np.einsum("c,bck->bk", weight, moments.gradient)

    def normal(self, columns: Indices) -> tuple[Array, Array]:
        """Return the weighted products (A, k, k) and gradients (A, k) of some columns."""
        return self.product[:, columns[:, None], columns], self.gradient[:, columns]

    def squares_after(self, columns: Indices, step: Array) -> Array:
        """Return the squares of each part under the step of its fold, (n, A, C); steps are (F, n, k)."""
        size, num_channels, width = *self.moments.square.shape, self.gradient.shape[1]
        first, second = np.triu_indices(columns.size)
        twice, places = np.where(first == second, 1.0, 2.0), columns[first] * width + columns[second]
        found = np.empty((step.shape[1], size, num_channels))
        for own, steps in zip(self.folds, step, strict=True):
            product = self.moments.product[own].reshape(-1, width * width).take(places, axis=1)
            gradient = self.moments.gradient[own].reshape(-1, width).take(columns, axis=1)
            change = (steps[:, first] * steps[:, second] * twice) @ product.T - 2.0 * steps @ gradient.T
            found[:, own] = self.moments.square[own] + change.reshape(len(steps), -1, num_channels)
        return found


class Fitted:
    """A model fitted to some resamples, each fold predicted by the fit of the others."""

    def __init__(
        self, model: Model, members: Indices, columns: Indices, step: Array, totals: Array, blocks: int
    ) -> None:
        """Take the steps (F, n, k) of the resamples ``members`` (n,), and the squares drawn of each fold, (F, n, C)."""
        self.model, self.members, self.columns, self.step, self.totals = model, members, columns, step, totals
        self.likelihood = np.full((members.size, blocks), np.nan)
        """Log likelihood of each block, (n, B); not a number where nobody has asked for it."""
        self.others: tuple[Array, Array] | None = None
        """Products and gradients of all folds but each one, once they have been asked for."""

    def penalty(self, num_tolerances: int) -> Array:
        """Return what the deviations cost in log likelihood, (n,): half the squared sum of their mean over the folds."""
        return 0.5 * (self.step[..., -num_tolerances:].mean(axis=0) ** 2).sum(axis=-1)

    def part(self, places: Indices) -> "Fitted":
        """Return the fit to some of the resamples."""
        found = Fitted(
            self.model,
            self.members[places],
            self.columns,
            self.step[:, places],
            self.totals[:, places],
            self.likelihood.shape[1],
        )
        found.likelihood = self.likelihood[places]
        return found


class LinearSelector:
    """Chooses candidates for each resample by the criteria of the selection."""

    def __init__(self, library: Library, selection: Selection, draws: Array) -> None:
        """Take how often each block is drawn in each resample, (N, B)."""
        self.candidates, self.tolerances, self.draws = library.candidates, library.tolerances, draws
        self.criteria, self.weights = selection.criteria, selection.weights
        self.tolerated, fold = selection.left_out.tolerated, selection.left_out.fold
        self.named = [k for k, candidate in enumerate(self.candidates) if candidate.named]
        self._blocks = _Parts(library.moments, fold, self.weights.weight)
        whole = all(np.ptp(draws[:, own], axis=1).max() == 0.0 for own in self._blocks.folds)
        together = fold if whole else np.arange(fold.size)
        first = np.unique(together, return_index=True)[1]
        self._parts = (
            _Parts(library.moments.joined(together), fold[first], self.weights.weight) if whole else self._blocks
        )
        self._counts = draws[:, first]

    def select(self) -> list[Model]:
        """Return the model that each resample ends with."""
        models: list[Model] = [()] * len(self.draws)
        active = np.ones(len(self.draws), dtype=bool)
        for _ in range(MOST_ROUNDS):
            for model in {models[n] for n in np.flatnonzero(active)}:
                members = np.array([n for n in np.flatnonzero(active) if models[n] == model])
                for n, chosen in zip(members, self._grow(model, members), strict=True):
                    active[n] = chosen != model
                    models[n] = chosen
            if not active.any():
                break
        return models

    def _grow(self, model: Model, members: Indices) -> list[Model]:
        """Return the model after one more round, of each of some resamples."""
        taken = {self.candidates[k].name for k in model}
        others = [k for k in range(len(self.candidates)) if self.candidates[k].name not in taken]
        less, grown = self.fit(model, members), [model] * members.size
        trials = [self.fit((*model, k), members) for k in others]
        passed = np.array([self.passes(less, trial, k) for k, trial in zip(others, trials, strict=True)])
        for n in np.flatnonzero(passed.any(axis=0)) if others else ():
            able, drawn = np.flatnonzero(passed[:, n]), self.draws[members[n]]
            like = np.stack([self._likelihood(trials[i], np.array([n]))[0] for i in able])  # (candidates, B)
            penalty = np.array([trials[i].penalty(self.tolerances.size)[n] for i in able])
            total, size = like @ drawn - penalty, np.array([self.candidates[others[i]].complexity for i in able])
            best = int(total.argmax())
            p_value = p_value_of(like[best] - like, np.broadcast_to(drawn, like.shape))
            p_value = np.minimum(1.0, p_value * np.exp(np.minimum(penalty[best] - penalty, 700.0)))
            tied = (p_value > self.criteria.rival_significance) | (total[best] - total < LEAST_SCORE)
            tied[best] = True
            grown[n] = (*model, others[able[np.lexsort((-total, np.where(tied, size, 99)))[0]]])
        alone = np.array([after == model for after in grown])
        if alone.any():
            pairs = self._pairs(model, members[alone])
            for n, pair in zip(np.flatnonzero(alone), pairs, strict=True):
                grown[n] = (*model, *pair)
        return self._prune(grown, len(model), members)

    def _pairs(self, model: Model, members: Indices) -> list[Model]:
        """Return two named effects that hold together where none holds alone, of each resample; empty where none do."""
        found: list[Model] = [()] * members.size
        for one, other in combinations([k for k in self.named if k not in model], 2):
            more = self.fit((*model, one, other), members)
            holds = np.ones(members.size, dtype=bool)
            for k, rest in ((one, other), (other, one)):
                if holds.any():
                    holds &= self.passes(self.fit((*model, rest), members), more, k)
            for n in np.flatnonzero(holds):
                found[n] = found[n] or (one, other)
        return found

    def _prune(self, grown: list[Model], old: int, members: Indices) -> list[Model]:
        """Return the models without those of their first ``old`` effects that no longer pay, harm aside."""
        result = list(grown)
        for model in {m for m in grown if len(m) > old}:
            places = np.array([n for n, m in enumerate(grown) if m == model])
            more = self.fit(model, members[places])
            for k in model[:old]:
                less = self.fit(tuple(other for other in model if other != k), members[places])
                for n in places[~self.passes(less, more, k, harm=False)]:
                    result[n] = tuple(other for other in result[n] if other != k)
        return result

    def fit(self, model: Model, members: Indices) -> Fitted:
        """Return a model fitted to some resamples, each fold left out once."""
        columns = self._columns(model)
        step = self._solve(model, *self._sums_of_others(columns, members))
        return self._fitted(model, members, columns, step)

    def _sums_of_others(self, columns: Indices, members: Indices) -> tuple[Array, Array]:
        """Return the weighted products (F, n, k, k) and gradients (F, n, k) of all folds but each one."""
        counts, folds = self._counts[members], self._parts.folds
        product, gradient = self._parts.normal(columns)
        normal = np.stack([np.tensordot(counts[:, own], product[own], axes=1) for own in folds])
        right = np.stack([counts[:, own] @ gradient[own] for own in folds])
        return normal.sum(axis=0) - normal, right.sum(axis=0) - right

    def _fitted(self, model: Model, members: Indices, columns: Indices, step: Array) -> Fitted:
        """Return a model with its steps and the squares that they leave of each fold."""
        counts, squares = self._counts[members], self._parts.squares_after(columns, step)
        totals = np.stack([np.einsum("na,nac->nc", counts[:, own], squares[:, own]) for own in self._parts.folds])
        return Fitted(model, members, columns, step, totals, self.draws.shape[1])

    def _fit_beside(self, less: Fitted, more: Fitted, places: Indices) -> Fitted:
        """Return a model fitted to some resamples, each fold with the deviations that another model asks for."""
        if less.others is None:
            less.others = self._sums_of_others(less.columns, less.members)
        normal, right = (sums[:, places] for sums in less.others)
        own, deviation = less.columns.size - self.tolerances.size, more.step[:, places, -self.tolerances.size :]
        pull = right[..., :own] - np.einsum("fnkl,fnl->fnk", normal[..., :own, own:], deviation)
        step = np.concatenate((self._solve(less.model, normal[..., :own, :own], pull), deviation), axis=-1)
        return self._fitted(less.model, more.members[places], less.columns, step)

    def squares(self, fitted: Fitted, places: Indices) -> Array:
        """Return the squares of each block in some of the resamples of a fit, (n, B, C)."""
        return self._blocks.squares_after(fitted.columns, fitted.step[:, places])

    def _columns(self, model: Model) -> Indices:
        """Return the columns of the candidates of a model, and those of the tolerances behind them."""
        return np.concatenate([*(self.candidates[k].columns for k in model), self.tolerances])

    def _precision(self, columns: Indices) -> Array:
        """Return the inverse prior variance of each column: one for tolerances, almost none for effects."""
        return np.where(np.isin(columns, self.tolerances), 1.0, WEAK_PRIOR**-2)

    def _solve(self, model: Model, product: Array, gradient: Array) -> Array:
        """Return the steps (..., k) that fit products (..., k, k) and gradients (..., k), held within bounds.

        The k columns are the first ones of a model: all of them, or those of its candidates alone.
        """
        size = gradient.shape[-1]
        farthest = np.full(self.tolerances.size, FARTHEST_DEVIATION)
        low = np.concatenate([*(self.candidates[k].low for k in model), -farthest])[:size]
        high = np.concatenate([*(self.candidates[k].high for k in model), farthest])[:size]
        normal = product + np.diag(self._precision(self._columns(model)[:size]))
        step = np.linalg.solve(normal, gradient[..., None])[..., 0]
        outside = (step < low) | (step > high)
        bounded = outside.any(axis=-1)
        if bounded.any():  # by a stiff spring at the bound
            spring = np.where(outside[bounded], 1e9 * np.diagonal(normal[bounded], axis1=-2, axis2=-1), 0.0)
            stiff = normal[bounded] + spring[..., None] * np.eye(size)
            pull = gradient[bounded] + spring * np.clip(step[bounded], low, high)
            step[bounded] = np.linalg.solve(stiff, pull[..., None])[..., 0]
        return np.clip(step, low, high)

    def _likelihood(self, fitted: Fitted, places: Indices) -> Array:
        """Return the log likelihood of each block up to a constant, (n, B), in some of the resamples of a fit."""
        new = places[np.isnan(fitted.likelihood[places, 0])]
        if new.size:
            samples = 0.5 * self._blocks.moments.count[:, None] * self.weights.effective
            logs = np.log(np.maximum(self.squares(fitted, new), 1e-300))
            fitted.likelihood[new] = -(samples * logs).sum(axis=-1)
        return fitted.likelihood[places]

    def passes(self, less: Fitted, more: Fitted, tried: int, *, harm: bool = True) -> Mask:
        """Return in which resamples a candidate of ``more`` is acceptable on top of ``less``, (n,)."""
        relieved, passes = self._relieves(less, more), np.zeros(more.members.size, dtype=bool)
        places = np.flatnonzero(relieved | (self._falls(less, more).max(axis=1) >= self.criteria.material))
        if not places.size:
            return passes
        self._likelihood(less, np.arange(passes.size))  # kept: the next candidate needs it as well
        equal = self._fit_beside(less, more, places)
        for chosen, before in ((~relieved[places], less.part(places)), (relieved[places], equal)):
            some = np.flatnonzero(chosen)
            if some.size:
                fitted = before.part(some), more.part(places[some]), equal.part(some)
                passes[places[some]] = self._passes(*fitted, tried, harm)
        return passes

    def _falls(self, less: Fitted, more: Fitted) -> Array:
        """Return the relative fall of the residual (rms) of each channel, (n, C)."""
        return 1.0 - np.sqrt(more.totals.sum(axis=0) / np.maximum(less.totals.sum(axis=0), 1e-300))

    def _relieves(self, less: Fitted, more: Fitted) -> Mask:
        """Return in which resamples a model needs clearly smaller deviations than another, (n,)."""
        before, after = (fitted.penalty(self.tolerances.size) for fitted in (less, more))
        return is_relief(before - after, more.columns.size - less.columns.size, self.criteria)

    def _passes(self, less: Fitted, more: Fitted, equal: Fitted, tried: int, harm: bool) -> Mask:
        """Return the same by the squares of ``less``, what is visible by those with the deviations of ``more``, (n,)."""
        rules, counts, folds = self.criteria, self._counts[more.members], self._parts.folds
        rows = np.stack([counts[:, own] @ self._parts.moments.count[own] for own in folds])  # (F, n)
        drawn = np.stack([self.draws[more.members, own].sum(axis=1) for own in self._blocks.folds])
        after, largest = (fitted.totals.sum(axis=0) / rows.sum(axis=0)[:, None] for fitted in (more, equal))
        seen = largest - after > (rules.visible * self.tolerated) ** 2
        passes = (self._falls(less, more) * seen).max(axis=1) >= rules.material
        ratio = np.log(np.maximum(less.totals, 1e-300) / np.maximum(more.totals, 1e-300))  # (F, n, C)
        better = drawn * (ratio @ self.weights.effective > 0.0)
        changed = drawn * (np.abs(ratio) > 2.0 * np.log1p(rules.harmless)).any(axis=2)
        few = (changed > 0.0).sum(axis=0) < 2
        judged = np.where((changed > 0.0) | few, 1.0, 0.0)
        weight = drawn.sum(axis=0)
        passes &= (judged * better).sum(axis=0) >= rules.flights_better * np.where(few, weight, changed.sum(axis=0))
        if harm:
            harmed = (drawn[..., None] * self._rises(less.totals, more.totals, rows)).sum(axis=0)
            whole = less.totals.sum(axis=0), more.totals.sum(axis=0), rows.sum(axis=0)
            passes &= ~self._rises(*whole).any(axis=1)
            passes &= harmed.max(axis=1) <= (1.0 - rules.flights_better) * weight
        if passes.any():
            places = np.flatnonzero(passes)
            gain = self._likelihood(more, places) - self._likelihood(less, places)
            passes[places] = p_value_of(gain, self.draws[more.members[places]]) <= rules.left_out_significance
        if passes.any():
            passes[passes] = self._stands_out(more.model, more.members[passes], tried)
        return passes

    def _rises(self, less: Array, more: Array, rows: Array) -> Mask:
        return rises(less, more, rows, self.weights.effective, self.tolerated, self.criteria)

    def _stands_out(self, model: Model, members: Indices, tried: int) -> Mask:
        """Return where a candidate's step is beyond noise and tolerances and at no bound but neutral, (n,)."""
        columns, own, draws = self._columns(model), self.candidates[tried].columns, self.draws[members]
        places = np.flatnonzero(np.isin(columns, own))
        product, gradient = self._parts.normal(columns)
        product, right = np.tensordot(self._counts[members], product, axes=1), self._counts[members] @ gradient
        step = self._solve(model, product, right)
        bread = np.linalg.inv(product + np.diag(self._precision(columns)))
        product, gradient = self._blocks.normal(columns)
        change = np.moveaxis(product @ step.T, -1, 0)  # (n, B, k)
        scores = np.sqrt(draws)[:, :, None] * (gradient - change)
        count = draws.sum(axis=1)
        meat = scores.transpose(0, 2, 1) @ scores * (count / (count - 1.0))[:, None, None]
        plain = np.diagonal(bread, axis1=1, axis2=2)[:, :, None] * np.eye(columns.size)
        spread = bread @ meat @ bread + (bread * self._precision(columns)) @ bread + 1e-9 * plain
        distance = step[:, places]
        solved = np.linalg.solve(spread[:, places[:, None], places], distance[..., None])[..., 0]
        value = (distance * solved).sum(axis=1) / places.size
        probability = stats.f.sf(value, places.size, np.maximum(count - places.size, 1.0))
        low, high = self.candidates[tried].low, self.candidates[tried].high
        at_low = (distance <= low + 1e-3) & (low < -1e-3)
        at_high = (distance >= high - 1e-3) & (high > 1e-3)
        return (probability <= self.criteria.significance) & ~(at_low | at_high).any(axis=1)


def p_value_of(gain: Array, draws: Array) -> Array:
    """Return the probability that a mean gain of blocks (N, B), drawn so often, is chance, (N,)."""
    count = draws.sum(axis=1)
    mean = (draws * gain).sum(axis=1) / count
    variance = (draws * (gain - mean[:, None]) ** 2).sum(axis=1) / np.maximum(count - 1.0, 1.0)
    return stats.t.sf(mean / np.sqrt(np.maximum(variance / count, 1e-300)), np.maximum(count - 1.0, 1.0))
