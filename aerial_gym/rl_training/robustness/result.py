"""Figures of a robustness test. Letters: F flights of a cell."""

from collections.abc import Sequence
from dataclasses import dataclass

from scipy.stats import binomtest
from torch import Tensor

from aerial_gym.rl_training.robustness.cell import Cell, Plan
from aerial_gym.rl_training.robustness.wording import advice_text

SIGNIFICANCE = 0.05  # Probability that a loss of success is reported in any cell although there is none
MAJORITY = 0.5  # A cell fails if the interval of its success rate lies below this share


@dataclass(frozen=True, kw_only=True)
class CellResult:
    """Figures of one cell. Flights are compared with clean flights from the same starts."""

    name: str
    label: str
    flights: int
    successes: int
    success_rate: float
    success_low: float  # Low end of the 95 % interval of the success rate (Clopper, Pearson)
    success_high: float  # High end of it
    crash_rate: float
    error_mean_m: float | None  # Mean final error of the flights without a crash [m]; None without any, or a target
    p_value: float  # Exact one-sided McNemar test of a loss of success
    outcome: (
        str  # `fails`, `degrades`, `holds`, `no change` of any flight, or `not shown` as clean flight rarely succeeds
    )
    worst: str  # Variant with the lowest success rate; empty if all have one
    worst_success_rate: float
    advice: str  # Empty without a loss of success


@dataclass(frozen=True, kw_only=True)
class Robustness:
    """Result of a robustness test."""

    clean: CellResult
    cells: tuple[CellResult, ...]  # Worst first
    not_flown: dict[str, str]  # Effects that could not be flown, with the reason
    complete: bool  # False while cells are missing


@dataclass(frozen=True)
class CellFlights:
    """Flights of a cell."""

    cell: Cell
    succeeded: Tensor  # bool (F,)
    crashed: Tensor  # bool (F,)
    error: Tensor  # Final error [m], (F,)
    unchanged: bool  # Whether all flights equal those without the condition bit for bit


def judge(flown: Sequence[CellFlights], plan: Plan) -> Robustness:
    """Return the figures of the cells flown so far; the first is clean flight."""
    clean, *cells = (_result(each, flown[0], plan.num_conditions) for each in flown)
    cells.sort(key=lambda each: (each.success_rate, -each.crash_rate, -(each.error_mean_m or 0.0), each.name))
    complete = len(cells) == plan.num_conditions
    return Robustness(clean=clean, cells=tuple(cells), not_flown=dict(plan.not_flown), complete=complete)


def _result(each: CellFlights, clean: CellFlights, tests: int) -> CellResult:
    cell, flights, successes = each.cell, len(each.succeeded), int(each.succeeded.sum())
    interval = binomtest(successes, flights).proportion_ci(method="exact")
    lost, gained = (
        int((a & ~b).sum()) for a, b in ((clean.succeeded, each.succeeded), (each.succeeded, clean.succeeded))
    )
    p_value = float(binomtest(lost, lost + gained, alternative="greater").pvalue) if lost else 1.0
    limit = SIGNIFICANCE / max(1, tests)
    degraded = p_value < limit
    can_show = 0.5 ** int(clean.succeeded.sum()) < limit  # The p-value of a loss of every success
    outcome = "no change" if each.unchanged else "holds" if can_show else "not shown"
    if degraded:
        outcome = "fails" if interval.high < MAJORITY else "degrades"
    count = min(len(cell.variants), flights)
    rates = [float(each.succeeded[i :: len(cell.variants)].double().mean()) for i in range(count)]
    worst = cell.variants[rates.index(min(rates))].label if min(rates) < max(rates) else ""
    error = each.error[~each.crashed & each.error.isfinite()].double()
    return CellResult(
        name=cell.name, label=cell.label, flights=flights, successes=successes, success_rate=successes / flights,
        success_low=float(interval.low), success_high=float(interval.high),
        crash_rate=float(each.crashed.double().mean()), error_mean_m=float(error.mean()) if error.numel() else None,
        p_value=p_value, outcome=outcome, worst=worst, worst_success_rate=min(rates),
        advice=advice_text(cell, outcome, worst) if degraded else "",
    )  # fmt: skip
