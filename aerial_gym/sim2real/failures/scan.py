"""Search for failures in the blocks of a flight: log evidence, kind, size and onset.

Without a failure a rotor's output is ``y = e + N b + noise``: expectation e, columns N of its possible errors. A failure
adds ``a z`` from its onset on, with z the rotor's own part of the expectation. With ``r = y - e``, from block k on
    M_zz = z'z - z'N (N'N)⁻¹ N'z,   M_zr = z'r - z'N (N'N)⁻¹ N'r,   a = M_zr / M_zz,   RSS(k) = RSS - M_zr² / M_zz
(Frisch, Waugh, Lovell). The log likelihood is ``-(n / 2) log(RSS / n + s²)`` with n independent values and the tolerance s.
The log evidence is Laplace's approximation with a Cauchy prior, as in ``identify/evidence/laplace.py``.

Letters: K blocks, R rotors, Q columns, D durations, G onsets of a fine grid.

Sources: Siegmund, Venkatraman (1995), Using the generalized likelihood ratio statistic for sequential detection of a
change-point, Annals of Statistics 23; Davidson, MacKinnon (1993), Estimation and Inference in Econometrics, section 1.4.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from aerial_gym.physics import EFFECTS
from aerial_gym.sim2real.arrays import Array, Indices
from aerial_gym.sim2real.failures.rotor_work import RotorOutput
from aerial_gym.sim2real.identify.least_squares.moments import share_of_independent_rows
from aerial_gym.sim2real.predict.tolerances import Tolerances

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
        self.residual, columns = work.done - work.expected, work.error_columns
        self.count, self.rotors = self.residual.shape
        self.ridge = least**2 * np.eye(columns.shape[2])
        outer = columns[..., :, None] * columns[..., None, :]
        self._gram = _cumulative_sums(outer)  # (K + 1, R, Q, Q)
        self._lean = _cumulative_sums(columns * self.residual[..., None])
        self.inverse = np.linalg.inv(self._gram[-1] + self.ridge)  # (R, Q, Q)
        self.error_gains = np.einsum("rpq,rq->rp", self.inverse, self._lean[-1])
        self._squares = _cumulative_sums(self.residual**2)
        self.rss = np.maximum(self._squares[-1] - np.einsum("rq,rq->r", self._lean[-1], self.error_gains), 0.0)
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
        log_odds, change, _ = self.odds_of_change_sums(kind, inner, along, share)
        return OnsetOdds(kind=kind, log_odds=self._mask_end_onsets(log_odds), change=change)

    def odds_of_brown_outs(self, kind: str, share: float = 1.0) -> OnsetOdds:
        """Return the evidence of a common change of all rotors for every onset and duration."""
        onset, lasting = np.arange(self.count)[:, None], np.arange(1, LONGEST + 1)
        end = np.minimum(onset + lasting, self.count)
        end = np.concatenate((end, np.full((self.count, 1), self.count)), axis=1)
        inner, along = (part.sum(axis=-1) for part in self.sums_of_change(np.broadcast_to(onset, end.shape), end))
        log_odds, change, _ = self.odds_of_change_sums(kind, inner, along, share)
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

    def odds_of_change_sums(self, kind: str, inner: Array, along: Array, share: float) -> tuple[Array, Array, Array]:
        """Return log odds for ``inner`` M_zz and ``along`` M_zr, the relative loss <= 0, and its standard deviation."""
        parameter = next(p for p in EFFECTS.get(kind).parameters if p.name == "scale")
        change = along / (inner + (self.least / parameter.scale) ** 2)
        change = np.clip(change, parameter.low - 1.0, 0.0)  # no failure makes a rotor stronger
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


KINDS = {
    ("speed", "command"): ("motor_failure", "stuck_rotor", "brown_out"),
    ("thrust", "command"): ("motor_failure", "stuck_rotor", "brown_out"),
    ("thrust", "speed"): ("weak_motor",),
}
"""Kinds of failure by quantity and source of its expectation."""

FINE_S = 0.005  # Step of the final onset grid [s]
AROUND = 3  # Number of blocks on each side of the most probable one that the grid covers


@dataclass(frozen=True, kw_only=True)
class FailureCause:
    """One kind of failure on one rotor, with its most probable onset block."""

    work: RotorOutput
    evidence: FailureEvidence
    kind: str
    rotor: int | None  # Rotor from 0; None: all
    log_odds: float  # Log odds of all its onsets against no failure
    begin: int  # Most probable onset block
    end: int | None  # First block after its end; None: it lasts
    change: float

    @property
    def name(self) -> str:
        """Return the kind and rotor in words."""
        return self.kind if self.rotor is None else f"{self.kind} of rotor {self.rotor + 1}"

    def share_of_independent_residuals(self) -> float:
        """Return the share of independent residuals with this failure, weighted by the rotors' squared residuals."""
        left = self.residual_with_failure()
        squares = (left**2).sum(axis=0)
        return float((share_of_independent_rows(left) * squares).sum() / max(squares.sum(), 1e-300))

    def residual_with_failure(self) -> Array:
        """Return the residuals of every rotor with this failure fitted, (K, R)."""
        work, left = self.work, self.evidence.residual.copy()
        own = range(left.shape[1]) if self.rotor is None else [self.rotor]
        part = slice(self.begin, self.end)
        for rotor in range(left.shape[1]):
            columns, rows = work.error_columns[:, rotor], slice(None)
            if rotor in own and self.kind == "stuck_rotor":
                left[part, rotor] = work.done[part, rotor] - self.change
                rows = slice(0, self.begin)
            elif rotor in own:
                left[part, rotor] -= self.change * work.own[part, rotor]
            gram = columns[rows].T @ columns[rows] + self.evidence.ridge
            fitted = np.linalg.solve(gram, columns[rows].T @ left[rows, rotor])
            left[rows, rotor] -= columns[rows] @ fitted
        return left


