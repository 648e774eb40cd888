"""Change of one effect of a vehicle since one of its flights: evidence, causes, onset and size.

The evidence is a Bayes factor, averaged over causes, kinds, onsets and sizes by a proper prior: its mean over unchanged
vehicles is 1, which makes it an e-value. It counts what remains without the flight that supports the change most.
The prior of the vehicle's base is as broad as that of a change, so that no change explains a steady deviation better.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from typing import Literal, Self

import numpy as np
from scipy.interpolate import CubicSpline

from aerial_gym.fleet.statistics.fit import FREEDOM, FleetModel
from aerial_gym.fleet.statistics.moments import Columns, VehicleFlights, usable_times
from aerial_gym.fleet.statistics.scan import SIZES, ChangeScan, Hypotheses, change_posterior, log_sum, mixture_moments
from aerial_gym.sim2real.arrays import Array, Indices

Support = Mapping[tuple[str, int], Array]
"""Log Bayes factors of a change of each cause, averaged over kinds, onsets and starts, (sizes,)."""
Kind = Literal["step", "drift"]
KINDS: tuple[Kind, Kind] = ("step", "drift")

MOST_ONSETS = 64  # Onsets that are compared first
ROUNDS = 3  # Of as many onsets each, added about the probable ones
AMBIGUOUS = float(np.log(20.0))  # Log odds within which causes, or a step and a drift, are not told apart
EVIDENT = float(np.log(100.0))  # Log evidence that at most one in a hundred unchanged vehicles reaches
LISTED = 3  # Number of causes that are always listed
IMPROBABLE = 1e-3  # Posterior probability of an onset that is left out of averages
SCATTER = 2.0 ** np.arange(-3, 13)  # Factors on the variance between the flights of one vehicle
FINE = 1001  # Points of the integral over these factors, between which the logarithms are splines
FEWEST_FLIGHTS = 4  # Of a change, since it must remain without one of them: two before it and two after it
ODD_SHARE = 0.1  # Largest share of flights that are left out as odd; one always may
TELLING = 2  # Number of flights with the most support for a change, each left out in turn


@dataclass(frozen=True, kw_only=True)
class Change:
    """One cause of a change, with its onset and the change of its parameters in physical units."""

    effect: str
    rotor: int  # 0 unless the effect is on one rotor
    kind: Kind | Literal[""]  # A step, a drift that grows linearly in time, or "" if the flights do not tell them apart
    log_evidence: float  # Log Bayes factor of this cause against no change
    onset: int  # Index of the first changed flight, the posterior's median
    onset_low: int  # Ends of its 90 % interval
    onset_high: int
    parameters: tuple[str, ...]
    change: tuple[float, ...]  # Change from before the onset to the last flight
    std: tuple[float, ...]
    level: tuple[float, ...]  # Values at the last flight
    level_std: tuple[float, ...]
    slope: tuple[float, ...]  # Rates of a drift [per unit of time]; 0 of a step
    slope_std: tuple[float, ...]
    level_slope_cov: tuple[float, ...]  # Covariances of level and slope
    last_time: float  # Time of the last flight

    def count_flights(self, kept: Indices, end: int) -> Self:
        """Return the change with onsets among all flights, from the indices of those that were judged."""
        names, first = ("onset", "onset_low", "onset_high"), int(np.argmin(kept)) if end else 0
        return replace(self, **{name: int(kept[max(getattr(self, name), first)]) for name in names})


@dataclass(frozen=True, kw_only=True)
class ChangeResult:
    """Evidence that a vehicle has changed, and the causes that may explain it, most probable first."""

    vehicle: str
    flights: int
    log_e: float = 0.0  # Log evidence of any change against none, without the flight that supports it most
    support: Support = field(default_factory=dict)  # With all flights; without the best cause, where that is clear
    robust_support: tuple[Support, ...] = ()  # Of the candidates, without each of the most telling flights
    causes: tuple[Change, ...] = ()  # Empty with less than two flights, or without a visible effect
    odd_flights: tuple[int, ...] = ()  # Indices of flights that deviate alone, and are left out
    firmware_change: tuple[str, str] | None = None  # Old and new firmware, if it changed within the onset's interval
    end: int | None = None  # Index of the first flight after the change, unless it lasts
    second: "ChangeResult | None" = None  # Change that the flights show beside it, at another time

    @property
    def choice_cost(self) -> float:
        """Return the log evidence that the choice of odd flights and of an end costs: the logarithm of the flights for each."""
        return (len(self.odd_flights) + (self.end is not None)) * float(np.log(max(self.flights, 1)))

    @property
    def is_evident(self) -> bool:
        """Return whether at most one in a hundred unchanged vehicles reaches the evidence."""
        return self.log_e > EVIDENT

    def count_flights(self, kept: Indices, end: int = 0) -> Self:
        """Return the result with flights counted among all; of those judged, the ones after the end of a change come first."""
        return replace(
            self, causes=tuple(one.count_flights(kept, end) for one in self.causes),
            odd_flights=tuple(int(kept[k]) for k in self.odd_flights), end=None if self.end is None else int(kept[self.end]),
            second=self.second and self.second.count_flights(kept),
        )  # fmt: skip

    def renumber(self, numbers: Indices) -> Self:
        """Return the result with the numbers of the flights in place of their indices."""
        end, second = self.end, self.second
        return replace(
            self.count_flights(numbers), odd_flights=tuple(int(numbers[k]) for k in self.odd_flights),
            end=None if end is None else int(numbers[end]), second=second and second.renumber(numbers),
        )  # fmt: skip

    def is_separate(self, first: "ChangeResult") -> bool:
        """Return whether the change is evident, and its onset's interval apart from that of another one."""
        own, other = self.causes[0], first.causes[0]
        return self.is_evident and (own.onset_low > other.onset_high or own.onset_high < other.onset_low)

    @property
    def candidates(self) -> tuple[Change, ...]:
        """Return the causes that the flights do not tell apart; more than one means that the change is ambiguous."""
        return tuple(one for one in self.causes if one.log_evidence >= self.causes[0].log_evidence - AMBIGUOUS)


