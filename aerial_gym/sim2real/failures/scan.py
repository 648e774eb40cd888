"""Search for failures in the blocks of a flight: probability, kind, size and onset.

Letters: K blocks, R rotors, G onsets of a fine grid.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from aerial_gym.sim2real.arrays import Array
from aerial_gym.sim2real.failures.evidence import CONTINUOUS, LONGEST, FailureEvidence, ParameterPrior, log_evidence
from aerial_gym.sim2real.failures.rotor_work import RotorOutput
from aerial_gym.sim2real.identify.least_squares.moments import share_of_independent_rows
from aerial_gym.sim2real.predict.tolerances import Tolerances

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
            columns, rows = work.beside[:, rotor], slice(None)
            if rotor in own and self.kind == "stuck_rotor":
                left[part, rotor] = work.done[part, rotor] - self.change
                rows = slice(0, self.begin)
            elif rotor in own:
                left[part, rotor] -= self.change * work.own[part, rotor]
            gram = columns[rows].T @ columns[rows] + self.evidence.ridge
            fitted = np.linalg.solve(gram, columns[rows].T @ left[rows, rotor])
            left[rows, rotor] -= columns[rows] @ fitted
        return left


def rank_causes(works: Sequence[RotorOutput], tolerances: Tolerances) -> list[FailureCause]:
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
        log_odds, change, std = _change_odds(cause, _change_profile(work, times, end), share)
    if end is not None and cause.end is not None:
        ends = _onset_grid(work, cause.end)
        best = np.full(ends.size, times[int(np.argmax(log_odds))])
        of_ends, _, _ = _change_odds(cause, _change_profile(work, best, ends), share)
        end = float(ends[int(np.argmax(of_ends))])
        log_odds, change, std = _change_odds(cause, _change_profile(work, times, end), share)
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


def _change_odds(cause: FailureCause, profile: Array, share: float) -> tuple[Array, Array, Array]:
    """Return log odds, change and its standard deviation, (G,) each, for a change with profiles (G, K)."""
    evidence, work = cause.evidence, cause.work
    rotors = slice(None) if cause.rotor is None else slice(cause.rotor, cause.rotor + 1)
    own = work.own[:, rotors]
    across = np.einsum("gk,kr,krq->grq", profile, own, work.beside[:, rotors])
    inverse, beside = evidence.inverse[rotors], evidence.beside[rotors]
    inner = np.einsum("gk,kr->g", profile**2, own**2) - np.einsum("grp,rpq,grq->g", across, inverse, across)
    along = np.einsum("gk,kr,kr->g", profile, own, evidence.residual[:, rotors])
    along -= np.einsum("grq,rq->g", across, beside)
    return evidence.change_odds(cause.kind, np.maximum(inner, 0.0), along, share)


def _odds_of_stuck_rotor(cause: FailureCause, times: Array, share: float) -> tuple[Array, Array, Array]:
    """Return log odds, constant output and its standard deviation, (G,) each, for a rotor stuck from ``times`` (G,) on."""
    evidence, work, rotor = cause.evidence, cause.work, cause.rotor
    assert rotor is not None
    after = np.clip((work.time + work.length - times[:, None]) / work.length, 0.0, 1.0)  # (G, K)
    before = 1.0 - after
    columns = np.concatenate((before[..., None] * work.beside[:, rotor], after[..., None]), axis=-1)
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
