"""The posterior over sets of effects, and the search for the most probable ones.

Sets compete, not single effects: two that only together mend what each alone would spoil are found as a pair, one that
another has made superfluous goes when it no longer pays, and what cannot be told apart shares the probability.

Source: Scott, Berger (2010), Bayes and empirical-Bayes multiplicity adjustment in the variable-selection problem, Annals of
Statistics 38 (why the prior of a set depends on how many effects there are to choose from).
"""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from itertools import combinations

import numpy as np
from scipy.special import logsumexp

from aerial_gym.sim2real.arrays import Array
from aerial_gym.sim2real.identify.evidence.laplace import Candidates, Model, Normal, log_evidences


@dataclass
class Sets:
    """The posterior over the sets that a search has looked at.

    A set of n effects has the prior ``1 / m**n`` for m names: one undeclared effect among all names is expected, so that a
    long list does not find something by its length alone.
    """

    candidates: Candidates
    normal: Normal
    log_posterior: dict[Model, float] = field(default_factory=dict)
    """Up to a constant."""

    @cached_property
    def log_names(self) -> float:
        """Return what one more effect costs before the flights are seen."""
        names = {name for k, name in enumerate(self.candidates.exclusive) if k not in self.candidates.structures}
        return float(np.log(max(1, len(names))))

    def log_posterior_of(self, models: Iterable[Model]) -> Array:
        """Return the log posterior of sets up to a constant, (M,); minus infinity for two candidates of one name."""
        keys = [tuple(sorted(model)) for model in models]
        new = [key for key in dict.fromkeys(keys) if key not in self.log_posterior and self._possible(key)]
        if new:
            found = log_evidences(self.candidates, self.normal, new)
            for key, value in zip(new, found.tolist(), strict=True):
                self.log_posterior[key] = value - self.log_names * len(key)
        return np.array([self.log_posterior.get(key, -np.inf) for key in keys])

    def _possible(self, model: Model) -> bool:
        names = {self.candidates.exclusive[k] for k in model}
        return len(names) == len(model) and not any(pair <= names for pair in self.candidates.apart)

    @property
    def best(self) -> Model:
        """Return the most probable set."""
        return max(self.log_posterior, key=self.log_posterior.__getitem__)

    def probabilities(self) -> dict[Model, float]:
        """Return the probability of each set among those looked at, the most probable first."""
        models = sorted(self.log_posterior, key=self.log_posterior.__getitem__, reverse=True)
        logs = np.array([self.log_posterior[model] for model in models])
        return dict(zip(models, np.exp(logs - logsumexp(logs)).tolist(), strict=True))

    def inclusion(self) -> dict[str, float]:
        """Return the probability that an effect is there, by name: that of all sets which hold it."""
        found = dict.fromkeys(self.candidates.exclusive, 0.0)
        for model, probability in self.probabilities().items():
            for k in model:
                found[self.candidates.exclusive[k]] += probability
        return found


MOST_STARTS = 3
"""Sets from which the search climbs, the best of none, one and two effects."""


def search(candidates: Candidates, normal: Normal, *, starts: Sequence[Model] = ()) -> Sets:
    """Return the posterior over sets around the most probable ones.

    All singles and all pairs are looked at, so that two effects of which each alone would do harm are found; from the best
    of these, and from ``starts``, the search climbs by adding and removing effects until none helps, and from where it came
    highest by swapping them as well.
    """
    reduced, once = candidates.without_tolerances(), normal.marginal(candidates.tolerances)
    sets, places = Sets(candidates=reduced, normal=once), range(len(candidates.columns))
    sets.log_posterior_of([(), *combinations(places, 1), *combinations(places, 2)])
    first = sorted(sets.log_posterior, key=sets.log_posterior.__getitem__, reverse=True)[:MOST_STARTS]
    for start in (*starts, *first):
        _climb(sets, tuple(sorted(start)), (steps_from,))
    _climb(sets, sets.best, (steps_from, swaps_in))
    return sets


def _climb(sets: Sets, model: Model, ways: Sequence[Callable[[Model, int], list[Model]]]) -> None:
    """Look at neighbours of a set, and of the best of these, until none is more probable; try one way after the other."""
    count = len(sets.candidates.columns)
    here = float(sets.log_posterior_of([model])[0])
    while True:
        for way in ways:
            neighbours = way(model, count)
            values = sets.log_posterior_of(neighbours)
            if values.size and values.max() > here:
                model, here = neighbours[int(values.argmax())], float(values.max())
                break
        else:
            return


def steps_from(model: Model, count: int) -> list[Model]:
    """Return the sets with one candidate more, or one less."""
    more = [tuple(sorted((*model, k))) for k in range(count) if k not in model]
    return more + [tuple(k for k in model if k != gone) for gone in model]


def swaps_in(model: Model, count: int) -> list[Model]:
    """Return the sets with one candidate in the place of another."""
    others = [k for k in range(count) if k not in model]
    return [tuple(sorted((*(k for k in model if k != gone), other))) for gone in model for other in others]
