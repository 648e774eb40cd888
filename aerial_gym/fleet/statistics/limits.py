"""Time at which a drifting parameter crosses a limit."""

import numpy as np

from aerial_gym.fleet.statistics.change import Change
from aerial_gym.sim2real.statistics import normal_quantile

QUANTILES = (0.5, 0.05, 0.95)  # Median, and the ends of the 90 % interval


def time_to_limit(change: Change, limit: float, parameter: str = "") -> tuple[float, float, float] | None:
    """Return median, low and high end of the 90 % interval of the time at which a drifting parameter crosses a limit.

    The line ``level + slope (t - last_time)`` has normal level and slope: ``P(T <= t) = P(line beyond the limit at t)``.
    Source: Hinkley (1969), On the ratio of two correlated normal random variables, Biometrika 56.

    Args:
        limit: Value of the parameter, in physical units.
        parameter: Name of the parameter; by default the first of the effect.

    Returns:
        Times in the unit of the flights' times; an end is infinite if the drift may stop short of the limit. None unless the
        change is shown to be a drift, and for a drift that probably never reaches the limit.
    """
    place = change.parameters.index(parameter) if parameter else 0
    before = change.level[place] - change.change[place]
    side = np.sign(limit - before)
    slope = side * change.slope[place]
    if change.kind != "drift" or slope <= 0.0:
        return None
    excess, duration = side * (change.level[place] - limit), change.change[place] / change.slope[place]
    variances = change.level_std[place] ** 2, change.level_slope_cov[place], change.slope_std[place] ** 2
    times = (max(_crossing(excess, slope, *variances, normal_quantile(share)), -duration) for share in QUANTILES)
    median, low, high = (change.last_time + time for time in times)
    return median, low, high


def _crossing(excess: float, slope: float, level_var: float, cov: float, slope_var: float, quantile: float) -> float:
    """Return the time at which ``excess + slope t`` equals ``quantile`` times its standard deviation, else infinity."""
    if quantile == 0.0:
        return -excess / slope
    square = quantile**2
    polynomial = (slope**2 - square * slope_var, 2.0 * (excess * slope - square * cov), excess**2 - square * level_var)
    roots = [root.real for root in np.roots(polynomial) if abs(root.imag) <= 1e-9 * max(abs(root), 1e-300)]
    return min((time for time in roots if (excess + slope * time) * quantile >= 0.0), default=np.inf)
