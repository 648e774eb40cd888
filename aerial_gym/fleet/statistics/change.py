"""Change of one effect of a vehicle since one of its flights: evidence, causes, onset and size.

The evidence is a Bayes factor, averaged over causes, kinds, onsets and sizes by a proper prior: its mean over unchanged
vehicles is 1, which makes it an e-value. It counts what remains without the flight that supports the change most.
The prior of the vehicle's base is as broad as that of a change, so that no change explains a steady deviation better.
"""

from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from scipy.special import logsumexp

from aerial_gym.fleet.statistics.model import FleetModel
from aerial_gym.fleet.statistics.moments import Columns, VehicleFlights
from aerial_gym.fleet.statistics.scan import SIZES, ChangeScan, Hypotheses, change_by_size, log_factors_by_size
from aerial_gym.sim2real.arrays import Array, Indices

Kind = Literal["step", "drift"]
KINDS: tuple[Kind, Kind] = ("step", "drift")

MOST_ONSETS = 64  # Onsets that are compared at a time
AMBIGUOUS = float(np.log(20.0))  # Log odds within which causes are not told apart
ODD_LOG_E = float(
    np.log(100.0)
)  # Log evidence of an odd flight: at most one in a hundred unchanged vehicles reaches it
LISTED = 3  # Number of causes that are always listed
IMPROBABLE = 1e-3  # Posterior probability of an onset that is left out of averages
TELLING = 2  # Number of flights with the most support for a change, each left out in turn


@dataclass(frozen=True, kw_only=True)
class Change:
    """One cause of a change, with its onset and the change of its parameters in physical units."""

    effect: str
    rotor: int  # 0 unless the effect is on one rotor
    start: int  # Number of the start of the effect's linearisation
    kind: Kind  # A step, or a drift that grows linearly in time
    log_evidence: float  # Log Bayes factor of this cause against no change
    onset: int  # Index of the first changed flight, the posterior's median
    onset_low: int  # Ends of its 90 % interval
    onset_high: int
    parameters: tuple[str, ...]
    neutral: tuple[float, ...]  # Values without the effect
    change: tuple[float, ...]  # Change from before the onset to the last flight
    std: tuple[float, ...]
    level: tuple[float, ...]  # Values at the last flight
    level_std: tuple[float, ...]
    slope: tuple[float, ...]  # Rates of a drift [per unit of time]; 0 of a step
    slope_std: tuple[float, ...]
    level_slope_cov: tuple[float, ...]  # Covariances of level and slope
    last_time: float  # Time of the last flight


@dataclass(frozen=True, kw_only=True)
class ChangeResult:
    """Evidence that a vehicle has changed, and the causes that may explain it, most probable first."""

    vehicle: str
    flights: int
    log_e: float  # Log evidence of any change against none, without the flight that supports it most
    causes: tuple[Change, ...]
    odd_flight: int | None  # Index of a flight that deviates alone
    firmware_change: tuple[str, str] | None  # Old and new firmware, if it changed within the onset's interval

    @property
    def candidates(self) -> tuple[Change, ...]:
        """Return the causes that the flights do not tell apart; more than one means that the change is ambiguous."""
        return tuple(one for one in self.causes if one.log_evidence >= self.causes[0].log_evidence - AMBIGUOUS)


