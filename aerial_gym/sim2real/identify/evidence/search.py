"""Posterior over sets of effects, and the search for the most probable sets.

Sets compete, so two effects that fit only together are found as a pair, and indistinguishable ones share the probability.

Source: Scott, Berger (2010), Bayes and empirical-Bayes multiplicity adjustment in the variable-selection problem, Annals of
Statistics 38 (dependence of a set's prior on the number of available effects).
"""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from itertools import combinations

import numpy as np
from scipy.special import logsumexp

from aerial_gym.sim2real.arrays import Array
from aerial_gym.sim2real.identify.evidence.laplace import Candidates, Model, NormalEquations, log_evidences


@dataclass
class SetPosterior:
    """Posterior over the sets evaluated by a search; a set of n effects has the prior ``1 / m**n`` for m names."""

    candidates: Candidates
    normal: NormalEquations
    log_posterior: dict[Model, float] = field(default_factory=dict)  # Of each evaluated set, up to a constant

    @cached_property
    def log_prior_cost_of_effect(self) -> float:
        """Return the prior cost of one more effect, ``log m``."""
        names = {name for k, name in enumerate(self.candidates.exclusive) if k not in self.candidates.structures}
        return float(np.log(max(1, len(names))))

    def log_posteriors(self, models: Iterable[Model]) -> Array:
        """Return the log posterior of sets up to a constant, (M,); minus infinity for exclusive candidates."""
        keys = [tuple(sorted(model)) for model in models]
        new = [key for key in dict.fromkeys(keys) if key not in self.log_posterior and self._is_allowed(key)]
        if new:
            log_sums = log_evidences(self.candidates, self.normal, new)
            for key, value in zip(new, log_sums.tolist(), strict=True):
                self.log_posterior[key] = value - self.log_prior_cost_of_effect * len(key)
        return np.array([self.log_posterior.get(key, -np.inf) for key in keys])

    def _is_allowed(self, model: Model) -> bool:
        names = {self.candidates.exclusive[k] for k in model}
        return len(names) == len(model) and not any(pair <= names for pair in self.candidates.apart)

    @property
    def most_probable_set(self) -> Model:
        """Return the most probable set."""
        return max(self.log_posterior, key=self.log_posterior.__getitem__)

    def probabilities(self) -> dict[Model, float]:
        """Return the probability of each evaluated set, the most probable first."""
        models = sorted(self.log_posterior, key=self.log_posterior.__getitem__, reverse=True)
        logs = np.array([self.log_posterior[model] for model in models])
        return dict(zip(models, np.exp(logs - logsumexp(logs)).tolist(), strict=True))

    def inclusion(self) -> dict[str, float]:
        """Return the posterior inclusion probability of each effect by name."""
        log_sums = dict.fromkeys(self.candidates.exclusive, 0.0)
        for model, probability in self.probabilities().items():
            for k in model:
                log_sums[self.candidates.exclusive[k]] += probability
        return log_sums


MOST_STARTS = 3  # Number of sets from which the search starts, the best with none, one and two effects


def search_sets(candidates: Candidates, normal: NormalEquations, *, starts: Sequence[Model] = ()) -> SetPosterior:
    """Return the posterior over sets around the most probable ones.

    All singles and pairs are evaluated. From the best of these and from ``starts``, effects are added and removed while
    that helps; from the best result, swaps are tried as well.
    """
    reduced, once = candidates.without_tolerances(), normal.marginal(candidates.tolerances)
    sets, places = SetPosterior(candidates=reduced, normal=once), range(len(candidates.columns))
    sets.log_posteriors([(), *combinations(places, 1), *combinations(places, 2)])
    first = sorted(sets.log_posterior, key=sets.log_posterior.__getitem__, reverse=True)[:MOST_STARTS]
    for start in (*starts, *first):
        _climb_to_best_set(sets, tuple(sorted(start)), (sets_with_one_change,))
    _climb_to_best_set(sets, sets.most_probable_set, (sets_with_one_change, sets_with_one_swap))
    return sets


def _climb_to_best_set(sets: SetPosterior, model: Model, ways: Sequence[Callable[[Model, int], list[Model]]]) -> None:
    """Move to the best neighbour of a set while it is more probable; try the kinds of change in order."""
    count = len(sets.candidates.columns)
    here = float(sets.log_posteriors([model])[0])
    while True:
        for way in ways:
            neighbours = way(model, count)
            values = sets.log_posteriors(neighbours)
            if values.size and values.max() > here:
                model, here = neighbours[int(values.argmax())], float(values.max())
                break
        else:
            return


def sets_with_one_change(model: Model, count: int) -> list[Model]:
    """Return the sets with one candidate more or less."""
    more = [tuple(sorted((*model, k))) for k in range(count) if k not in model]
    return more + [tuple(k for k in model if k != gone) for gone in model]


def sets_with_one_swap(model: Model, count: int) -> list[Model]:
    """Return the sets with one candidate replaced by another."""
    absent = [k for k in range(count) if k not in model]
    return [tuple(sorted((*(k for k in model if k != gone), other))) for gone in model for other in absent]
