"""The evidence of every onset of a failure at once, from running sums over blocks of time.

Without a failure a rotor does ``y = e + N b + noise``: what is expected, columns N of what an expectation may be off by all
along, and white noise. With one it does more by ``a z`` from the onset on: z is what of the expectation goes with the rotor
itself, so that ``1 + a`` is the share that is left. Of every onset k the least squares follow from the sums from block k on,

    z'z,  z'r,  z'N        (r = y - e),
    M_zz = z'z - z'N (N'N)⁻¹ N'z,   M_zr = z'r - z'N (N'N)⁻¹ N'r,   a = M_zr / M_zz,   RSS(k) = RSS - M_zr² / M_zz

(Frisch, Waugh, Lovell), those of a rotor that sticks from the sums up to k and those from k on, and those of a brown-out, which
ends, from differences of sums. The noise is unknown: the log likelihood is ``-(n / 2) log(RSS / n + s²)``, n the independent
values, s how far off a careful declaration is anyway (``Tolerances``), so that nothing smaller is called a failure. The log
evidence against no failure is Laplace's, with a Cauchy prior of the effect's scale, as in ``identify/evidence/laplace.py``.

Letters: K blocks, R rotors, Q columns, D durations.

Sources:
    Siegmund, Venkatraman (1995), Using the generalized likelihood ratio statistic for sequential detection of a change-point,
    Annals of Statistics 23; Davidson, MacKinnon (1993), Estimation and Inference in Econometrics, section 1.4.
"""

from dataclasses import dataclass

import numpy as np

from aerial_gym.physics import EFFECTS
from aerial_gym.sim2real.arrays import Array, Indices
from aerial_gym.sim2real.failures.rotor_work import RotorWork

FEWEST_BEFORE = 5
"""Blocks before an onset."""

FEWEST_AFTER = {"speed": 2, "thrust": 10}
"""Blocks after it: a rotor that touches something seems to lose thrust for a moment."""

LONGEST = 100
"""Blocks that a brown-out lasts that ended; one that goes on lasts as long as it likes."""

CONTINUOUS = 0.1
"""How far from its speed of a block ago a rotor sticks: standard deviation, in parts of hover."""

LOG_2PI = float(np.log(2.0 * np.pi))


@dataclass(frozen=True, kw_only=True)
class Prior:
    """Of one parameter: how far it is from its most probable value, and how far that may be."""

    away: Array
    scale: float
    normal: bool = False
    """Whether it is normal, and not Cauchy's."""

    @property
    def log_density(self) -> Array:
        """Return the logarithm of its density."""
        share = self.away / self.scale
        if self.normal:
            return -0.5 * (share**2 + LOG_2PI) - np.log(self.scale)
        return -np.log(np.pi * self.scale * (1.0 + share**2))

    @property
    def precision(self) -> Array | float:
        """Return that of the normal density that stands for it."""
        return self.scale**-2 if self.normal else 2.0 / (self.scale**2 + self.away**2)


def log_evidence(before: Array | float, after: Array, count: float, prior: Prior, inner: Array) -> Array:
    """Return the log evidence of one more parameter: likelihood, prior and the volume that the data leave of it.

    Args:
        before: Mean square of the residual without it.
        after: With it.
        count: Independent residuals.
        prior: Of the parameter.
        inner: Sum of squares of its column over independent residuals, what is fitted beside it taken off.
    """
    volume = 0.5 * (LOG_2PI - np.log(inner / after + prior.precision))
    return 0.5 * count * (np.log(before) - np.log(after)) + prior.log_density + volume


@dataclass(frozen=True, kw_only=True)
class Onsets:
    """One kind of failure with every onset."""

    kind: str
    log_odds: Array
    """Against no failure, (K, R) by onset and rotor; of a brown-out (K, D + 1) by onset and duration, the last: to the end."""

    change: Array
    """How much more than expected is done, relative; what a stuck rotor keeps, in parts of hover."""


def _sums_before(values: Array) -> Array:
    """Return the sums of the blocks before each, and of all, (K + 1, any)."""
    return np.concatenate((np.zeros((1, *values.shape[1:])), np.cumsum(values, axis=0)))