def find_change(model: FleetModel, flights: VehicleFlights, columns: Columns) -> ChangeResult:
    """Return the evidence of a change of a vehicle, and its causes."""
    empty = ChangeResult(
        vehicle=flights.vehicle, flights=len(flights.firmware), log_e=0.0, causes=(), odd_flight=None, firmware_change=None
    )  # fmt: skip
    information = np.einsum("nkk->k", flights.product)
    shown = np.flatnonzero(information > 0.0)
    hypotheses = Hypotheses.from_columns([columns[k] for k in shown], information[shown])
    if len(flights.firmware) < 2 or not hypotheses.columns:
        return empty
    search = ChangeSearch.from_flights(model, flights, columns, shown, hypotheses)
    table = search.log_evidence()
    log_e, odd = float(logsumexp(table)), search.log_evidence_of_flights()
    if log_e > 0.0:
        best = tuple(int(k) for k in np.unravel_index(table.argmax(), table.shape))
        telling = search.telling_flights(KINDS[best[0]], int(search.onsets()[best[1]]), best[2])
        log_e = min(log_e, *(search.log_e_without(flight) for flight in telling))
    is_odd = logsumexp(odd) > max(log_e, ODD_LOG_E)
    causes = search.causes(table)
    return replace(
        empty, log_e=log_e, causes=causes, odd_flight=int(odd.max(axis=1).argmax()) if is_odd else None,
        firmware_change=firmware_change(flights.firmware, causes[0]),
    )  # fmt: skip


def firmware_change(firmware: tuple[str, ...], change: Change) -> tuple[str, str] | None:
    """Return the firmware change within the onset's interval that is nearest to the onset."""
    within = range(max(change.onset_low, 1), change.onset_high + 1)
    updates = [k for k in within if firmware[k] and firmware[k - 1] and firmware[k] != firmware[k - 1]]
    nearest = min(updates, key=lambda k: abs(k - change.onset), default=None)
    return None if nearest is None else (firmware[nearest - 1], firmware[nearest])


