"""Posterior probabilities of fitted sets and of single effects."""

from collections.abc import Iterable, Mapping

import numpy as np
from scipy.special import logsumexp

from aerial_gym.sim2real.identify.evidence.fitting import EffectSetFit


def set_probabilities(fits: Iterable[EffectSetFit], *, overdispersion: float) -> dict[tuple[str, ...], float]:
    """Return the probability of each set, summed over structures, the most probable first, with overdispersion (guard.py)."""
    inclusion: dict[tuple[str, ...], float] = {}
    for fitted in fits:
        key = tuple(sorted(fitted.effects))
        inclusion[key] = float(np.logaddexp(inclusion.get(key, -np.inf), fitted.log_posterior / overdispersion))
    logs = np.array(list(inclusion.values()))
    shares = np.exp(logs - logsumexp(logs)).tolist()
    return dict(sorted(zip(inclusion, shares, strict=True), key=lambda item: -item[1]))


def inclusion_probabilities(sets: Mapping[tuple[str, ...], float]) -> dict[str, float]:
    """Return the posterior inclusion probability of each effect, the highest first."""
    inclusion: dict[str, float] = {}
    for names, probability in sets.items():
        for name in names:
            inclusion[name] = inclusion.get(name, 0.0) + probability
    return dict(sorted(inclusion.items(), key=lambda item: -item[1]))
