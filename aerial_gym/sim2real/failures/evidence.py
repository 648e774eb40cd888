"""Log evidence of failures for all onset times at once, from cumulative sums over time blocks.

Without a failure a rotor's output is ``y = e + N b + noise``: expectation e, columns N of its possible errors. A failure
adds ``a z`` from its onset on, with z the rotor's own part of the expectation. With ``r = y - e``, from block k on
    M_zz = z'z - z'N (N'N)⁻¹ N'z,   M_zr = z'r - z'N (N'N)⁻¹ N'r,   a = M_zr / M_zz,   RSS(k) = RSS - M_zr² / M_zz
(Frisch, Waugh, Lovell). The log likelihood is ``-(n / 2) log(RSS / n + s²)`` with n independent values and the tolerance s.
The log evidence is Laplace's approximation with a Cauchy prior, as in ``identify/evidence/laplace.py``.

Letters: K blocks, R rotors, Q columns, D durations.

Sources: Siegmund, Venkatraman (1995), Using the generalized likelihood ratio statistic for sequential detection of a
change-point, Annals of Statistics 23; Davidson, MacKinnon (1993), Estimation and Inference in Econometrics, section 1.4.
"""

from dataclasses import dataclass

import numpy as np

from aerial_gym.physics import EFFECTS
from aerial_gym.sim2real.arrays import Array, Indices
from aerial_gym.sim2real.failures.rotor_work import RotorOutput

FEWEST_BEFORE = 5  # Least number of blocks before an onset
FEWEST_AFTER = {"speed": 2, "thrust": 10}  # Least number of blocks after an onset; a collision is brief
LONGEST = 100  # Longest duration in blocks of a brown-out that ends
CONTINUOUS = 0.1  # Prior standard deviation of a stuck rotor's speed around that of the block before, relative to hover

LOG_2PI = float(np.log(2.0 * np.pi))


@dataclass(frozen=True, kw_only=True)
class ParameterPrior:
    """Prior of one parameter: distance from its most probable value, and width."""

    away: Array
    scale: float
    normal: bool = False  # Whether it is normal instead of Cauchy

    @property
    def log_density(self) -> Array:
        """Return the log density."""
        share = self.away / self.scale
        if self.normal:
            return -0.5 * (share**2 + LOG_2PI) - np.log(self.scale)
        return -np.log(np.pi * self.scale * (1.0 + share**2))

    @property
    def precision(self) -> Array | float:
        """Return the precision of the local normal approximation."""
        return self.scale**-2 if self.normal else 2.0 / (self.scale**2 + self.away**2)


def log_evidence(before: Array | float, after: Array, count: float, prior: ParameterPrior, inner: Array) -> Array:
    """Return the log evidence of one more parameter: likelihood ratio, prior density and posterior volume.

    ``before``, ``after``: mean squared residuals without and with it, of ``count`` independent ones. ``inner``: sum of
    squares of its column, orthogonal to the jointly fitted ones.
    """
    volume = 0.5 * (LOG_2PI - np.log(inner / after + prior.precision))
    return 0.5 * count * (np.log(before) - np.log(after)) + prior.log_density + volume


@dataclass(frozen=True, kw_only=True)
class OnsetOdds:
    """Log odds of one kind of failure for every onset."""

    kind: str
    log_odds: Array  # (K, R) by onset and rotor; brown-outs (K, D + 1) by duration, the last unlimited
    change: Array  # Relative change of output; for a stuck rotor the constant output relative to hover


def _cumulative_sums(values: Array) -> Array:
    """Return the cumulative sums before each block, and the total, (K + 1, any)."""
    return np.concatenate((np.zeros((1, *values.shape[1:])), np.cumsum(values, axis=0)))