def find_change(model: FleetModel, flights: VehicleFlights, columns: Columns) -> ChangeResult:
    """Return the evidence of a change of a vehicle, and its causes.

    Flights that deviate alone are left out one by one. A change that ends is one that lasts if the flights after its end come
    first. Each such choice costs the logarithm of the number of flights.
    """
    count, flights = len(flights.firmware), replace(flights, time=usable_times(flights.time)[0])
    kept, odd = np.arange(count), list[int]()
    while True:
        finding = _find_in_hypotheses(model, flights.select(kept), columns)
        if finding.odd is None or len(odd) >= max(1, int(ODD_SHARE * count)):
            break
        odd.append(int(kept[finding.odd]))
        kept = np.delete(kept, finding.odd)
    result, end, second = finding.result, None, None
    if finding.end is not None:
        ended = _find_in_hypotheses(model, flights.select(np.roll(kept, -finding.end)), columns).result
        if ended.log_e - np.log(count) > result.log_e:
            result, end, kept = ended, int(kept[finding.end]), np.roll(kept, -finding.end)
    if finding.rest is not None and end is None:
        second = _find_in_hypotheses(model, finding.rest, columns).result
        second = second.count_flights(kept) if second.is_separate(result) else None
    result = replace(result.count_flights(kept, end or 0), flights=count, odd_flights=tuple(sorted(odd)), end=end)
    return replace(result, log_e=float(result.log_e - result.choice_cost), second=second)


@dataclass(frozen=True, kw_only=True)
class _Finding:
    """Change among flights that all count, and what else may explain them."""

    result: ChangeResult
    odd: int | None = None  # Flight that rather deviates alone
    end: int | None = None  # First flight after a change that does not last
    rest: VehicleFlights | None = None  # Flights without the change