class Evidence:
    """Sums over the blocks of one quantity of all rotors."""

    def __init__(self, work: RotorWork, least: float) -> None:
        """Take blocks, and how far off a careful declaration is anyway, in parts of hover."""
        self.work, self.least = work, least
        self.residual, columns = work.done - work.expected, work.beside
        self.count, self.rotors = self.residual.shape
        self.ridge = least**2 * np.eye(columns.shape[2])
        outer = columns[..., :, None] * columns[..., None, :]
        self._gram = _sums_before(outer)  # (K + 1, R, Q, Q)
        self._lean = _sums_before(columns * self.residual[..., None])
        self.inverse = np.linalg.inv(self._gram[-1] + self.ridge)  # (R, Q, Q)
        self.beside = np.einsum("rpq,rq->rp", self.inverse, self._lean[-1])
        self._squares = _sums_before(self.residual**2)
        self.rss = np.maximum(self._squares[-1] - np.einsum("rq,rq->r", self._lean[-1], self.beside), 0.0)
        self._zz, self._zr = _sums_before(work.own**2), _sums_before(work.own * self.residual)
        root = np.linalg.cholesky(self.inverse)  # columns that are orthonormal beside each other
        self._along = np.einsum("rqp,rq->rp", root, self._lean[-1])
        self._zn = np.einsum("krq,rqp->krp", _sums_before(work.own[..., None] * columns), root)

    @property
    def total(self) -> float:
        """Return the number of values, K R."""
        return float(self.residual.size)

    def mean_square(self, rss: Array) -> Array:
        """Return ``RSS / n + s²``."""
        return rss / self.total + self.least**2

    def projected(self, begin: Indices, end: Indices) -> tuple[Array, Array]:
        """Return M_zz and M_zr of columns that act from block ``begin`` to before block ``end``, (..., R) each."""
        across = self._zn[end] - self._zn[begin]
        inner = self._zz[end] - self._zz[begin] - (across**2).sum(axis=-1)
        return np.maximum(inner, 0.0), self._zr[end] - self._zr[begin] - (across * self._along).sum(axis=-1)

    def changes(self, kind: str, share: float = 1.0) -> Onsets:
        """Return rotors that do more or less from an onset on; ``share`` of the values are independent."""
        onset = np.arange(self.count)
        inner, along = self.projected(onset, np.full(self.count, self.count))
        log_odds, change, _ = self.changed(kind, inner, along, share)
        return Onsets(kind=kind, log_odds=self._far_from_ends(log_odds), change=change)

    def brown_outs(self, kind: str, share: float = 1.0) -> Onsets:
        """Return all rotors together that do more or less from an onset on, for a while or to the end."""
        onset, lasting = np.arange(self.count)[:, None], np.arange(1, LONGEST + 1)
        end = np.minimum(onset + lasting, self.count)
        end = np.concatenate((end, np.full((self.count, 1), self.count)), axis=1)
        inner, along = (part.sum(axis=-1) for part in self.projected(np.broadcast_to(onset, end.shape), end))
        log_odds, change, _ = self.changed(kind, inner, along, share)
        ends = np.concatenate((onset + lasting < self.count, np.ones((self.count, 1), dtype=bool)), axis=1)
        log_odds = np.where(ends, log_odds - np.log(LONGEST + 1), -np.inf)
        return Onsets(kind=kind, log_odds=self._far_from_ends(log_odds), change=change)

    def stuck(self, kind: str, share: float = 1.0) -> Onsets:
        """Return rotors that do the same from an onset on, whatever is expected."""
        lean = self._lean[:-1]
        fitted = np.linalg.solve(self._gram[:-1] + self.ridge, lean[..., None])[..., 0]
        squares = self._squares[:-1] - (lean * fitted).sum(axis=-1)
        done = self.work.done
        left = np.arange(self.count, 0, -1)[:, None].astype(float)
        kept = np.cumsum(done[::-1], axis=0)[::-1] / left
        scatter = np.cumsum(done[::-1] ** 2, axis=0)[::-1] - left * kept**2
        rss = self.rss.sum() - self.rss + np.maximum(squares, 0.0) + np.maximum(scatter, 0.0)
        away = kept - np.concatenate((done[:1], done[:-1]))
        before, after = self.mean_square(self.rss.sum()), self.mean_square(rss)
        prior = Prior(away=away, scale=CONTINUOUS, normal=True)
        found = log_evidence(before, after, share * self.total, prior, share * left)
        return Onsets(kind=kind, log_odds=self._far_from_ends(found - np.log(self.rotors)), change=kept)

    def changed(self, kind: str, inner: Array, along: Array, share: float) -> tuple[Array, Array, Array]:
        """Return log odds of columns with ``inner`` M_zz and ``along`` M_zr, the change, and its standard deviation."""
        parameter = next(p for p in EFFECTS.get(kind).parameters if p.name == "scale")
        change = along / (inner + (self.least / parameter.scale) ** 2)
        change = np.clip(change, parameter.low - 1.0, parameter.high - 1.0)
        rss = np.maximum(self.rss.sum() - 2.0 * change * along + change**2 * inner, 0.0)
        before, after = self.mean_square(self.rss.sum()), self.mean_square(rss)
        prior = Prior(away=change, scale=parameter.scale)
        found = log_evidence(before, after, share * self.total, prior, share * inner)
        alike = 0.0 if kind == "brown_out" else float(np.log(self.rotors))
        return found - alike, change, np.sqrt(after / np.maximum(share * inner, 1e-300))

    def _far_from_ends(self, log_odds: Array) -> Array:
        """Return log odds without onsets that have too little before or after them."""
        onset = np.arange(self.count)
        few = (onset < FEWEST_BEFORE) | (onset > self.count - FEWEST_AFTER[self.work.quantity])
        return np.where(few.reshape(-1, *(1,) * (log_odds.ndim - 1)), -np.inf, log_odds)
