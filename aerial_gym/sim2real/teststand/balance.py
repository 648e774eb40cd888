"""Probable causes of a changed balance at hover, compared with hovers of the same airframe as declared.

``effort`` is the squared speed of a rotor, or of the voltage that drives it. Thrust is proportional to it, with a factor per
rotor from the baseline.
Letters: R rotors (four), L logs.
"""

import re
from collections.abc import Sequence
from dataclasses import dataclass, replace
from math import exp, inf

import numpy as np
from scipy import special

from aerial_gym.config.robot import RobotCfg
from aerial_gym.errors import ConfigError, DataError
from aerial_gym.sim2real.arrays import Array
from aerial_gym.sim2real.findings import Finding
from aerial_gym.sim2real.json_values import select_fields
from aerial_gym.sim2real.logs.recording import FlightLog
from aerial_gym.sim2real.statistics import Estimate, student_quantile
from aerial_gym.sim2real.teststand.causes import (
    OTHER,
    ROTORS,
    BalanceCause,
    candidate_causes,
    experiments_for_causes,
    prior_probabilities_of_causes,
)
from aerial_gym.sim2real.teststand.hover import FEWEST_WINDOWS, find_hover_rows
from aerial_gym.sim2real.teststand.scatter import Scatter, ScatterFit, fit_scatter, log_evidence_of_cause, pool_scatter
from aerial_gym.sim2real.teststand.statistics import rms

SIGNIFICANCE = 0.01
"""Error probability of the set of remaining causes, and significance level for differences between logs."""

SAME_HEIGHT = 0.15  # Largest height difference [m] from the median; windows beyond it are take-off, landing and moves


@dataclass(frozen=True, kw_only=True)
class HoverEffort:
    """Mean effort of the rotors in one hover."""

    name: str
    effort: Array  # Mean squared speed of each rotor, in the log's unit, (R,)
    windows: int
    voltage: float | None  # Mean battery voltage [V]

    def as_mapping(self) -> dict[str, object]:
        """Return the values for JSON, without the effort, which the shares contain."""
        return select_fields(self, "name", "windows", "voltage")


def hover_effort(log: FlightLog) -> HoverEffort:
    """Return the mean effort of each rotor while a flight hovers at one height."""
    if (speed := log.rotor_states) is None or log.num_rotors != ROTORS:
        raise DataError(
            f"{log.path}: has {log.num_rotors} rotors; the balance at hover gives the thrust of exactly {ROTORS}"
        )
    rows = find_hover_rows(log, speed)
    if log.position is not None:
        height = np.array([log.position[row, 2].mean() for row in rows])
        near = np.abs(height - np.median(height)) < SAME_HEIGHT
        rows = [row for row, kept in zip(rows, near, strict=True) if kept]
    if len(rows) < FEWEST_WINDOWS:
        raise DataError(f"{log.path}: hovers for {len(rows)} windows at one height, needs {FEWEST_WINDOWS}")
    return HoverEffort(
        name=log.name,
        effort=np.mean([(speed[row] ** 2).mean(axis=0) for row in rows], axis=0),
        windows=len(rows),
        voltage=None if log.battery is None else float(np.mean([log.battery[row].mean() for row in rows])),
    )


def repeats_by_condition(hovers: Sequence[HoverEffort]) -> dict[str, list[HoverEffort]]:
    """Return the hovers by condition: names that differ only in a final number belong together."""
    results: dict[str, list[HoverEffort]] = {}
    for hover in hovers:
        results.setdefault(re.sub(r"\d+$", "", hover.name), []).append(hover)
    return results


@dataclass(frozen=True, kw_only=True)
class CauseFit:
    """Fit of one candidate cause to the flights."""

    cause: BalanceCause
    fit: ScatterFit
    params: dict[str, Estimate]
    probability: float = 0.0  # Posterior probability from all logs of the condition
    place: tuple[Estimate, Estimate] | None = None
    """Position x, y of a payload relative to the declared centre of mass [m]; None if its mass may be 0."""

    judged: float | None = None  # P-value of the prediction errors on left-out logs; None without such logs
    held_out: float | None = None  # RMS over rotors of the relative error of predicted effort in left-out logs

    def as_mapping(self) -> dict[str, object]:
        """Return the values for JSON."""
        return {
            **select_fields(self.cause, "name", "motor"),
            **select_fields(self, "params", "place"),
            "misfit_p": self.fit.misfit,
            "probability": self.probability,
            "judged_p": self.judged,
            "held_out_rms": self.held_out,
        }