class FailureEvidence:
    """Sums over the blocks of one quantity of all rotors."""

    def __init__(self, work: RotorOutput, least: float) -> None:
        """Store the blocks and the tolerance of the declaration relative to hover, ``least``."""
        self.work, self.least = work, least
        self.residual, columns = work.done - work.expected, work.beside
        self.count, self.rotors = self.residual.shape
        self.ridge = least**2 * np.eye(columns.shape[2])
        outer = columns[..., :, None] * columns[..., None, :]
        self._gram = _cumulative_sums(outer)  # (K + 1, R, Q, Q)
        self._lean = _cumulative_sums(columns * self.residual[..., None])
        self.inverse = np.linalg.inv(self._gram[-1] + self.ridge)  # (R, Q, Q)
        self.beside = np.einsum("rpq,rq->rp", self.inverse, self._lean[-1])
        self._squares = _cumulative_sums(self.residual**2)
        self.rss = np.maximum(self._squares[-1] - np.einsum("rq,rq->r", self._lean[-1], self.beside), 0.0)
        self._zz, self._zr = _cumulative_sums(work.own**2), _cumulative_sums(work.own * self.residual)
        root = np.linalg.cholesky(self.inverse)  # makes the columns orthonormal
        self._along = np.einsum("rqp,rq->rp", root, self._lean[-1])
        self._zn = np.einsum("krq,rqp->krp", _cumulative_sums(work.own[..., None] * columns), root)

    @property
    def num_values(self) -> float:
        """Return the number of values, K R."""
        return float(self.residual.size)

    def mean_square_with_tolerance(self, rss: Array) -> Array:
        """Return ``RSS / n + s²``."""
        return rss / self.num_values + self.least**2

    def sums_of_change(self, begin: Indices, end: Indices) -> tuple[Array, Array]:
        """Return M_zz and M_zr for changes from block ``begin`` to before block ``end``, (..., R) each."""
        across = self._zn[end] - self._zn[begin]
        inner = self._zz[end] - self._zz[begin] - (across**2).sum(axis=-1)
        return np.maximum(inner, 0.0), self._zr[end] - self._zr[begin] - (across * self._along).sum(axis=-1)

    def odds_of_changes(self, kind: str, share: float = 1.0) -> OnsetOdds:
        """Return the evidence of a lasting change per rotor for every onset; ``share``: independent share of the values."""
        onset = np.arange(self.count)
        inner, along = self.sums_of_change(onset, np.full(self.count, self.count))
        log_odds, change, _ = self.change_odds(kind, inner, along, share)
        return OnsetOdds(kind=kind, log_odds=self._mask_end_onsets(log_odds), change=change)

    def odds_of_brown_outs(self, kind: str, share: float = 1.0) -> OnsetOdds:
        """Return the evidence of a common change of all rotors for every onset and duration."""
        onset, lasting = np.arange(self.count)[:, None], np.arange(1, LONGEST + 1)
        end = np.minimum(onset + lasting, self.count)
        end = np.concatenate((end, np.full((self.count, 1), self.count)), axis=1)
        inner, along = (part.sum(axis=-1) for part in self.sums_of_change(np.broadcast_to(onset, end.shape), end))
        log_odds, change, _ = self.change_odds(kind, inner, along, share)
        ends = np.concatenate((onset + lasting < self.count, np.ones((self.count, 1), dtype=bool)), axis=1)
        log_odds = np.where(ends, log_odds - np.log(LONGEST + 1), -np.inf)
        return OnsetOdds(kind=kind, log_odds=self._mask_end_onsets(log_odds), change=change)

    def odds_of_stuck_rotors(self, kind: str, share: float = 1.0) -> OnsetOdds:
        """Return the evidence of a constant output per rotor for every onset, whatever is expected."""
        lean = self._lean[:-1]
        fitted = np.linalg.solve(self._gram[:-1] + self.ridge, lean[..., None])[..., 0]
        squares = self._squares[:-1] - (lean * fitted).sum(axis=-1)
        done = self.work.done
        left = np.arange(self.count, 0, -1)[:, None].astype(float)
        kept = np.cumsum(done[::-1], axis=0)[::-1] / left
        scatter = np.cumsum(done[::-1] ** 2, axis=0)[::-1] - left * kept**2
        rss = self.rss.sum() - self.rss + np.maximum(squares, 0.0) + np.maximum(scatter, 0.0)
        away = kept - np.concatenate((done[:1], done[:-1]))
        before, after = self.mean_square_with_tolerance(self.rss.sum()), self.mean_square_with_tolerance(rss)
        prior = ParameterPrior(away=away, scale=CONTINUOUS, normal=True)
        log_odds = log_evidence(before, after, share * self.num_values, prior, share * left)
        return OnsetOdds(kind=kind, log_odds=self._mask_end_onsets(log_odds - np.log(self.rotors)), change=kept)

    def change_odds(self, kind: str, inner: Array, along: Array, share: float) -> tuple[Array, Array, Array]:
        """Return log odds for ``inner`` M_zz and ``along`` M_zr, the relative change, and its standard deviation."""
        parameter = next(p for p in EFFECTS.get(kind).parameters if p.name == "scale")
        change = along / (inner + (self.least / parameter.scale) ** 2)
        change = np.clip(change, parameter.low - 1.0, parameter.high - 1.0)
        rss = np.maximum(self.rss.sum() - 2.0 * change * along + change**2 * inner, 0.0)
        before, after = self.mean_square_with_tolerance(self.rss.sum()), self.mean_square_with_tolerance(rss)
        prior = ParameterPrior(away=change, scale=parameter.scale)
        log_odds = log_evidence(before, after, share * self.num_values, prior, share * inner)
        alike = 0.0 if kind == "brown_out" else float(np.log(self.rotors))
        return log_odds - alike, change, np.sqrt(after / np.maximum(share * inner, 1e-300))

    def _mask_end_onsets(self, log_odds: Array) -> Array:
        """Return the log odds, minus infinity for onsets with too few blocks before or after."""
        onset = np.arange(self.count)
        few = (onset < FEWEST_BEFORE) | (onset > self.count - FEWEST_AFTER[self.work.quantity])
        return np.where(few.reshape(-1, *(1,) * (log_odds.ndim - 1)), -np.inf, log_odds)
