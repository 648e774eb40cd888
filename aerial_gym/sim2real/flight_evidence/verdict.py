"""Screening of several flights by the sum of their evidence: a set of effects, clearly none, or an open question.

Only a clear none is a verdict. Everything else needs ``judge_flights``, whose fits and test flights the sum lacks.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from aerial_gym.sim2real.flight_evidence.columns import candidates_of_columns
from aerial_gym.sim2real.flight_evidence.evidence import FlightEvidence
from aerial_gym.sim2real.identify.evidence.laplace import NormalEquations
from aerial_gym.sim2real.identify.evidence.search import search_sets
from aerial_gym.sim2real.identify.selection.criteria import LEAST_NAMING_ODDS, LEAST_SCORE


@dataclass(frozen=True, kw_only=True)
class SumVerdict:
    """Posterior over sets of effects from the summed evidence of flights."""

    effects: tuple[str, ...]  # Effects of the most probable set whose inclusion odds suffice for a name
    inclusion: dict[str, float]  # Posterior inclusion probability of each candidate effect

    @property
    def is_clearly_none(self) -> bool:
        """Whether each effect is clearly less probable than its absence, by ``LEAST_SCORE``."""
        return all(probability < 1.0 / (1.0 + np.exp(LEAST_SCORE)) for probability in self.inclusion.values())


def verdict_of_sum(evidences: Sequence[FlightEvidence]) -> SumVerdict | None:
    """Return the verdict of flights of one robot by the sum of their evidence; None without any flight."""
    if not evidences:
        return None
    candidates = candidates_of_columns(evidences[0].columns)
    sums = {name: np.sum([getattr(one, name) for one in evidences], axis=0) for name in ("product", "gradient")}
    sets = search_sets(candidates, NormalEquations(**sums))
    inclusion, least = sets.inclusion(), 1.0 / (1.0 + np.exp(-LEAST_NAMING_ODDS))
    best = dict.fromkeys(candidates.exclusive[k] for k in sets.most_probable_set)
    return SumVerdict(effects=tuple(name for name in best if inclusion[name] > least), inclusion=inclusion)
