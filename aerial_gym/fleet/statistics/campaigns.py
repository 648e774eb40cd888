"""Evidence of a change against campaigns: steps and drifts of ordinary size, as the flights of other vehicles show them.

Flights come in blocks of equal conditions (site, season, payload), whose deviations look like changes. The null hypothesis of a
cause is thus that a share of the vehicles changes by ``N(0, size²)`` as a matter of course. The other vehicles of the fleet
give the posterior of share and size. Each may have a fault of its own, so that a few changed vehicles define no campaign.
Source: Stephens (2017), False discovery rates: a new deal, Biostatistics 18 (effects as scale mixtures, fitted to all cases).
"""

from collections.abc import Iterable
from dataclasses import replace

import numpy as np

from aerial_gym.fleet.statistics.change import ChangeResult, Support, log_e_of_support
from aerial_gym.fleet.statistics.scan import SIZES, log_sum
from aerial_gym.sim2real.arrays import Array

SHARES = (0.5, 1.0)  # Of vehicles with campaigns
FAULT = 0.05  # Prior probability that another vehicle has a fault of its own
NONE = 0.9  # Prior probability that a cause has no campaigns; shares and sizes of campaigns are equally probable
PRIOR = np.log([NONE] + [(1.0 - NONE) / (len(SHARES) * len(SIZES))] * (len(SHARES) * len(SIZES)))


def campaign_evidence(results: Iterable[ChangeResult], known: Support | None = None) -> Support:
    """Return the log likelihood of no campaign, and of campaigns by share and size, for each cause.

    Args:
        known: That of other vehicles.
    """
    fleet = dict(known or {})
    for result in results:
        for cause, logs in result.support.items():
            fleet[cause] = fleet.get(cause, 0.0) + _log_likelihood(logs)
    return fleet


def exclude_campaigns(result: ChangeResult, fleet: Support) -> ChangeResult:
    """Return a result with its evidence against campaigns; ``fleet`` is their evidence, with this vehicle.

    A second change is kept if it is evident.
    """
    weights = {cause: fleet[cause] - _log_likelihood(logs) + PRIOR for cause, logs in result.support.items()}
    second = result.second and replace(result.second, log_e=_log_e(result.second, weights))
    return replace(result, log_e=_log_e(result, weights), second=second if second and second.is_evident else None)


def _log_e(result: ChangeResult, weights: Support) -> float:
    log_e, count = result.log_e, len(result.support)
    for part in result.robust_support:
        campaigns = np.zeros(count)  # Log evidence of each cause's campaigns; 0 of causes that are no candidates
        for k, (cause, logs) in enumerate(part.items()):
            campaigns[k] = log_sum(weights[cause] + _log_factors(logs)) - log_sum(weights[cause])
        excess = log_e_of_support(part, count) - float(log_sum(campaigns)) + np.log(count) - result.choice_cost
        log_e = min(log_e, excess)
    return float(log_e)


def _log_likelihood(logs: Array) -> Array:
    """Return the log likelihoods of campaigns if the vehicle may also have a fault of its own."""
    fault = log_sum(logs) - np.log(len(SIZES))
    return np.logaddexp(np.log(1.0 - FAULT) + _log_factors(logs), np.log(FAULT) + fault)


def _log_factors(logs: Array) -> Array:
    """Return the log Bayes factors of campaigns against none, from those of changes by size."""
    shares = [np.logaddexp(np.log1p(-share), np.log(share) + logs) if share < 1.0 else logs for share in SHARES]
    return np.concatenate(([0.0], *shares))
