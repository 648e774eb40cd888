"""How much better one model predicts flights that its fit has not seen, and when that counts.

Letters: B blocks of time, C channels, K parameters.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from aerial_gym.errors import ConfigError
from aerial_gym.sim2real.arrays import Array, Flags, Indices
from aerial_gym.sim2real.findings import Finding
from aerial_gym.sim2real.identify.least_squares.covariance import Uncertainty
from aerial_gym.sim2real.identify.least_squares.gauss_newton import Fit
from aerial_gym.sim2real.identify.least_squares.leave_out import steps_without
from aerial_gym.sim2real.identify.least_squares.moments import Weighting, folds
from aerial_gym.sim2real.predict.channels import Channel
from aerial_gym.sim2real.statistics import student_above

LEAST_SCORE = 3.0
"""Two models are told apart only by a log likelihood that differs so much: one is 20 times likelier.

Source: Kass, Raftery (1995), Bayes factors, section 3.2: strong evidence.
"""


@dataclass(frozen=True, kw_only=True)
class Criteria:
    """When what is fitted counts: in the selection, on flights left out, on rollouts."""

    significance: float = 0.001
    """Largest probability that noise and tolerances alone show such parameters."""

    left_out_significance: float = 0.01
    """Largest probability that the gain on flights left out is chance."""

    flights_better: float = 0.75
    """Least share of flights left out that it must predict better, and that it must not harm in any channel."""

    material: float = 0.05
    """Least relative fall of the left-out residual (rms) in its best channel."""

    visible: float = 0.5
    """What it takes off that channel must be this share of what the tolerances of the vehicle may add there."""

    harmless: float = 0.02
    """Largest relative rise of the left-out residual (rms) of a channel that is no harm."""

    forgiven: float = 0.1
    """Share of its whole gain in log likelihood that an effect may lose in a channel, and it is no harm."""

    def __post_init__(self) -> None:
        """Raise ``ConfigError`` if what is material is no share."""
        if not 0.0 <= self.material < 1.0:
            raise ConfigError(f"material = {self.material}: must lie in [0, 1), a share of a residual")


@dataclass(frozen=True, kw_only=True)
class Scored:
    """A fitted model and how it predicts flights that it has not seen."""

    fit: Fit
    """With the sums of whole flights."""

    spread: Uncertainty
    left_out: Array
    """Sums of squares of each block, predicted by the fit without its flight, (B, C)."""

    @property
    def effects(self) -> tuple[str, ...]:
        """Return the fitted effects."""
        return self.fit.effects

    def rms(self) -> Array:
        """Return the left-out residual of each channel, (C,)."""
        return np.sqrt(self.left_out.sum(axis=0) / self.fit.moments.count.sum())


@dataclass(frozen=True, kw_only=True)
class Gain:
    """What one model gains over another on flights left out."""

    score: float
    """In log likelihood."""

    p_value: float
    """Probability of such a gain where there is none."""

    flights_better: float
    """Share of the flights that are predicted better, among those in which anything changes."""

    falls: tuple[float, ...]
    """Relative fall of the residual (rms) of each channel, over all flights."""

    harmed: tuple[float, ...]
    """Share of the flights in which the residual of each channel rises."""

    worse: tuple[bool, ...]
    """Whether the residual of each channel rises over all flights."""

    visible: tuple[bool, ...]
    """Whether what falls in each channel is more than the tolerances of the vehicle may hide."""


@dataclass(frozen=True, kw_only=True)
class LeftOut:
    """Leaves out one flight after the other and compares models by it."""

    count: Array
    """Rows of each block of time, (B,)."""

    flight: Indices
    """Which flight a block is from, (B,)."""

    weights: Weighting
    criteria: Criteria
    channels: tuple[Channel, ...]
    tolerated: Array
    """Residual (rms) that the tolerances of the vehicle cause in each channel, (C,)."""

    @property
    def fold(self) -> Indices:
        """Return what is left out together: the flight of each block, or the quarter of a single flight, (B,)."""
        return folds(self.flight)

    def squares(self, fit: Fit) -> Array:
        """Return the squares (B, C) of each fold under the fit of the others, of effects and of what tolerances allow."""
        return fit.moments.squares_after(steps_without(fit, self.weights.weight, fit.free_all, self.fold))

    def gain(self, less: Array, more: Array) -> Gain:
        """Return what one set of left-out squares (B, C) gains over another.

        Score: ``sum n_c / 2 log(MS_less / MS_more)`` over channels with n independent samples; its p-value from the same
        sum of each block and the scatter between blocks.
        """
        count, effective = self.count, self.weights.effective
        folds = [self.fold == part for part in np.unique(self.fold)]
        blocks = (0.5 * count[:, None] * effective * _log_ratio(less, more)).sum(axis=1)
        spread = blocks.std(ddof=1) / np.sqrt(blocks.size) if blocks.size > 1 else np.inf
        concerned = [part for part in folds if self._changes(less[part], more[part])]
        judged = concerned if len(concerned) > 1 else folds
        totals = [self._score(less[part], more[part], count[part]) for part in judged]
        rises = [self._rises(less[part], more[part], count[part]) for part in folds]
        fallen = (less - more).sum(axis=0) / count.sum()
        return Gain(
            score=self._score(less, more, count),
            p_value=student_above(blocks.mean() / max(spread, 1e-300), max(blocks.size - 1, 1)),
            flights_better=float(np.mean([total > 0.0 for total in totals])),
            falls=tuple((1.0 - np.exp(-0.5 * _log_ratio(less.sum(axis=0), more.sum(axis=0)))).tolist()),
            harmed=tuple(np.mean(rises, axis=0).tolist()),
            worse=tuple(self._rises(less, more, count).tolist()),
            visible=tuple((fallen > (self.criteria.visible * self.tolerated) ** 2).tolist()),
        )

    def objections(self, gain: Gain) -> list[Finding]:
        """Return the reasons why a gain on flights left out does not count."""
        rules, found = self.criteria, []
        if gain.p_value > rules.left_out_significance:
            found.append(Finding("gain_by_chance", "", {"p_value": gain.p_value}))
        if gain.flights_better < rules.flights_better:
            found.append(Finding("few_flights_better", "", {"share": gain.flights_better}))
        if max(fall * seen for fall, seen in zip(gain.falls, gain.visible, strict=True)) < rules.material:
            found.append(Finding("gain_small", "", {"share": max(*gain.falls, 0.0)}))
        return [*found, *self.harms(gain)]

    def harms(self, gain: Gain) -> list[Finding]:
        """Return the channel in which a model is worse than the one before."""
        if any(gain.worse):
            place = int(np.argmin(np.where(gain.worse, gain.falls, np.inf)))
            return [Finding("channel_worse", self.channels[place].name, {"share": -gain.falls[place]})]
        if max(gain.harmed) > 1.0 - self.criteria.flights_better:
            place = int(np.argmax(gain.harmed))
            return [Finding("channel_worse_in_flights", self.channels[place].name, {"share": gain.harmed[place]})]
        return []

    def _score(self, less: Array, more: Array, count: Array) -> float:
        samples = count.sum() * self.weights.effective
        return float((0.5 * samples * _log_ratio(less.sum(axis=0), more.sum(axis=0))).sum())

    def _changes(self, less: Array, more: Array) -> bool:
        """Return whether squares (B, C) differ in any channel by more than is harmless: still air shows no drag."""
        return bool(
            np.any(np.abs(_log_ratio(less.sum(axis=0), more.sum(axis=0))) > 2.0 * np.log1p(self.criteria.harmless))
        )

    def _rises(self, less: Array, more: Array, count: Array) -> Flags:
        """Return in which channels squares (B, C) rise by more than is harmless, than tolerances cause, than is forgiven."""
        return rises(
            less.sum(axis=0), more.sum(axis=0), count.sum(), self.weights.effective, self.tolerated, self.criteria
        )


def rises(less: Array, more: Array, rows: ArrayLike, effective: Array, tolerated: Array, criteria: Criteria) -> Flags:
    """Return in which channels one sum of squares is harmfully larger than another, (..., C).

    Harmful is what is more than a small share of the residual, more than what the tolerances of the vehicle cause, and not
    paid for many times by what other channels gain: no effect that is there makes a channel worse in the long run, but the
    fit of a large one may spoil a small channel by what the model still lacks.

    Args:
        less: Squares of the model without the effect, (..., C).
        more: With it, (..., C).
        rows: Over which they are summed, (...).
        effective: Independent samples of a row of each channel, (C,).
        tolerated: Residual (rms) that the tolerances cause in each channel, (C,).
        criteria: The limits.
    """
    rows = np.asarray(rows)[..., None]
    gains = 0.5 * rows * effective * _log_ratio(less, more)
    forgiven = criteria.forgiven * np.maximum(gains.sum(axis=-1, keepdims=True), 0.0)
    return (
        (more > (1.0 + criteria.harmless) ** 2 * less)
        & (more - less > np.maximum(rows, 1.0) * tolerated**2)
        & (-gains > forgiven)
    )


def _log_ratio(less: Array, more: Array) -> Array:
    return np.log(np.maximum(less, 1e-300) / np.maximum(more, 1e-300))