def rank_failure_causes(works: Sequence[RotorOutput], tolerances: Tolerances) -> list[FailureCause]:
    """Return all failures that a flight can show, the most probable first, with autocorrelated residuals counting less."""
    kinds = sum(len(KINDS[work.quantity, work.driven_by]) for work in works)
    ranked: list[FailureCause] = []
    for work in works:
        if len(work.time) > 1:
            # Thrust is quadratic in speed.
            least = tolerances.thrust if work.quantity == "thrust" else 0.5 * tolerances.thrust
            evidence = FailureEvidence(work, least)
            causes = _causes_of_quantity(evidence, 1.0, kinds)
            best = max(causes, key=lambda cause: cause.log_odds)
            if best.log_odds > 0.0:
                causes = _causes_of_quantity(evidence, best.share_of_independent_residuals(), kinds)
            ranked += causes
    return sorted(ranked, key=lambda cause: -cause.log_odds)


def log_sum_of_odds(causes: Sequence[FailureCause]) -> float:
    """Return the log of the sum of odds over failures and onsets, with equal prior probabilities of the kinds."""
    return float(np.logaddexp.reduce([cause.log_odds for cause in causes])) if causes else -np.inf


def _causes_of_quantity(evidence: FailureEvidence, share: float, kinds: int) -> list[FailureCause]:
    """Return each failure of one quantity per rotor; ``kinds``: number of kinds with equal prior probability."""
    ranked = []
    for kind in KINDS[evidence.work.quantity, evidence.work.driven_by]:
        methods = {"brown_out": evidence.odds_of_brown_outs, "stuck_rotor": evidence.odds_of_stuck_rotors}
        onsets = methods.get(kind, evidence.odds_of_changes)(kind, share)
        for rotor in (None,) if kind == "brown_out" else range(evidence.rotors):
            own = slice(None) if rotor is None else [rotor]
            odds, change = onsets.log_odds[:, own], onsets.change[:, own]
            begin, lasting = (int(place) for place in np.unravel_index(int(np.argmax(odds)), odds.shape))
            ranked.append(
                FailureCause(
                    work=evidence.work,
                    evidence=evidence,
                    kind=kind,
                    rotor=rotor,
                    log_odds=float(np.logaddexp.reduce(odds.ravel()) - np.log(kinds)),
                    begin=begin,
                    end=None if rotor is not None or lasting == LONGEST else begin + lasting + 1,
                    change=float(change[begin, lasting]),
                )
            )
    return ranked


@dataclass(frozen=True, kw_only=True)
class FailureTiming:
    """A failure with its onset resolved within blocks."""

    cause: FailureCause
    log_odds: float  # Log odds of its onsets on the fine grid, one per block on average, against no failure
    time: float  # Onset [s]
    interval: tuple[float, float]  # 95 % interval [s]
    end: float | None  # End [s]; None: it lasts
    change: float
    std: float


def locate_onset(cause: FailureCause) -> FailureTiming:
    """Return a failure with onset and end on a grid of ``FINE_S`` around its blocks."""
    share, work = cause.share_of_independent_residuals(), cause.work
    times = _onset_grid(work, cause.begin)
    end = None if cause.end is None else float(work.time[min(cause.end, len(work.time) - 1)])
    if cause.kind == "stuck_rotor":
        log_odds, change, std = _odds_of_stuck_rotor(cause, times, share)
    else:
        log_odds, change, std = _odds_of_change_profiles(cause, _change_profile(work, times, end), share)
    if end is not None and cause.end is not None:
        ends = _onset_grid(work, cause.end)
        best = np.full(ends.size, times[int(np.argmax(log_odds))])
        of_ends, _, _ = _odds_of_change_profiles(cause, _change_profile(work, best, ends), share)
        end = float(ends[int(np.argmax(of_ends))])
        log_odds, change, std = _odds_of_change_profiles(cause, _change_profile(work, times, end), share)
    weight = np.exp(log_odds - log_odds.max())
    weight, best = weight / weight.sum(), int(np.argmax(log_odds))
    places = np.searchsorted(np.cumsum(weight), (0.025, 0.975))
    low, high = times[np.minimum(places, times.size - 1)] + (-FINE_S, FINE_S)
    total, interval = float(np.logaddexp.reduce(log_odds) + np.log(FINE_S / work.length)), (float(low), float(high))
    time, size, deviation = (float(values[best]) for values in (times, change, std))
    return FailureTiming(cause=cause, log_odds=total, time=time, interval=interval, end=end, change=size, std=deviation)


