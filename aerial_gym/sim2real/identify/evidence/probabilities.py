"""Posterior probabilities of fitted sets and of single effects."""

from collections.abc import Iterable, Mapping

import numpy as np
from scipy.special import logsumexp

from aerial_gym.sim2real.identify.evidence.fitting import Fitted


def probabilities_of(fits: Iterable[Fitted], *, overdispersion: float) -> dict[tuple[str, ...], float]:
    """Return the probability of each set of effects, summed over structures, the most probable first.

    Log posteriors are divided by the overdispersion of the parameters (guard.py).
    """
    found: dict[tuple[str, ...], float] = {}
    for fitted in fits:
        key = tuple(sorted(fitted.effects))
        found[key] = float(np.logaddexp(found.get(key, -np.inf), fitted.log_posterior / overdispersion))
    logs = np.array(list(found.values()))
    shares = np.exp(logs - logsumexp(logs)).tolist()
    return dict(sorted(zip(found, shares, strict=True), key=lambda item: -item[1]))


def inclusion_in(sets: Mapping[tuple[str, ...], float]) -> dict[str, float]:
    """Return the posterior inclusion probability of each effect, the highest first."""
    found: dict[str, float] = {}
    for names, probability in sets.items():
        for name in names:
            found[name] = found.get(name, 0.0) + probability
    return dict(sorted(found.items(), key=lambda item: -item[1]))