def _find_in_hypotheses(model: FleetModel, flights: VehicleFlights, columns: Columns) -> _Finding:
    result = ChangeResult(vehicle=flights.vehicle, flights=len(flights.firmware))
    shown = np.flatnonzero(np.einsum("nkk->k", flights.product) > 0.0)
    own = [columns[k] for k in shown]
    hypotheses = Hypotheses.from_columns(own, np.ones(shown.size, dtype=bool))
    if result.flights < 2 or not hypotheses.causes:
        return _Finding(result=result)
    root = np.sqrt(model.var_vehicle[shown] + SIZES[-1] ** 2)
    moments = flights.product[:, shown[:, None], shown], flights.gradient[:, shown]
    scan = ChangeScan.from_flights(*moments, model.mean[shown], model.var_flight[shown], root)
    onsets = spread_onsets(np.arange(1, result.flights), MOST_ONSETS)
    search = ChangeSearch(scan=scan, hypotheses=hypotheses, time=usable_times(flights.time)[0], onsets=onsets).refine()
    table, var_flight = search.log_evidence(), model.var_flight[shown]
    log_e, searches = float(log_sum(table)), [search]
    support = search.support(log_sum(table, axis=(0, 1)))
    robust_support, end, rest = (support,), None, None
    if result.flights < FEWEST_FLIGHTS:
        log_e = min(log_e, 0.0)
    elif log_e > 0.0:
        end = search.end_of_change(table)
        searches.append(search.without_change(table))
        support = searches[-1].support_beside_change(support)
        robust_support = search.robust_support(table, var_flight)
        log_e = min(log_e_of_support(one, len(support)) for one in robust_support)
        search = search.with_own_scatter(table, var_flight)
        table = search.log_evidence()
        gradient = flights.gradient.copy()
        gradient -= np.einsum("nkp,np->nk", flights.product[:, :, shown], search.best_change(table)[1])
        rest = replace(flights, gradient=gradient)
    causes = search.causes(table, model.mean[shown], own)
    odd_log_e, number = max(one.odd_flight(var_flight) for one in searches)
    is_odd = odd_log_e > max(log_e, EVIDENT) and result.flights >= FEWEST_FLIGHTS
    change = firmware_change(flights.firmware, causes[0])
    result = replace(
        result, log_e=log_e, support=support, robust_support=robust_support, causes=causes, firmware_change=change
    )
    return _Finding(result=result, odd=number if is_odd else None, end=end, rest=rest if result.is_evident else None)


def log_e_of_support(support: Support, causes: int) -> float:
    """Return the log evidence of a change of any of some equally probable causes."""
    return float(log_sum(np.array(list(support.values())))) - float(np.log(causes * len(SIZES)))


def firmware_change(firmware: tuple[str, ...], change: Change) -> tuple[str, str] | None:
    """Return the firmware change within the onset's interval that is nearest to the onset."""
    pairs = {k: (firmware[k - 1], firmware[k]) for k in range(change.onset_low, change.onset_high + 1)}
    updates = [k for k, (old, new) in pairs.items() if old and new and old != new]
    return pairs[min(updates, key=lambda k: abs(k - change.onset))] if updates else None


def change_patterns(kind: Kind, onsets: Indices, time: Array) -> Array:
    """Return the share of the change in each flight, (J, N): a drift grows from the flight before its onset."""
    changed = np.arange(time.size) >= onsets[:, None]
    if kind == "step":
        return changed.astype(float)
    start = time[onsets - 1][:, None]
    return changed * (time - start) / np.maximum(time[-1] - start, 1e-300)