def _onset_grid(work: RotorOutput, block: int) -> Array:
    """Return grid times [s] around the start of a block, (G,)."""
    middle = work.time[min(block, len(work.time) - 1)]
    times = middle + np.arange(-AROUND * work.length, (AROUND + 1) * work.length, FINE_S)
    return times[(times >= work.time[0]) & (times <= work.time[-1] + work.length)]


def _change_profile(work: RotorOutput, begin: Array, end: Array | float | None) -> Array:
    """Return the share of a change in each block, (G, K), for onsets (G,) and an optional end, with the lag."""
    share = _lag_response(work, begin)
    return share if end is None else share - _lag_response(work, np.broadcast_to(end, begin.shape))


def _lag_response(work: RotorOutput, begin: Array) -> Array:
    """Return the mean over each block of ``1 - exp(-(t - begin) / lag)`` after the onset, (G, K)."""
    since = np.clip(work.time + work.length - begin[:, None], 0.0, None)  # at the block's end
    before = np.clip(work.time - begin[:, None], 0.0, None)
    risen = since - before
    if work.lag > 0.0:
        risen = risen + work.lag * (np.exp(-since / work.lag) - np.exp(-before / work.lag))
    return risen / work.length


def _odds_of_change_profiles(cause: FailureCause, profile: Array, share: float) -> tuple[Array, Array, Array]:
    """Return log odds, change and its standard deviation, (G,) each, for a change with profiles (G, K)."""
    evidence, work = cause.evidence, cause.work
    rotors = slice(None) if cause.rotor is None else slice(cause.rotor, cause.rotor + 1)
    own = work.own[:, rotors]
    across = np.einsum("gk,kr,krq->grq", profile, own, work.error_columns[:, rotors])
    inverse, error_gains = evidence.inverse[rotors], evidence.error_gains[rotors]
    inner = np.einsum("gk,kr->g", profile**2, own**2) - np.einsum("grp,rpq,grq->g", across, inverse, across)
    along = np.einsum("gk,kr,kr->g", profile, own, evidence.residual[:, rotors])
    along -= np.einsum("grq,rq->g", across, error_gains)
    return evidence.odds_of_change_sums(cause.kind, np.maximum(inner, 0.0), along, share)


def _odds_of_stuck_rotor(cause: FailureCause, times: Array, share: float) -> tuple[Array, Array, Array]:
    """Return log odds, constant output and its standard deviation, (G,) each, for a rotor stuck from ``times`` (G,) on."""
    evidence, work, rotor = cause.evidence, cause.work, cause.rotor
    assert rotor is not None
    after = np.clip((work.time + work.length - times[:, None]) / work.length, 0.0, 1.0)  # (G, K)
    before = 1.0 - after
    columns = np.concatenate((before[..., None] * work.error_columns[:, rotor], after[..., None]), axis=-1)
    target = work.done[:, rotor] - before * work.expected[:, rotor]
    gram, lean = np.einsum("gkp,gkq->gpq", columns, columns), np.einsum("gkp,gk->gp", columns, target)
    width = columns.shape[-1]
    gram[:, range(width - 1), range(width - 1)] += evidence.least**2
    fitted = np.linalg.solve(gram + 1e-12 * np.eye(width), lean[..., None])[..., 0]
    own = np.maximum((target**2).sum(axis=1) - (lean * fitted).sum(axis=1), 0.0)
    mean_before = evidence.mean_square_with_tolerance(evidence.rss.sum())
    mean_after = evidence.mean_square_with_tolerance(evidence.rss.sum() - evidence.rss[rotor] + own)
    block = np.clip(np.searchsorted(work.time, times) - 1, 0, None)
    kept, inner = fitted[:, -1], share * np.maximum(after.sum(axis=1), 1e-9)
    prior = ParameterPrior(away=kept - work.done[np.maximum(block - 1, 0), rotor], scale=CONTINUOUS, normal=True)
    log_odds = log_evidence(mean_before, mean_after, share * evidence.num_values, prior, inner)
    return log_odds - np.log(evidence.rotors), kept, np.sqrt(mean_after / inner)