@dataclass(frozen=True, kw_only=True)
class ChangeSearch:
    """Search of one vehicle's flights for a change."""

    scan: ChangeScan
    hypotheses: Hypotheses
    share: Array  # Times as a share of their span, (N,)
    mean: Array  # Mean of the base's prior, (K,)
    columns: Columns
    span: float  # Time from the first flight to the last
    last_time: float

    @classmethod
    def from_flights(
        cls, model: FleetModel, flights: VehicleFlights, columns: Columns, shown: Indices, hypotheses: Hypotheses
    ) -> "ChangeSearch":
        """Return the search with the ``shown`` columns alone."""
        root = np.sqrt(model.var_vehicle[shown] + SIZES[-1] ** 2)
        product, gradient = flights.product[:, shown[:, None], shown], flights.gradient[:, shown]
        mean, time = model.mean[shown], flights.usable_times()
        scan = ChangeScan.from_flights(product, gradient, mean, model.var_flight[shown], root)
        span = float(time[-1] - time[0])
        return cls(
            scan=scan, hypotheses=hypotheses, share=(time - time[0]) / span, mean=mean, span=span, last_time=float(time[-1]),
            columns=[columns[k] for k in shown],
        )  # fmt: skip

    def onsets(self) -> Indices:
        """Return the compared onsets, (J,): all flights but the first, or equally spaced ones."""
        last = self.share.size - 1
        return np.unique(np.linspace(1, last, min(last, MOST_ONSETS)).round().astype(int))

    def patterns(self, kind: Kind, onsets: Indices) -> Array:
        """Return the share of the change in each flight, (J, N)."""
        return change_patterns(kind, onsets, self.share)

    def log_evidence(self, onsets: Indices | None = None) -> Array:
        """Return log Bayes factor plus log prior of each kind, onset and hypothesis, (kinds, J, H)."""
        onsets = self.onsets() if onsets is None else onsets
        factors = np.array([self.scan.log_factors(self.patterns(kind, onsets), self.hypotheses) for kind in KINDS])
        return factors + np.log(onset_weights(onsets) / len(KINDS))[:, None] + self.hypotheses.log_prior

    def log_evidence_of_flights(self) -> Array:
        """Return log Bayes factor plus log prior of a change in one flight alone, (N, H)."""
        return self.scan.log_factors_of_flights(self.hypotheses) + self.hypotheses.log_prior - np.log(self.share.size)

    def log_e_without(self, flight: int) -> float:
        """Return the log evidence of any change without one flight."""
        share = np.delete(self.share, flight)
        if share.size < 2:
            return 0.0
        return float(logsumexp(replace(self, scan=self.scan.without_flight(flight), share=share).log_evidence()))

    def telling_flights(self, kind: Kind, onset: int, hypothesis: int) -> list[int]:
        """Return the flights whose log likelihood a change raises most."""
        places = self.hypotheses.columns[hypothesis]
        pattern = self.patterns(kind, np.array([onset]))[0]
        product, right, shift = self.scan.change_moments(pattern, places)
        logs, (by_size, _) = log_factors_by_size(product, right), change_by_size(product, right)
        step = np.exp(logs - logsumexp(logs)) @ by_size
        base = self.scan.base()
        with_change = np.tile(base + shift @ step, (pattern.size, 1))
        with_change[:, places] += pattern[:, None] * step
        gain = self._log_likelihood(with_change) - self._log_likelihood(np.tile(base, (pattern.size, 1)))
        return np.argsort(-gain, kind="stable")[:TELLING].tolist()

    def _log_likelihood(self, x: Array) -> Array:
        quadratic = (self.scan.product @ x[:, :, None])[:, :, 0]
        return (x * (self.scan.gradient - 0.5 * quadratic)).sum(axis=1)

    def causes(self, table: Array) -> tuple[Change, ...]:
        """Return the causes by falling evidence, the improbable ones left out."""
        of_cause = [table[:, :, self.hypotheses.cause == k] for k in range(len(self.hypotheses.causes))]
        evidence = np.array([logsumexp(part) for part in of_cause]) + np.log(len(of_cause))
        order = np.argsort(-evidence, kind="stable")
        listed = [k for n, k in enumerate(order) if n < LISTED or evidence[k] >= evidence[order[0]] - AMBIGUOUS]
        return tuple(self._describe(k, of_cause[k], float(evidence[k])) for k in listed)

    def _describe(self, cause: int, table: Array, log_evidence: float) -> Change:
        """Return the best kind of change of a cause, from its log evidence (kinds, J, hypotheses of the cause)."""
        kind = KINDS[int(logsumexp(table, axis=(1, 2)).argmax())]
        start = np.flatnonzero(self.hypotheses.cause == cause)[int(logsumexp(table, axis=(0, 1)).argmax())]
        places = self.hypotheses.columns[start]
        onsets, share = self.onset_posterior(kind, places)
        onset, low, high = (int(onsets[np.searchsorted(np.cumsum(share), level)]) for level in (0.5, 0.05, 0.95))
        mean, cov = self._posterior(kind, places, onsets, share)
        width, own = places.size, [self.columns[k] for k in places]
        scale = np.array([column.scale for column in own])
        mean, cov = mean * np.tile(scale, 3), cov * np.outer(np.tile(scale, 3), np.tile(scale, 3))
        neutral = np.array([column.neutral for column in own])
        std = np.sqrt(np.maximum(cov.diagonal(), 0.0))
        parts = (slice(0, width), slice(width, 2 * width), slice(2 * width, None))
        change, level, slope = (mean[part] for part in parts)
        texts = dict(zip(("std", "level_std", "slope_std"), (tuple(std[part].tolist()) for part in parts), strict=True))
        effect, rotor = self.hypotheses.causes[cause]
        return Change(
            effect=effect, rotor=rotor, start=own[0].start, kind=kind, log_evidence=log_evidence,
            onset=onset, onset_low=low, onset_high=high,
            parameters=tuple(column.parameter for column in own), neutral=tuple(neutral.tolist()),
            change=tuple(change.tolist()), level=tuple((neutral + level).tolist()), slope=tuple(slope.tolist()),
            level_slope_cov=tuple(cov[parts[1], parts[2]].diagonal().tolist()), last_time=self.last_time, **texts,
        )  # fmt: skip

    def onset_posterior(self, kind: Kind, places: Indices) -> tuple[Indices, Array]:
        """Return onsets and their posterior probabilities; many flights are searched again about the probable ones."""
        only = Hypotheses(causes=(("", 0),), cause=np.zeros(1, dtype=int), columns=(places,))
        low, high = 1, self.share.size - 1
        while True:
            onsets = np.unique(np.linspace(low, high, min(high - low + 1, MOST_ONSETS)).round().astype(int))
            logs = self.scan.log_factors(self.patterns(kind, onsets), only)[:, 0] + np.log(onset_weights(onsets))
            share = np.exp(logs - logsumexp(logs))
            probable = np.flatnonzero(share > IMPROBABLE)
            first, end = onsets[max(probable[0] - 1, 0)], onsets[min(probable[-1] + 1, onsets.size - 1)]
            if onsets.size == high - low + 1 or end - first == high - low:
                return onsets, share
            low, high = int(first), int(end)

    def _posterior(self, kind: Kind, places: Indices, onsets: Indices, share: Array) -> tuple[Array, Array]:
        """Return mean (3 P,) and covariance (3 P, 3 P) of change, level at the last flight and slope, in units of scale."""
        means, covs, weights = [], [], []
        base, base_cov = self.mean[places] + self.scan.base()[places], self.scan.base_cov(places)
        width, likely = places.size, share > IMPROBABLE
        for onset, pattern, weight in zip(
            onsets[likely], self.patterns(kind, onsets[likely]), share[likely], strict=True
        ):
            product, right, shift = self.scan.change_moments(pattern, places)
            unit = np.eye(width)
            duration = (1.0 - self.share[onset - 1]) * self.span
            rate = 1.0 / duration if kind == "drift" and duration > 0.0 else 0.0
            effects = np.concatenate((unit, pattern[-1] * unit + shift[places], rate * unit))  # of the change, (3 P, P)
            change, cov = change_by_size(product, right)
            logs = log_factors_by_size(product, right)
            mean = change @ effects.T
            mean[:, width : 2 * width] += base
            cov = effects @ cov @ effects.T
            cov[:, width : 2 * width, width : 2 * width] += base_cov
            means.append(mean)
            covs.append(cov)
            weights.append(weight * np.exp(logs - logsumexp(logs)))
        return mixture_moments(np.concatenate(weights), np.concatenate(means), np.concatenate(covs))