@dataclass(frozen=True, kw_only=True)
class ChangeSearch:
    """Search of one vehicle's flights for a change."""

    scan: ChangeScan
    hypotheses: Hypotheses
    time: Array  # (N,)
    onsets: Indices  # Compared onsets, (J,)

    def refine(self) -> "ChangeSearch":
        """Return the search with more onsets about those that are probable for either kind, if there is evidence."""
        search, flights = self, np.arange(1, self.time.size)
        for _ in range(ROUNDS):
            onsets, logs = search.onsets, log_sum(search.log_evidence(), axis=(2, 3))
            probable = (logs > log_sum(logs, axis=1)[:, None] + np.log(IMPROBABLE)).any(axis=0)
            after = np.searchsorted(onsets, flights)
            added = flights[(onsets[after] != flights) & (probable[after] | probable[after - 1])]
            if not added.size or log_sum(logs) <= 0.0:
                break
            search = replace(search, onsets=np.union1d(onsets, spread_onsets(added, MOST_ONSETS)))
        return search

    def log_evidence(self) -> Array:
        """Return log Bayes factor plus log prior of each kind, onset, hypothesis and size, (kinds, J, H, sizes)."""
        onsets = self.onsets
        patterns = np.concatenate([change_patterns(kind, onsets, self.time) for kind in KINDS])
        factors = self.scan.log_factors(patterns, self.hypotheses)
        priors = np.log(onset_weights(onsets))[:, None] + self.hypotheses.log_prior
        return factors.reshape(len(KINDS), *priors.shape, -1) + (priors - np.log(len(KINDS) * len(SIZES)))[..., None]

    def log_evidence_by_size(self) -> Array:
        """Return the log evidence of each hypothesis and size, (H, sizes)."""
        return log_sum(self.log_evidence(), axis=(0, 1))

    def support(self, log_evidence: Array) -> Support:
        """Return the log Bayes factors of the causes, from the log evidence by size, (H, sizes)."""
        causes, own = self.hypotheses.causes, self.hypotheses.cause
        logs = log_evidence + np.log(len(causes) * len(SIZES))
        return {causes[k]: log_sum(logs[own == k], axis=0) for k in np.unique(own)}

    def log_evidence_of_flights(self) -> Array:
        """Return log Bayes factor plus log prior of a change in one flight alone, (N, H)."""
        return self.scan.log_factors_of_flights(self.hypotheses) + self.hypotheses.log_prior - np.log(self.time.size)

    def support_beside_change(self, support: Support) -> Support:
        """Return the support, that of causes other than the candidates from this search, which is without their change."""
        best, own = max(map(log_sum, support.values())), self.support(self.log_evidence_by_size())
        return {cause: logs if log_sum(logs) >= best - AMBIGUOUS else own[cause] for cause, logs in support.items()}

    def robust_support(self, table: Array, var_flight: Array) -> tuple[Support, ...]:
        """Return the support that remains without each of the most telling flights, with uncertain scatter."""
        part, count = self.search_of_candidates(log_sum(table, axis=(0, 1, 3))), self.time.size
        parts = [part.select(np.delete(np.arange(count), flight)) for flight in self.flights_in_support(table)]
        tables = [one.with_scatter(var_flight, ChangeSearch.log_evidence_by_size)[0] for one in parts]
        return tuple(one.support(own) for one, own in zip(parts, tables, strict=True))

    def with_own_scatter(self, table: Array, var_flight: Array) -> "ChangeSearch":
        """Return the search with the most probable variance between flights, at least the fleet's.

        Causes, onset and size are then as uncertain as this vehicle's own scatter makes them.
        """
        part = self.search_of_candidates(log_sum(table, axis=(0, 1, 3)))
        places = np.unique(np.concatenate(part.hypotheses.columns))
        factor = max(part.with_scatter(var_flight, ChangeSearch.log_evidence_by_size)[1], 1.0)
        return replace(self, scan=self.scan.with_scatter(places, (factor - 1.0) * var_flight[places])[0]).refine()

    def odd_flight(self, var_flight: Array) -> tuple[float, int]:
        """Return the log evidence that one flight deviates alone, with uncertain scatter, and its index."""
        table = self.log_evidence_of_flights()
        if (log_e := float(log_sum(table))) > EVIDENT:
            part = self.search_of_candidates(log_sum(table, axis=0))
            log_e = float(log_sum(part.with_scatter(var_flight, ChangeSearch.log_evidence_of_flights)[0]))
        return log_e, int(table.max(axis=1).argmax())

    def search_of_candidates(self, log_evidence: Array) -> "ChangeSearch":
        """Return the search of the hypotheses that are not told apart from the best one, by evidence (H,)."""
        return replace(
            self, hypotheses=self.hypotheses.select(np.flatnonzero(log_evidence >= log_evidence.max() - AMBIGUOUS))
        )

    def select(self, flights: Indices) -> "ChangeSearch":
        """Return the search of some flights, by indices."""
        scan = replace(self.scan, product=self.scan.product[flights], gradient=self.scan.gradient[flights])
        onsets = np.unique(np.clip(np.searchsorted(flights, self.onsets), 1, flights.size - 1))
        return replace(self, scan=scan, time=self.time[flights], onsets=onsets)

    def with_scatter(self, var_flight: Array, evidence: "Callable[[ChangeSearch], Array]") -> tuple[Array, float]:
        """Return the log evidence, as that with the fleet's scatter, if the variance between this vehicle's flights is unknown.

        In the columns that may have changed it is ``factor var_flight``, with an inverse gamma prior of the factor.
        The second value is the most probable factor with a change.
        """
        places = np.unique(np.concatenate(self.hypotheses.columns))
        steady, changed = [], []
        for factor in SCATTER:
            scan, constant = self.scan.with_scatter(places, (factor - 1.0) * var_flight[places])
            steady.append(constant + scan.log_marginal - 0.5 * FREEDOM * (np.log(factor) + 1.0 / factor))
            changed.append(evidence(replace(self, scan=scan)))
        logs = np.log(SCATTER)
        fine = np.linspace(logs[0], logs[-1], FINE)
        prior = CubicSpline(logs, steady)(fine)
        table = CubicSpline(logs, changed)(fine) + prior.reshape(-1, *np.ones_like(changed[0].shape))
        total = log_sum(table, axis=tuple(range(1, table.ndim)))
        return log_sum(table, axis=0) - log_sum(prior), float(np.exp(fine[total.argmax()]))

    def end_of_change(self, table: Array) -> int | None:
        """Return the first flight after a change that ends, if that explains the flights better than one that lasts.

        From the best step on, start and end are improved in turn, for its hypothesis alone.
        """
        flights, (onset, hypothesis) = (
            np.arange(self.time.size),
            np.unravel_index(log_sum(table[0], axis=2).argmax(), table.shape[1:3]),
        )
        only, side = self.hypotheses.select([int(hypothesis)]), int(self.onsets[onset])
        lasting = change_patterns("step", flights[1:], self.time), change_patterns("drift", flights[1:], self.time)
        best = log_sum(self.scan.log_factors(np.concatenate(lasting), only), axis=(1, 2)).max()
        for _ in range(2):
            starts, ends = np.minimum(flights, side), np.maximum(flights, side)
            patterns = (flights >= starts[:, None]) & (flights < ends[:, None])
            logs = log_sum(self.scan.log_factors(patterns.astype(float), only), axis=(1, 2))
            logs[(starts < 2) | (ends - starts < 2) | (ends > self.time.size - 2)] = -np.inf
            place = int(logs.argmax())
            end, side = ends[place], place
        return int(end) if logs[place] > best else None

    def flights_in_support(self, table: Array) -> list[int]:
        """Return the flights whose log likelihood the most probable change raises most."""
        base, change, shift = self.best_change(table)
        gain = self._log_likelihood(base + shift + change) - self._log_likelihood(base)
        return np.argsort(-gain, kind="stable")[:TELLING].tolist()

    def without_change(self, table: Array) -> "ChangeSearch":
        """Return the search of the flights without their most probable change."""
        change = self.best_change(table)[1]
        gradient = self.scan.gradient - (self.scan.product @ change[:, :, None])[:, :, 0]
        return replace(self, scan=replace(self.scan, gradient=gradient))

    def best_change(self, table: Array) -> tuple[Array, Array, Array]:
        """Return the base (K,), the most probable change of the flights, (N, K), and the shift of the base with it, (K,)."""
        logs = log_sum(table, axis=3)
        kind, onset, hypothesis = np.unravel_index(logs.argmax(), logs.shape)
        places = self.hypotheses.columns[hypothesis]
        patterns = change_patterns(KINDS[kind], self.onsets[[onset]], self.time)
        product, right, side = self.scan.change_moments(patterns, places[None])
        weight, mean, _ = change_posterior(product[0, 0], right[0, 0])
        change = np.zeros(self.scan.gradient.shape)
        change[:, places] = patterns[0][:, None] * (weight @ mean)
        return self.scan.base(), change, -self.scan.base(weight @ mean @ side[0, 0])[0]

    def _log_likelihood(self, x: Array) -> Array:
        x = np.broadcast_to(x, self.scan.gradient.shape)
        return (x * (self.scan.gradient - 0.5 * (self.scan.product @ x[:, :, None])[:, :, 0])).sum(axis=1)

    def causes(self, table: Array, mean: Array, columns: Columns) -> tuple[Change, ...]:
        """Return the causes by falling evidence, the improbable ones left out."""
        logs = log_sum(table, axis=3)
        of_cause = [logs[:, :, self.hypotheses.cause == k] for k in range(len(self.hypotheses.causes))]
        evidence = np.array([log_sum(part) for part in of_cause]) + np.log(len(of_cause))
        order = np.argsort(-evidence, kind="stable")
        least = max(float(evidence.max()) - AMBIGUOUS, 0.0)
        listed = [k for n, k in enumerate(order) if n < LISTED or evidence[k] >= least]
        return tuple(self._describe(k, of_cause[k], float(evidence[k]), mean, columns) for k in listed)

    def _describe(self, cause: int, table: Array, log_evidence: float, mean: Array, columns: Columns) -> Change:
        """Return the best kind of change of a cause, from its log evidence (kinds, J, hypotheses of the cause)."""
        logs = log_sum(table, axis=(1, 2))
        kind = KINDS[int(logs.argmax())]
        is_clear = abs(logs[0] - logs[1]) > AMBIGUOUS
        start = np.flatnonzero(self.hypotheses.cause == cause)[int(log_sum(table, axis=(0, 1)).argmax())]
        places = self.hypotheses.columns[start]
        onsets, shares = self.onsets, np.array([self.onset_posterior(one, places) for one in KINDS])
        share = np.exp(logs - log_sum(logs)) @ shares
        onset, low, high = onsets[np.searchsorted(np.cumsum(share), (0.5, 0.05, 0.95))].tolist()
        average, cov = self._posterior(kind, places, onsets, shares[logs.argmax()], mean[places])
        own = [columns[k] for k in places]
        units = np.array([column.scale for column in own])
        average = average.reshape(3, -1) * units
        average[1] += [column.neutral for column in own]
        std = np.sqrt(cov.diagonal()).reshape(3, -1) * units
        rows = [tuple(row) for row in np.stack((average, std), axis=1).reshape(6, -1).tolist()]
        level_slope = cov[places.size : 2 * places.size, 2 * places.size :].diagonal() * units**2
        names = ("change", "std", "level", "level_std", "slope", "slope_std")
        return Change(
            effect=own[0].effect, rotor=own[0].rotor, kind=kind if is_clear else "", log_evidence=log_evidence,
            onset=onset, onset_low=low, onset_high=high, parameters=tuple(column.parameter for column in own),
            level_slope_cov=tuple(level_slope.tolist()), last_time=float(self.time[-1]),
            **dict(zip(names, rows, strict=True)),
        )  # fmt: skip

    def onset_posterior(self, kind: Kind, places: Indices) -> Array:
        """Return the posterior probabilities of the onsets, (J,)."""
        only = Hypotheses(causes=(("", 0),), cause=np.zeros(1, dtype=int), columns=(places,), log_prior=np.zeros(1))
        logs = log_sum(self.scan.log_factors(change_patterns(kind, self.onsets, self.time), only)[:, 0], axis=1)
        logs += np.log(onset_weights(self.onsets))
        return np.exp(logs - log_sum(logs))

    def _posterior(
        self, kind: Kind, places: Indices, onsets: Indices, share: Array, mean: Array
    ) -> tuple[Array, Array]:
        """Return mean (3 P,) and covariance (3 P, 3 P) of change, level at the last flight and slope, in units of scale."""
        likely = share > IMPROBABLE
        onsets, unit = onsets[likely], np.eye(places.size)
        patterns = change_patterns(kind, onsets, self.time)
        product, right, side = (part[:, 0] for part in self.scan.change_moments(patterns, places[None]))
        weight, change, cov = change_posterior(product, right)
        shift = -self.scan.base(side)[..., places].swapaxes(-1, -2)  # of the base by the change, (J, P, P)
        duration = self.time[-1] - self.time[onsets - 1]
        rate = np.divide(kind == "drift", duration, out=np.zeros(onsets.size), where=duration > 0.0)
        level_effect = patterns[:, -1, None, None] * unit + shift
        effects = np.concatenate(np.broadcast_arrays(unit, level_effect, rate[:, None, None] * unit), axis=1)
        means = (effects[:, None] @ change[..., None])[..., 0]
        covs = effects[:, None] @ cov @ effects[:, None].swapaxes(-1, -2)
        level = slice(places.size, 2 * places.size)
        means[..., level] += mean + self.scan.base()[places]
        covs[..., level, level] += self.scan.base_cov(places)
        flat = (share[likely, None] * weight).ravel()
        return mixture_moments(flat, means.reshape(flat.size, -1), covs.reshape(flat.size, *covs.shape[2:]))


def spread_onsets(values: Indices, most: int) -> Indices:
    """Return at most some values, equally spaced in their order."""
    return values[np.unique(np.linspace(0, values.size - 1, min(values.size, most)).round().astype(int))]


def onset_weights(onsets: Indices) -> Array:
    """Return the prior probability of the onsets that each compared one stands for, (J,)."""
    ends = np.concatenate(([onsets[0] - 0.5], 0.5 * (onsets[1:] + onsets[:-1]), [onsets[-1] + 0.5]))
    return np.diff(ends) / (ends[-1] - ends[0])
