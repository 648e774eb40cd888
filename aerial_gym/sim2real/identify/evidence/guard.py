"""The guard against a model that is none of the vehicle's: every effect must predict flights that its fit has not seen.

Evidence weighs sets as if one of them were true. Where none is, an effect can gain on some flights what it loses on others.
Letters: F parts that are left out one after the other.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from aerial_gym.sim2real.identify.evidence.laplace import Model, evidences_of_parts, posterior
from aerial_gym.sim2real.identify.evidence.linear import candidates_of, normal_of
from aerial_gym.sim2real.identify.evidence.search import Sets
from aerial_gym.sim2real.identify.least_squares.moments import Weighting
from aerial_gym.sim2real.identify.selection.library import Library

Array = NDArray[np.float64]

LEAST_RATIO = 1.0
"""In standard errors: what an effect gains on flights left out; one if one flight speaks for it and the others say nothing."""

FEWEST_PARTS = 4
"""That are left out one after the other: fewer do not tell a standard error."""

NEGLIGIBLE = 1e-4
"""Sets of a smaller probability, as a share of the most probable one, are not looked at for what they predict."""


@dataclass(frozen=True, kw_only=True)
class Predictive:
    """What an effect adds to the log density of flights that are left out, each predicted by the posterior of the others."""

    by_part: Array
    """Log density with the effect less that without it, (F,)."""

    relief: float
    """Log density of the deviations within the tolerances, with the effect less without it: another datum, of the vehicle."""

    @property
    def gain(self) -> float:
        """Return the sum over flights and vehicle."""
        return float(self.by_part.sum()) + self.relief

    @property
    def error(self) -> float:
        """Return the standard error of the sum, from the scatter of the flights; infinite for a single one."""
        count = self.by_part.size
        return float(self.by_part.std(ddof=1) * np.sqrt(count)) if count > 1 else np.inf

    @property
    def ratio(self) -> float:
        """Return the gain in standard errors."""
        return self.gain / max(self.error, 1e-12)


class Guard:
    """Keeps out sets with an effect that does not predict flights of which its fit has seen nothing.

    The density of a flight given the others is the evidence of all flights over that of the others.
    Source: Vehtari, Gelman, Gabry (2017), Practical Bayesian model evaluation, Statistics and Computing 27, section 2
    (difference of log predictive densities, and its standard error).
    """

    def __init__(self, library: Library, sets: Sets, weights: Weighting) -> None:
        """Take the posterior over sets of a library of candidates."""
        self._library, self._sets = library, sets
        self._whole, self._candidates = normal_of(library, weights), candidates_of(library)
        self._rest = [
            (self._whole - normal_of(library, weights, np.array([block]))).marginal(library.tolerances)
            for block in range(library.moments.count.size)
        ]
        self._density: dict[Model, Array] = {}
        self._strain: dict[Model, float] = {}
        self._passes: dict[Model, bool] = {}

    def passes(self, model: Model) -> bool:
        """Return whether every effect of a set predicts."""
        if model not in self._passes:
            self._passes[model] = all(found.ratio >= LEAST_RATIO for found in self.of(model).values())
        return self._passes[model]

    def of(self, model: Model) -> dict[str, Predictive]:
        """Return what each effect of a set adds to the log density of flights left out."""
        found = {}
        for k in (k for k in model if k not in self._sets.candidates.structures):
            less = tuple(other for other in model if other != k)
            found[self._library.candidates[k].name] = Predictive(
                by_part=self._densities(model) - self._densities(less),
                relief=self._strains(less) - self._strains(model),
            )
        return found

    def leave_out_what_fails(self) -> None:
        """Take the sets that do not pass out of the posterior, as far as they matter."""
        log_posterior = self._sets.log_posterior
        top = -np.inf
        for model in sorted(log_posterior, key=log_posterior.__getitem__, reverse=True):
            if log_posterior[model] < top + np.log(NEGLIGIBLE):
                return
            if self.passes(model):
                top = max(top, log_posterior[model])
            else:
                log_posterior[model] = -np.inf

    def _densities(self, model: Model) -> Array:
        if model not in self._density:
            found = evidences_of_parts(self._sets.candidates, [self._sets.normal, *self._rest], model)
            self._density[model] = found[0] - found[1:]
        return self._density[model]

    def _strains(self, model: Model) -> float:
        if model not in self._strain:
            found = posterior(self._candidates, self._whole, model)
            self._strain[model] = 0.5 * float((found.step[-self._library.tolerances.size :] ** 2).sum())
        return self._strain[model]


def part_length(times: Sequence[Array]) -> float:
    """Return how long the parts are that are left out together [s]: whole flights, or parts of them where flights are few."""
    if len(times) >= FEWEST_PARTS:
        return np.inf
    shortest = min(float(time[-1] - time[0]) for time in times)
    return shortest / -(-FEWEST_PARTS // len(times))