def change_patterns(kind: Kind, onsets: Indices, time: Array) -> Array:
    """Return the share of the change in each flight, (J, N): a drift grows from the flight before its onset."""
    changed = np.arange(time.size) >= onsets[:, None]
    if kind == "step":
        return changed.astype(float)
    start = time[onsets - 1][:, None]
    return changed * (time - start) / np.maximum(time[-1] - start, 1e-300)


def subtract_change(flights: VehicleFlights, change: Change, columns: Columns) -> VehicleFlights:
    """Return the flights without a change."""
    own = {
        c.parameter: k
        for k, c in enumerate(columns)
        if (c.effect, c.rotor, c.start) == (change.effect, change.rotor, change.start)
    }
    places = [own[name] for name in change.parameters]
    step = np.array(change.change) / np.array([columns[k].scale for k in places])
    pattern = change_patterns(change.kind, np.array([change.onset]), flights.usable_times())[0]
    return replace(flights, gradient=flights.gradient - pattern[:, None] * (flights.product[:, :, places] @ step))


def mixture_moments(weight: Array, mean: Array, cov: Array) -> tuple[Array, Array]:
    """Return mean and covariance of a mixture with weights (M,), means (M, P) and covariances (M, P, P)."""
    weight = weight / weight.sum()
    total = weight @ mean
    away = mean - total
    return total, np.tensordot(weight, cov + away[:, :, None] * away[:, None, :], axes=1)


def onset_weights(onsets: Indices) -> Array:
    """Return the prior probability of the onsets that each compared one stands for, (J,)."""
    middle = 0.5 * (onsets[1:] + onsets[:-1])
    widths = np.diff(np.concatenate(([onsets[0] - 0.5], middle, [onsets[-1] + 0.5])))
    return widths / widths.sum()
