"""Limits for the acceptance of effects."""

import math
from dataclasses import dataclass

from aerial_gym.errors import ConfigError

LEAST_SCORE = 3.0
"""Least difference in log likelihood that distinguishes two models: one is 20 times as likely.

Source: Kass, Raftery (1995), Bayes factors, section 3.2: strong evidence.
"""

LEAST_NAMING_ODDS = math.log(99.0)
"""Least log odds of a named effect: a posterior probability of 99 %, so that at most one name in a hundred is false."""


@dataclass(frozen=True, kw_only=True)
class Criteria:
    """Limits for the acceptance of effects in the selection, on flights left out, and on rollouts."""

    significance: float = 0.001  # Largest p-value of an accepted effect against noise and tolerances alone
    left_out_significance: float = 0.01  # Largest p-value of an accepted gain on flights left out
    flights_better: float = 0.75  # Least share of flights predicted better, in which no channel may become worse
    material: float = 0.05  # Least relative fall of the left-out residual (rms) in the best channel
    visible: float = 0.5  # Least fall of a residual (rms), as a share of that from tolerances
    harmless: float = 0.02  # Largest relative rise of a channel's left-out residual (rms) that counts as harmless
    forgiven: float = 0.1  # Largest harmless loss of log likelihood in a channel, as a share of the total gain

    def __post_init__(self) -> None:
        """Raise ``ConfigError`` if ``material`` is not in [0, 1)."""
        if not 0.0 <= self.material < 1.0:
            raise ConfigError(f"material = {self.material}: must lie in [0, 1), a share of a residual")
