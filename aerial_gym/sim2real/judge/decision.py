"""The decision of a verdict: its kind, its candidates, and the residuals and questions that stay open."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from aerial_gym.sim2real.findings import Finding
from aerial_gym.sim2real.judge.outcome import NOT_SHOWN


@dataclass(frozen=True, kw_only=True)
class Decision:
    """Kind of a verdict with its candidates and open points."""

    kind: str  # explained, none, not shown, unexplained or ambiguous
    candidates: tuple[str, ...]  # Named effects and those that fit the flights equally well
    findings: tuple[Finding, ...]  # Residuals that remain and questions that stay open


def verdict_decision(
    ties: Mapping[str, Sequence[str]],
    unexplained: Sequence[str],
    floor_known: bool,
    *,
    open_to: Sequence[str] = (),
    left_open: Sequence[str] = (),
    of_flights: Sequence[str] = (),
) -> Decision:
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
