"""Cross-validation: the gain of one model over another on flights left out of the fit, and the limits for its acceptance.

Letters: B blocks of time, C channels, K parameters.
"""

from dataclasses import dataclass

import numpy as np

from aerial_gym.errors import ConfigError
from aerial_gym.sim2real.arrays import Array, Flags, Indices
from aerial_gym.sim2real.findings import Finding
from aerial_gym.sim2real.identify.least_squares.moments import Weighting, block_length, time_blocks
from aerial_gym.sim2real.predict.channels import Channel
from aerial_gym.sim2real.predict.predictor import Predictor
from aerial_gym.sim2real.statistics import student_tail

LEAST_SCORE = 3.0
"""Least difference in log likelihood that distinguishes two models: one is 20 times as likely.

Source: Kass, Raftery (1995), Bayes factors, section 3.2: strong evidence.
"""

QUARTERS = 4  # Number of folds of a single flight


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


@dataclass(frozen=True, kw_only=True)
class Gain:
    """Gain of one model over another on flights left out."""

    score: float  # Gain in log likelihood
    p_value: float  # Probability of a gain this large by chance
    flights_better: float  # Share of the flights that are predicted better, among those in which anything changes
    falls: tuple[float, ...]  # Relative fall of the residual (rms) of each channel, over all flights
    harmed: tuple[float, ...]  # Share of the flights in which the residual of each channel rises
    worse: tuple[bool, ...]  # Whether the residual of each channel rises over all flights
    visible: tuple[bool, ...]  # Least fall of a residual (rms), as a share of that from tolerances


@dataclass(frozen=True, kw_only=True)
class CrossValidation:
    """Cross-validation that leaves out one flight after the other."""

    count: Array  # Rows of each block of time, (B,)
    flight: Indices  # Index of the flight of each block, (B,)
    weights: Weighting
    criteria: Criteria
    channels: tuple[Channel, ...]
    tolerated: Array  # Residual (rms) that the tolerances of the vehicle cause in each channel, (C,)

    @property
    def fold_of_blocks(self) -> Indices:
        """Return the fold of each block: its flight, or a quarter of a single flight, (B,)."""
        if self.flight.max() > 0:
            return self.flight
        return np.arange(self.flight.size) * min(QUARTERS, self.flight.size) // self.flight.size

    def gain(self, less: Array, more: Array) -> Gain:
        """Return the gain of the larger model, by left-out squares (B, C) of the smaller (``less``) and larger (``more``) one.

        The score is ``sum n_c / 2 log(MS_less / MS_more)`` with n independent samples; the p-value is of a t-test on its
        blocks.
        """
        count, effective = self.count, self.weights.effective
        folds = [self.fold_of_blocks == part for part in np.unique(self.fold_of_blocks)]
        blocks = (0.5 * count[:, None] * effective * _log_ratio(less, more)).sum(axis=1)
        spread = blocks.std(ddof=1) / np.sqrt(blocks.size) if blocks.size > 1 else np.inf
        concerned = [part for part in folds if self._has_changed(less[part], more[part])]
        judged = concerned if len(concerned) > 1 else folds
        totals = [self._log_likelihood_gain(less[part], more[part], count[part]) for part in judged]
        rises = [self._has_harmful_rise(less[part], more[part], count[part]) for part in folds]
        fallen = (less - more).sum(axis=0) / count.sum()
        return Gain(
            score=self._log_likelihood_gain(less, more, count),
            p_value=student_tail(blocks.mean() / max(spread, 1e-300), max(blocks.size - 1, 1)),
            flights_better=float(np.mean([total > 0.0 for total in totals])),
            falls=tuple((1.0 - np.exp(-0.5 * _log_ratio(less.sum(axis=0), more.sum(axis=0)))).tolist()),
            harmed=tuple(np.mean(rises, axis=0).tolist()),
            worse=tuple(self._has_harmful_rise(less, more, count).tolist()),
            visible=tuple((fallen > (self.criteria.visible * self.tolerated) ** 2).tolist()),
        )

    def objections(self, gain: Gain) -> list[Finding]:
        """Return the reasons why a gain on flights left out does not count."""
        rules, gains = self.criteria, []
        if gain.p_value > rules.left_out_significance:
            gains.append(Finding("gain_by_chance", "", {"p_value": gain.p_value}))
        if gain.flights_better < rules.flights_better:
            gains.append(Finding("few_flights_better", "", {"share": gain.flights_better}))
        if max(fall * seen for fall, seen in zip(gain.falls, gain.visible, strict=True)) < rules.material:
            gains.append(Finding("gain_small", "", {"share": max(*gain.falls, 0.0)}))
        return [*gains, *self.findings_on_harm(gain)]

    def findings_on_harm(self, gain: Gain) -> list[Finding]:
        """Return the channel that is harmed most, over all flights or in too many of them; empty if none is."""
        if any(gain.worse):
            place = int(np.argmin(np.where(gain.worse, gain.falls, np.inf)))
            return [Finding("channel_worse", self.channels[place].name, {"share": -gain.falls[place]})]
        if max(gain.harmed) > 1.0 - self.criteria.flights_better:
            place = int(np.argmax(gain.harmed))
            return [Finding("channel_worse_in_flights", self.channels[place].name, {"share": gain.harmed[place]})]
        return []

    def _log_likelihood_gain(self, less: Array, more: Array, count: Array) -> float:
        samples = count.sum() * self.weights.effective
        return float((0.5 * samples * _log_ratio(less.sum(axis=0), more.sum(axis=0))).sum())

    def _has_changed(self, less: Array, more: Array) -> bool:
        """Return whether squares (B, C) differ in any channel by more than ``harmless``; hover, for example, shows no drag."""
        ratio = np.abs(_log_ratio(less.sum(axis=0), more.sum(axis=0)))
        return bool(np.any(ratio > 2.0 * np.log1p(self.criteria.harmless)))

    def _has_harmful_rise(self, less: Array, more: Array, count: Array) -> Flags:
        """Return whether the sum of squares (B, C) of each channel rises harmfully, (C,).

        Such a rise exceeds a small share of the residual, that of the tolerances, and a small share of the total gain: the
        fit of a large effect may harm a small channel as long as the model lacks others.
        """
        less, more, rows, rules = less.sum(axis=0), more.sum(axis=0), count.sum(), self.criteria
        gains = 0.5 * rows * self.weights.effective * _log_ratio(less, more)
        beyond_share = more > (1.0 + rules.harmless) ** 2 * less
        beyond_tolerances = more - less > np.maximum(rows, 1.0) * self.tolerated**2
        return beyond_share & beyond_tolerances & (-gains > rules.forgiven * np.maximum(gains.sum(), 0.0))


def leave_out_flights(
    predictor: Predictor, weights: Weighting, criteria: Criteria, tolerated: Array
) -> CrossValidation:
    """Return the cross-validation over the flights of a predictor; ``tolerated``: residual (rms) from tolerances, (C,)."""
    blocks = time_blocks(predictor.times, block_length(predictor.times))
    count, flight = np.array([float(rows.size) for _, rows in blocks]), np.array([index for index, _ in blocks])
    judged = {"weights": weights, "criteria": criteria, "channels": predictor.channels, "tolerated": tolerated}
    return CrossValidation(count=count, flight=flight, **judged)


def _log_ratio(less: Array, more: Array) -> Array:
    return np.log(np.maximum(less, 1e-300) / np.maximum(more, 1e-300))