@dataclass(frozen=True)
class QuantityChange:
    """A quantity before and after, with 95 % intervals from the scatter between logs."""

    baseline: Estimate
    flights: Estimate
    change: Estimate

    def exponential(self) -> "QuantityChange":
        """Return the change of a quantity from the change of its logarithm; its change is then relative."""
        return QuantityChange(
            _exponential_of_estimate(self.baseline),
            _exponential_of_estimate(self.flights),
            _exponential_of_estimate(self.change, 1.0),
        )

    def as_mapping(self) -> dict[str, object]:
        """Return the values for JSON."""
        return select_fields(self, "baseline", "flights", "change")


@dataclass(frozen=True, kw_only=True)
class Balance:
    """Change of the efforts at hover, and its possible causes."""

    verdict: str  # explained, none, ambiguous or unexplained
    candidates: tuple[str, ...]  # Possible causes
    tell_apart: tuple[Finding, ...]  # Experiments that distinguish the candidates
    fits: tuple[CauseFit, ...]  # Fits of all causes; empty if there are too few repeats for a test
    baseline: tuple[HoverEffort, ...]
    flights: tuple[HoverEffort, ...]
    test: tuple[HoverEffort, ...]
    shares: tuple[QuantityChange, ...]  # Share of each rotor in the total effort
    total: QuantityChange  # Total effort in the log's unit; its change is relative
    freedom: int  # Degrees of freedom of the scatter: repeats minus conditions
    scatter: Array  # Relative standard deviation of each rotor's effort between logs of one condition, (R,)
    notes: tuple[Finding, ...] = ()

    def as_mapping(self) -> dict[str, object]:
        """Return the values for JSON."""
        return {
            **select_fields(self, "verdict", "candidates", "fits", "tell_apart", "shares"),
            "sum": self.total.as_mapping(),
            "scatter": {"freedom": self.freedom, "relative_std": self.scatter.tolist()},
            "logs": select_fields(self, "baseline", "flights", "test"),
            "notes": list(self.notes),
        }


def judge_balance(
    baseline: Sequence[HoverEffort], flights: Sequence[HoverEffort], *, robot: RobotCfg,
    test: Sequence[HoverEffort] = (), repeats: Sequence[HoverEffort] = (), added_mass: float | None = None,
) -> Balance:  # fmt: skip
    """Return the probable causes of a change of the rotors' efforts at hover.

    Args:
        baseline: Hovers of the airframe as declared.
        flights: Hovers of the same airframe in the changed condition.
        test: Further hovers in that condition. They contribute to the probabilities and test the fits to ``flights``;
            without them, two or more flights are left out in turn.
        repeats: Hovers in any other conditions, for the scatter between logs of one condition, whose names differ only in
            a final number.
        added_mass: Measured difference of mass from the baseline [kg]. Candidates then have this mass, and none is a
            payload.

    Raises:
        DataError: If no condition has two logs, or they are copies, since the scatter is then unknown.
        ConfigError: If four rotors cannot balance the robot, or the mass is invalid.
    """
    possible, mass = candidate_causes(robot), robot.body.mass
    if added_mass is not None:
        if not -mass < added_mass < inf:
            raise ConfigError(
                f"added_mass = {added_mass!r} kg: must be finite and more than minus the mass of the robot"
            )
        possible = [cause for cause in possible if "payload_mass" not in cause.name]
    filled = [group for group in (list(baseline), list(flights), *repeats_by_condition(repeats).values()) if group]
    if not baseline or not flights or all(len(group) < 2 for group in filled):
        raise DataError(
            "needs a baseline, a flight, and two logs of at least one condition, whose difference is the scatter between logs; "
            "give more logs in --baseline or in --repeats"
        )
    logs = [np.log([hover.effort for hover in group]) for group in filled]
    scatter = pool_scatter(logs)
    if np.linalg.matrix_rank(scatter.squares) < (ROTORS if scatter.freedom >= ROTORS else 1):
        raise DataError("logs of one condition do not differ: are some of them copies? Give each log once")
    share = 1.0 / len(baseline) + 1.0 / len(flights)
    usual = np.exp(logs[0].mean(axis=0)) * (1.0 + (added_mass or 0.0) / mass)
    fits: tuple[CauseFit, ...] = ()
    if scatter.freedom >= ROTORS:
        fits = tuple(_fit_cause(cause, logs[1], usual, scatter, len(baseline)) for cause in possible)
        fits = tuple(_test_on_left_out_logs(fit, flights, test, usual, scatter, len(baseline)) for fit in fits)
        condition = np.log([hover.effort for hover in (*flights, *test)])
        fits = _add_posterior_probabilities(fits, [logs[0], condition, *logs[2:]], usual)
    verdict, candidates = _verdict_and_possible_causes(fits, possible)
    (total,) = _changes_with_intervals([np.log([[hover.effort.sum()] for hover in group]) for group in filled], share)
    shares = _changes_with_intervals(
        [np.array([hover.effort / hover.effort.sum() for hover in group]) for group in filled], share
    )
    notes = _balance_notes(baseline, flights, test, scatter, added_mass)
    notes += [Finding("flights_differ") for fit in fits[-1:] if not _repeats_agree(fit)]
    notes += [Finding("other_cause", "", {"probability": fit.probability}) for fit in fits[-1:] if candidates]
    return Balance(
        verdict=verdict, candidates=candidates, tell_apart=tuple(experiments_for_causes(candidates)), fits=fits,
        baseline=tuple(baseline), flights=tuple(flights), test=tuple(test), shares=tuple(shares),
        total=total.exponential(), freedom=scatter.freedom, scatter=scatter.std, notes=tuple(notes),
    )  # fmt: skip


