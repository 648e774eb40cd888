"""Outcomes of a correction, and the decision of a verdict: its kind, its candidates, and what stays open.

Letters: T rows, C channels, W windows, H horizons.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from aerial_gym.sim2real.findings import Finding, Severity
from aerial_gym.sim2real.identify.least_squares.moments import flight_of_rows, time_block_of_rows
from aerial_gym.sim2real.judge.evaluation import ModelEvaluation, rollout_rises
from aerial_gym.sim2real.predict.model_params import ModelParams
from aerial_gym.sim2real.predict.predictor import Predictor
from aerial_gym.sim2real.statistics import Rise, rise_with_interval

BETTER, SAME, WORSE, NOT_SHOWN = "better", "same", "worse", "not shown"

NOTHING_NAMED = ("none", NOT_SHOWN)  # Verdicts without an effect that the test flights show


@dataclass(frozen=True, kw_only=True)
class Outcome:
    """Change of one error of the test flights from the declared to the corrected model."""

    quantity: str  # Channel, or variant and quantity of a rollout: ``free.velocity``
    horizon: float | None = None  # Horizon of a rollout [s]; None for a channel
    rise: Rise  # Relative change of its rms with the 95 % interval over flights
    least: float  # Smallest relative change that is material

    @property
    def name(self) -> str:
        """Return the unique name: the quantity, for a rollout with its horizon [s]."""
        return self.quantity if self.horizon is None else f"{self.quantity}.{self.horizon:g}"

    @property
    def state(self) -> str:
        """Return better, same, worse or not shown.

        Same: the interval holds no material change; better or worse: it lies on one side of zero, or the flights agree on
        that side; else it is not shown.
        """
        if -self.least < self.rise.low and self.rise.high < self.least:
            return SAME
        if self.rise.falls(least=self.least):
            return BETTER
        return WORSE if self.rise.reaches(0.0, least=self.least) else NOT_SHOWN

    @property
    def is_possibly_worse(self) -> bool:
        """Return whether the error rises by a material share that may be chance."""
        return self.state == NOT_SHOWN and self.rise.value >= self.least

    @property
    def is_materially_worse(self) -> bool:
        """Return whether the error rises by a material share for certain."""
        return self.state == WORSE and self.rise.reaches(self.least, least=self.least)

    def as_mapping(self) -> dict[str, object]:
        """Return it for JSON."""
        return {"state": self.state, **self.rise.as_mapping()}


def error_outcomes(
    predictor: Predictor, models: tuple[ModelParams, ModelParams], evaluations: tuple[ModelEvaluation, ModelEvaluation],
    *, least: float,
) -> tuple[Outcome, ...]:  # fmt: skip
    """Return the outcome of every channel and every rollout from the declared to the corrected model."""
    results = channel_outcomes(predictor, models, least=least)
    old, new = (evaluation.rollouts for evaluation in evaluations)
    for variant, errors in new.items():
        for quantity, horizon, rise in rollout_rises(errors, old[variant]):
            results.append(Outcome(quantity=f"{variant}.{quantity}", horizon=horizon, rise=rise, least=least))
    return tuple(results)


def channel_outcomes(predictor: Predictor, models: tuple[ModelParams, ModelParams], *, least: float) -> list[Outcome]:
    """Return the outcome of every channel from the first to the second model."""
    before, after = (np.concatenate(predictor.residuals(model)) for model in models)
    rises = rise_with_interval(after, before, time_block_of_rows(predictor.times), flight_of_rows(predictor.times))
    return [Outcome(quantity=c.name, rise=r, least=least) for c, r in zip(predictor.channels, rises, strict=True)]


@dataclass(frozen=True, kw_only=True)
class Decision:
    """Kind of a verdict with its candidates and open points."""

    kind: str  # explained, none, not shown, unexplained or ambiguous
    candidates: tuple[str, ...]  # Named effects and those that fit the flights equally well
    findings: tuple[Finding, ...]  # Residuals that remain and questions that stay open


def decision_with_harm(made: Decision, harmed: Sequence[Outcome]) -> Decision:
    """Return the decision; a correction with which errors of the test flights get worse explains nothing."""
    if made.kind != "explained" or not harmed:
        return made
    findings = tuple(one for one in made.findings if one.code != "remains_near_floor")
    return replace(made, kind="unexplained", findings=findings)


def decision_on_materiality(made: Decision, material: Sequence[bool | None]) -> Decision:
    """Return the decision; effects of which the test flights show none to be ``material`` explain nothing."""
    return replace(made, kind=NOT_SHOWN) if made.kind == "explained" and True not in material else made


def decision_with_doubts(made: Decision, findings: Sequence[Finding]) -> Decision:
    """Return the decision; findings that are warnings about the flights of pairs leave no verdict certain."""
    doubts = tuple(finding for finding in findings if finding.severity == Severity.WARNING)
    if not doubts:
        return made
    kind = "unexplained" if made.kind == "unexplained" else "ambiguous"
    return replace(made, kind=kind, findings=(*doubts, *made.findings))


def verdict_decision(
    ties: Mapping[str, Sequence[str]], unexplained: Sequence[str], floor_known: bool, *, open_to: Sequence[str] = (),
    left_open: Sequence[str] = (), of_flights: Sequence[str] = (),
) -> Decision:  # fmt: skip
    """Return the kind, candidates and open points of a verdict.

    Args:
        ties: Accepted effects, each with the effects that fit the flights equally well.
        unexplained: Channels whose test residual exceeds noise and the training flights' uncertainty.
        floor_known: Whether the logs show a noise floor.
        open_to: Effects that would explain those residuals, and that training flights do not show.
        left_open: Channels whose residual exceeds noise, but not the training flights' uncertainty.
        of_flights: Channels in which each flight has its own offset.
    """
    remains = [Finding("remains_unexplained", "", {"channels": list(unexplained)})] if unexplained else []
    own = [Finding("offsets_of_flights", "", {"channels": list(of_flights)})] if of_flights else []
    open_yet = [Finding("left_open", "", {"channels": list(left_open)})] if left_open else []
    candidates = tuple(dict.fromkeys((*ties, *(rival for rivals in ties.values() for rival in rivals))))
    if any(ties.values()):
        doubts = [Finding("effect_tied", name, {"others": list(rivals)}) for name, rivals in ties.items() if rivals]
        return Decision(kind="ambiguous", candidates=candidates, findings=(*doubts, *remains))
    if unexplained and open_to:
        points = (*remains, Finding("effects_open", "", {"effects": list(open_to)}))
        return Decision(kind="ambiguous", candidates=tuple(dict.fromkeys((*candidates, *open_to))), findings=points)
    if unexplained:
        return Decision(kind="unexplained", candidates=candidates, findings=tuple(remains))
    if not floor_known:
        points = (*(own if ties else ()), Finding("floor_unknown"))
        return Decision(kind="explained" if ties else "none", candidates=candidates, findings=points)
    if not ties:
        return Decision(kind=NOT_SHOWN if left_open else "none", candidates=candidates, findings=(*own, *open_yet))
    rest = open_yet or [Finding("remains_near_floor", "", {"offsets": bool(of_flights)})]
    return Decision(kind="explained", candidates=candidates, findings=(*own, *rest))
