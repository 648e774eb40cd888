"""The selection on many weightings of the same blocks at once, in a model that is linear in every candidate.

Letters: N resamples, B blocks, C channels, K columns, F folds (flights, or quarters of a single one).
"""

from itertools import combinations

import numpy as np
from numpy.typing import NDArray
from scipy import stats

from aerial_gym.sim2real.candidates import Library
from aerial_gym.sim2real.fit import FARTHEST_DEVIATION, WEAK_PRIOR
from aerial_gym.sim2real.scoring import LEAST_SCORE
from aerial_gym.sim2real.selection import Selection

Array = NDArray[np.float64]
Indices = NDArray[np.int64]
Mask = NDArray[np.bool_]
Model = tuple[int, ...]
"""Places of the candidates that are in it."""

MOST_ROUNDS = 12


class LinearSelector:
    """Chooses candidates for each resample by the criteria of the selection."""

    def __init__(self, library: Library, selection: Selection) -> None:
        self.candidates, self.moments, self.tolerances = library.candidates, library.moments, library.tolerances
        self.criteria, self.weights = selection.criteria, selection.weights
        self.tolerated, self.fold = selection.left_out.tolerated, selection.left_out.fold
        self.named = [k for k, candidate in enumerate(self.candidates) if candidate.named]
        self._product = np.einsum("c,bckl->bkl", self.weights.weight, self.moments.product)
        self._gradient = np.einsum("c,bck->bk", self.weights.weight, self.moments.gradient)

    def select(self, draws: Array) -> list[Model]:
        """Return the model that each resample (N, B) ends with."""
        models: list[Model] = [()] * len(draws)
        active = np.ones(len(draws), dtype=bool)
        for _ in range(MOST_ROUNDS):
            for model in {models[n] for n in np.flatnonzero(active)}:
                members = np.array([n for n in np.flatnonzero(active) if models[n] == model])
                for n, chosen in zip(members, self._grow(model, draws[members]), strict=True):
                    active[n] = chosen != model
                    models[n] = chosen
            if not active.any():
                break
        return models

    def _grow(self, model: Model, draws: Array) -> list[Model]:
        """Return the model after one more round, of each resample."""
        taken = {self.candidates[k].name for k in model}
        others = [k for k in range(len(self.candidates)) if self.candidates[k].name not in taken]
        less = self.squares(model, draws)
        trials = [self.squares((*model, k), draws) for k in others]
        passed = np.array(
            [self.passes(less, trial, draws, (*model, k), k) for k, trial in zip(others, trials, strict=True)]
        )
        grown: list[Model] = [model] * len(draws)
        if len(others):
            like = np.stack([self._likelihood(trial) for trial in trials])  # (candidates, N, B)
            total = np.where(passed, np.einsum("knb,nb->kn", like, draws), -np.inf)
            size = np.array([self.candidates[k].columns.size for k in others])
            for n, best in enumerate(total.argmax(axis=0)):
                if passed[best, n]:
                    probability = chance_of(like[best, n] - like[:, n], np.broadcast_to(draws[n], like[:, n].shape))
                    tied = passed[:, n] & (
                        (probability > self.criteria.rival_significance) | (total[best, n] - total[:, n] < LEAST_SCORE)
                    )
                    tied[best] = True
                    order = np.lexsort((-total[:, n], np.where(tied, size, 99)))
                    grown[n] = (*model, others[order[0]])
        alone = np.array([after == model for after in grown])
        if alone.any():
            pairs = self._pairs(model, draws[alone])
            for n, pair in zip(np.flatnonzero(alone), pairs, strict=True):
                grown[n] = (*model, *pair)
        return self._prune(grown, len(model), draws)

    def _pairs(self, model: Model, draws: Array) -> list[Model]:
        """Return two named effects that hold together where none holds alone, of each resample; empty where none do."""
        found: list[Model] = [()] * len(draws)
        for one, other in combinations([k for k in self.named if k not in model], 2):
            both = (*model, one, other)
            more = self.squares(both, draws)
            holds = np.ones(len(draws), dtype=bool)
            for k, rest in ((one, other), (other, one)):
                holds &= self.passes(self.squares((*model, rest), draws), more, draws, both, k)
            for n in np.flatnonzero(holds):
                found[n] = found[n] or (one, other)
        return found

    def _prune(self, grown: list[Model], old: int, draws: Array) -> list[Model]:
        """Return the models without those of their first ``old`` effects that no longer pay, harm aside."""
        result = list(grown)
        for model in {m for m in grown if len(m) > old}:
            members = np.array([n for n, m in enumerate(grown) if m == model])
            more = self.squares(model, draws[members])
            for k in model[:old]:
                kept = tuple(other for other in model if other != k)
                pays = self.passes(self.squares(kept, draws[members]), more, draws[members], model, k, harm=False)
                for n in members[~pays]:
                    result[n] = tuple(other for other in result[n] if other != k)
        return result

    def _columns(self, model: Model) -> Indices:
        """Return the columns of the candidates of a model, and those of the tolerances behind them."""
        return np.concatenate([*(self.candidates[k].columns for k in model), self.tolerances])

    def _precision(self, columns: Indices) -> Array:
        """Return the inverse prior variance of each column: one for tolerances, almost none for effects."""
        return np.where(np.isin(columns, self.tolerances), 1.0, WEAK_PRIOR**-2)

    def _solve(self, model: Model, counts: Array) -> tuple[Array, Array]:
        """Return the steps (N, k) that fit the blocks counted (N, B), held within bounds, and the normal matrix (N, k, k)."""
        columns = self._columns(model)
        farthest = np.full(self.tolerances.size, FARTHEST_DEVIATION)
        low = np.concatenate([*(self.candidates[k].low for k in model), -farthest])
        high = np.concatenate([*(self.candidates[k].high for k in model), farthest])
        part = self._product[:, columns[:, None], columns]
        normal = np.tensordot(counts, part, axes=1) + np.diag(self._precision(columns))
        gradient = counts @ self._gradient[:, columns]
        step = np.linalg.solve(normal, gradient[..., None])[..., 0]
        outside = (step < low) | (step > high)
        if outside.any():  # held at the bound by a stiff spring
            spring = np.where(outside, 1e9 * np.diagonal(normal, axis1=1, axis2=2), 0.0)
            held = normal + spring[:, :, None] * np.eye(columns.size)
            step = np.linalg.solve(held, (gradient + spring * np.clip(step, low, high))[..., None])[..., 0]
        return np.clip(step, low, high), normal

    def squares(self, model: Model, draws: Array) -> Array:
        """Return the squares of each block under the fit of the other folds, (N, B, C)."""
        columns = self._columns(model)
        found = np.repeat(self.moments.square[None], len(draws), axis=0)
        for label in np.unique(self.fold):
            own = np.flatnonzero(self.fold == label)
            step, _ = self._solve(model, draws * (self.fold != label))
            linear = np.einsum("bck,nk->nbc", self.moments.gradient[own][:, :, columns], step)
            outer = (step[:, :, None] * step[:, None, :]).reshape(len(draws), -1)
            part = self.moments.product[own][:, :, columns[:, None], columns].reshape(-1, columns.size**2)
            found[:, own] += (outer @ part.T).reshape(len(draws), own.size, -1) - 2.0 * linear
        return found

    def _likelihood(self, squares: Array) -> Array:
        """Return the log likelihood of each block up to a constant, (N, B)."""
        samples = 0.5 * self.moments.count[:, None] * self.weights.effective
        return -(samples * np.log(np.maximum(squares, 1e-300))).sum(axis=-1)

    def passes(self, less: Array, more: Array, draws: Array, model: Model, tried: int, *, harm: bool = True) -> Mask:
        """Return in which resamples a candidate of a model is acceptable, (N,): squares without and with it (N, B, C)."""
        rules = self.criteria
        probability = chance_of(self._likelihood(more) - self._likelihood(less), draws)
        before, after, rows = self._totals(less, draws), self._totals(more, draws), draws @ self.moments.count
        fall = 1.0 - np.sqrt(after / np.maximum(before, 1e-300))
        seen = (before - after) / rows[:, None] > (rules.visible * self.tolerated) ** 2
        passes = (probability <= rules.left_out_significance) & ((fall * seen).max(axis=1) >= rules.material)
        harmed, weight = np.zeros(before.shape), np.zeros(len(draws))
        better, changed = [], []
        for label in np.unique(self.fold):
            own = draws * (self.fold == label)
            drawn, count = own.sum(axis=1), np.maximum(own @ self.moments.count, 1.0)
            one, other = self._totals(less, own), self._totals(more, own)
            ratio = np.log(np.maximum(one, 1e-300) / np.maximum(other, 1e-300))
            better.append(drawn * ((self.weights.effective * ratio).sum(axis=1) > 0.0))
            changed.append(drawn * (np.abs(ratio) > 2.0 * np.log1p(rules.harmless)).any(axis=1))
            harmed += drawn[:, None] * self._rises(one / count[:, None], other / count[:, None])
            weight += drawn
        few = (np.array(changed) > 0.0).sum(axis=0) < 2
        judged = np.where((np.array(changed) > 0.0) | few, 1.0, 0.0)
        drawn = np.where(few, weight, np.sum(changed, axis=0))
        passes &= (judged * better).sum(axis=0) >= rules.flights_better * drawn
        if harm:
            passes &= ~self._rises(before / rows[:, None], after / rows[:, None]).any(axis=1)
            passes &= harmed.max(axis=1) <= (1.0 - rules.flights_better) * weight
        if passes.any():
            passes[passes] &= self._stands_out(model, draws[passes], tried)
        return passes

    def _totals(self, squares: Array, draws: Array) -> Array:
        return np.einsum("nb,nbc->nc", draws, squares)

    def _rises(self, before: Array, after: Array) -> Mask:
        more = after > (1.0 + self.criteria.harmless) ** 2 * before
        return more & (after - before > self.tolerated**2)

    def _stands_out(self, model: Model, draws: Array, tried: int) -> Mask:
        """Return where a candidate's step is beyond noise and tolerances and at no bound but neutral, (N,)."""
        columns, own = self._columns(model), self.candidates[tried].columns
        places = np.flatnonzero(np.isin(columns, own))
        step, normal = self._solve(model, draws)
        bread = np.linalg.inv(normal)
        change = np.einsum("bkl,nl->nbk", self._product[:, columns[:, None], columns], step)
        scores = np.sqrt(draws)[:, :, None] * (self._gradient[None][:, :, columns] - change)
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


def chance_of(gain: Array, draws: Array) -> Array:
    """Return the probability that a mean gain of blocks (N, B), drawn so often, is chance, (N,)."""
    count = draws.sum(axis=1)
    mean = (draws * gain).sum(axis=1) / count
    variance = (draws * (gain - mean[:, None]) ** 2).sum(axis=1) / np.maximum(count - 1.0, 1.0)
    return stats.t.sf(mean / np.sqrt(np.maximum(variance / count, 1e-300)), np.maximum(count - 1.0, 1.0))