def _repeats_agree(other: CauseFit) -> bool:
    """Return whether left-out logs agree with the flights, whatever the cause."""
    return other.judged is None or other.judged >= SIGNIFICANCE


def _fit_cause(cause: BalanceCause, efforts: Array, usual: Array, scatter: Scatter, count: int) -> CauseFit:
    """Return a cause fitted to log efforts (L, R), with relative residuals."""
    ratio = np.exp(efforts.mean(axis=0)) / usual
    fit = fit_scatter(1.0 - 1.0 / ratio, cause.columns / ratio[:, None], scatter, 1.0 / len(efforts) + 1.0 / count)
    place = None
    if (
        cause.name == "payload_mass + com_offset"
        and (x := fit.ratio_of_parameters(1, 0))
        and (y := fit.ratio_of_parameters(2, 0))
    ):
        place = x, y
    return CauseFit(cause=cause, fit=fit, params=_physical_parameters(cause, fit), place=place)


def _physical_parameters(cause: BalanceCause, fit: ScatterFit) -> dict[str, Estimate]:
    """Return the physical parameters with 95 % intervals, to first order."""
    values = cause.physical(fit.params)
    steps = 1e-6 * np.eye(fit.params.size)
    slopes = [[v - values[name] for name, v in cause.physical(fit.params + step).items()] for step in steps]
    slope = np.array(slopes).reshape(fit.params.size, len(values)) / 1e-6
    spread = np.sqrt(np.diag(slope.T @ fit.covariance @ slope)) * student_quantile(0.975, fit.freedom)
    return {n: Estimate.from_half_width(v, s) for (n, v), s in zip(values.items(), spread, strict=True)}


def _test_on_left_out_logs(
    estimate: CauseFit, flights: Sequence[HoverEffort], test: Sequence[HoverEffort], usual: Array, scatter: Scatter,
    count: int,
) -> CauseFit:  # fmt: skip
    """Return the fit with its prediction error on left-out logs."""
    if not test and len(flights) < 2:
        return estimate
    parts = (
        [(flights, test)] if test else [([*flights[:n], *flights[n + 1 :]], [flights[n]]) for n in range(len(flights))]
    )
    p_values, errors = [], []
    for seen, left_out in parts:
        fit = _fit_cause(estimate.cause, np.log([hover.effort for hover in seen]), usual, scatter, count).fit
        predicted = 1.0 + estimate.cause.columns @ fit.params
        each = [hover.effort / (usual * predicted) - 1.0 for hover in left_out]
        mean = np.mean(each, axis=0)
        one = scatter.squares / scatter.freedom
        covariance = one * (1.0 / len(left_out) + 1.0 / count) + fit.spread * (1.0 / len(seen) - 1.0 / count)
        p_values.append(scatter.p_value(mean, covariance))
        errors += each
    # Bonferroni correction of the smallest p-value.
    p_value = min(1.0, len(parts) * min(p_values))
    return replace(estimate, judged=p_value, held_out=rms(np.array(errors)))


def _add_posterior_probabilities(
    fits: Sequence[CauseFit], groups: Sequence[Array], usual: Array
) -> tuple[CauseFit, ...]:
    """Return the fits with posterior probabilities, from groups (L, R) of logs: baseline, condition, others."""
    scatter, share = pool_scatter(groups), 1.0 / len(groups[0]) + 1.0 / len(groups[1])
    ratio = np.exp(groups[1].mean(axis=0)) / usual
    evidence = [
        log_evidence_of_cause(1.0 - 1.0 / ratio, fit.cause.columns / ratio[:, None], scatter, share) for fit in fits
    ]
    probability = special.softmax(
        np.array(evidence) + np.log(prior_probabilities_of_causes([fit.cause for fit in fits]))
    )
    return tuple(replace(fit, probability=float(p)) for fit, p in zip(fits, probability, strict=True))


def _verdict_and_possible_causes(
    fits: Sequence[CauseFit], possible: Sequence[BalanceCause]
) -> tuple[str, tuple[str, ...]]:
    """Return the verdict and the possible causes, one name per part at fault.

    These are the smallest set of candidates with a total probability of 1 - `SIGNIFICANCE`. No cause is named if "none" is in
    the set, or if "something else" is more probable than every part.
    """
    if not fits:
        return "ambiguous", tuple(cause.name for cause in possible if cause is not OTHER)
    if not _repeats_agree(fits[-1]):
        return "unexplained", ()
    if fits[0].probability >= SIGNIFICANCE:
        return "none", ()
    probability = np.array([fit.probability for fit in fits])
    ranked = np.argsort(-probability)
    count = 1 + int(np.searchsorted(np.cumsum(probability[ranked]), 1.0 - SIGNIFICANCE))
    parts: dict[str, list[CauseFit]] = {}
    for n in sorted(ranked[:count]):
        parts.setdefault(fits[n].cause.part, []).append(fits[n])
    parts.pop(OTHER.part, None)
    if "none" in parts or not any(
        sum(fit.probability for fit in part) > fits[-1].probability for part in parts.values()
    ):
        return "unexplained", ()
    return ("explained" if len(parts) == 1 else "ambiguous"), tuple(part[0].cause.name for part in parts.values())


def _changes_with_intervals(values: Sequence[Array], share: float) -> list[QuantityChange]:
    """Return the change of each column from the first group (L, columns) to the second; all groups give the scatter."""
    scatter = pool_scatter(values)
    before, after = values[0].mean(axis=0), values[1].mean(axis=0)

    def intervals(value: Array, part: float) -> list[Estimate]:
        return [Estimate.from_half_width(*pair) for pair in zip(value, scatter.half_width(part), strict=True)]

    first, second = intervals(before, 1.0 / len(values[0])), intervals(after, 1.0 / len(values[1]))
    return [QuantityChange(*parts) for parts in zip(first, second, intervals(after - before, share), strict=True)]


def _exponential_of_estimate(estimate: Estimate, less: float = 0.0) -> Estimate:
    return Estimate(value=exp(estimate.value) - less, low=exp(estimate.low) - less, high=exp(estimate.high) - less)


def _balance_notes(
    baseline: Sequence[HoverEffort], flights: Sequence[HoverEffort], test: Sequence[HoverEffort], scatter: Scatter,
    added_mass: float | None,
) -> list[Finding]:  # fmt: skip
    results = [Finding("balance_assumptions")]
    if added_mass is not None:
        results.append(Finding("mass_added", "", {"added_kg": added_mass}))
    if scatter.freedom < ROTORS:
        results.append(Finding("scatter_unknown", "", {"repeats": scatter.freedom, "needed": ROTORS}))
    if not test and len(flights) < 2:
        results.append(Finding("no_unseen_log"))
    volts = [[h.voltage for h in hovers if h.voltage is not None] for hovers in (baseline, [*flights, *test])]
    if volts[0] and volts[1]:
        baseline_v, flights_v = ([min(part), max(part)] for part in volts)
        results.append(Finding("battery_range", "", {"baseline_v": baseline_v, "flights_v": flights_v}))
    return results
