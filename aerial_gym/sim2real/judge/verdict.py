"""The verdict: which effects the flights name, with what certainty, and what remains.

The mapping for ``verdict.json`` is a contract (DESIGN.md, section 4).
"""

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from aerial_gym.physics import EFFECTS
from aerial_gym.sim2real.failures.finding import Failure
from aerial_gym.sim2real.identify.candidates.structure import Structure
from aerial_gym.sim2real.identify.learned import Learned
from aerial_gym.sim2real.identify.least_squares.parameters import is_number, params_of, scales
from aerial_gym.sim2real.identify.selection.in_part import RivalInPart
from aerial_gym.sim2real.identify.selection.select import Selection
from aerial_gym.sim2real.judge.ablation import Ablation
from aerial_gym.sim2real.judge.breakdown import Part, Regime
from aerial_gym.sim2real.judge.evaluation import Evaluation
from aerial_gym.sim2real.judge.experiments.design import Advice
from aerial_gym.sim2real.judge.outcome import NOT_SHOWN, Outcome, meaning, said_first
from aerial_gym.sim2real.judge.whiteness import Whiteness
from aerial_gym.sim2real.plain import fields_of, plain

MOST_CONFIDENT = 0.9999
LEAST_SHOWN = 0.05
"""Effects that were not named are told if they are at least this probable."""


@dataclass(frozen=True, kw_only=True)
class NamedEffect:
    """An effect that the flights ask for."""

    name: str
    params: dict[str, float]
    """Fitted totals, as in robot files."""

    std: dict[str, float]
    """Standard deviations: 1.96 of them make the 95 % interval, with few flights and the tolerances in them."""

    noise_std: dict[str, float]
    """The part of ``std`` that more flights would make smaller."""

    frozen: tuple[str, ...]
    """Parameters that these flights do not show; they keep their neutral value."""

    confidence: float
    """Probability that it is there: that of all sets of effects which hold it."""

    ablation: Ablation | None = None
    """What becomes worse without it, and its rivals; None for a random effect, which is not selected among others."""

    regime: Regime | None = None
    """Before and after where it acts; None likewise."""

    ties: tuple[str, ...] = ()
    """Effects that would do equally well in its place."""

    in_part: tuple[RivalInPart, ...] = ()
    """Effects that would do equally well in the place of one of its parameters."""

    correlation: dict[str, dict[str, float]] = field(default_factory=dict)
    """How a parameter is correlated with those that stand before it, by ``name.parameter``."""

    @property
    def interval(self) -> dict[str, tuple[float, float]]:
        """Return the 95 % interval of every parameter that has one."""
        half_width = {key: 1.96 * std for key, std in self.std.items()}
        return {k: (v - half_width[k], v + half_width[k]) for k, v in self.params.items() if k in half_width}

    def as_mapping(self) -> dict[str, object]:
        """Return it for JSON."""
        worth = self.ablation
        return {
            **fields_of(self, "name", "params", "std", "interval", "noise_std", "frozen", "confidence", "ties"),
            "ties_in_part": plain(self.in_part),
            "material": worth is None or worth.material,
            "without_it": plain(worth),
            "where_it_acts": plain(self.regime),
            "rival": plain(worth.rivals[0]) if worth and worth.rivals else None,
        }


@dataclass(frozen=True, kw_only=True)
class Verdict:
    """What the flights say about the declared model."""

    verdict: str
    """explained, none, not shown, unexplained or ambiguous."""

    reason: str
    """One sentence; what gets worse on the test flights comes first."""

    effects: tuple[NamedEffect, ...]
    """In the order in which they were named; a failure that every flight has comes last."""

    candidates: tuple[str, ...]
    """These and what cannot be told from them."""

    not_testable: dict[str, str]
    """Effects that the flights cannot show, and why."""

    manoeuvre: Advice | None
    """What tells tied candidates apart; None if there are none."""

    fly_next: dict[str, Advice]
    """What shows effects that flights of this vehicle can show and these do not."""

    inclusion: dict[str, float]
    """Probability of every effect, by all sets that were compared."""

    sets: dict[tuple[str, ...], float]
    """Probability of each set, the most probable first."""

    structure: Structure
    before: Evaluation
    after: Evaluation

    outcomes: tuple[Outcome, ...]
    """What became of each channel and rollout of the test flights; empty where nothing is corrected."""

    flights: dict[str, list[Part]]
    """Before and after on each test flight."""

    unexplained: tuple[str, ...]
    """Channels with material structure after the correction."""

    not_shown: tuple[str, ...] = ()
    """Channels in which more than noise remains, and no more than the training flights leave open."""

    whiteness: dict[str, Whiteness] = field(default_factory=dict)
    """Of the residual of each channel on the test flights, deviations within the tolerances taken off."""

    learned: Learned | None = None
    """What became of a learned residual, where one was asked for."""

    failures: tuple[Failure, ...] = ()
    """What failed in flights, training flights first; these are compared up to it."""

    joints: tuple[dict[str, object], ...] = ()
    """Passive joints with their numbers, where they were looked for; those that differ from what is declared say in what."""

    notes: tuple[str, ...] = field(default=())
    """What was done to the logs, and other things to know."""

    @property
    def corrects(self) -> bool:
        """Whether the corrected robot is another one than the declared."""
        return bool(self.effects) or (self.learned is not None and self.learned.cfg is not None)

    @property
    def differing_joints(self) -> list[str]:
        """Names of joints that differ from what is declared; the corrected robot has them, residuals know a rigid one."""
        return [str(joint["name"]) for joint in self.joints if joint["changed"]]

    def told_before(self, told: str) -> str:
        """Return the reason with what is told before it, but behind what gets worse on the test flights."""
        worse = said_first(self.outcomes)
        rest = self.reason.removeprefix(worse).removeprefix("; ")
        return "; ".join(part for part in (worse, f"{told}{rest}") if part)

    @property
    def meaning(self) -> str:
        """What it tells its reader."""
        beside = (self.failures or self.differing_joints) and not self.effects
        kind, nothing = self.verdict, NOT_SHOWN if self.not_shown else "none"
        kind = nothing if beside and kind == "explained" else kind
        told = meaning(kind, self.outcomes, {effect.name: effect.ties for effect in self.effects})
        if self.not_shown and kind != NOT_SHOWN:
            told += f" What more the test flights hold in {', '.join(self.not_shown)} the training flights leave open."
        if self.differing_joints:
            told += " This is said of the vehicle as a rigid one; the springs of its joints were fitted by themselves."
        names = ", ".join(failure.flight for failure in self.failures)
        return f"{told} This is said of {names} up to what failed there." if names else told

    def as_mapping(self) -> dict[str, object]:
        """Return the contract for JSON."""
        learned = [self.learned] if self.learned is not None and self.learned.cfg is not None else []
        return {
            **fields_of(self, "verdict", "reason", "meaning"),
            "test_flights": {found.name: plain(found) for found in self.outcomes},
            "effects": plain([*self.effects, *learned]),
            **fields_of(self, "failures", "joints", "candidates"),
            "not_testable": list(self.not_testable),
            "not_testable_because": self.not_testable,
            **fields_of(self, "manoeuvre", "fly_next"),
            "inclusion": {name: share for name, share in self.inclusion.items() if share >= LEAST_SHOWN},
            **fields_of(self, "structure", "whiteness", "unexplained", "not_shown"),
            "learned_residual": None if self.learned is None else self.learned.sentence,
            "before": self.before.as_mapping(),
            "after": self.after.as_mapping(before=self.before),
            "flights": {
                name: {part.became.name: plain(part) for part in parts} for name, parts in self.flights.items()
            },
            "notes": list(self.notes),
        }


def named_effects(
    selection: Selection, ablations: dict[str, Ablation], regimes: dict[str, Regime]
) -> tuple[NamedEffect, ...]:
    """Return the accepted effects with parameters, spread and confidence, and with what was found out about them after."""
    fit, spread, inclusion = selection.final.fit, selection.final.spread, selection.chosen.inclusion
    values, scale = params_of(fit.params, fit.effects), scales(fit.effects)
    std = dict(zip(fit.free_effects.tolist(), spread.std, strict=True))
    noise = dict(zip(fit.free_effects.tolist(), np.sqrt(np.diag(spread.blocks)), strict=True))
    owners = (fit.owners[k] for k in fit.free_effects.tolist())
    numbers = [f"{name}.{EFFECTS.get(name).parameters[place].name}" for name, place in owners]
    correlation = spread.correlation
    found = []
    for name in fit.effects:
        own = dict(zip((p.name for p in EFFECTS.get(name).parameters), fit.columns_of(name).tolist(), strict=True))
        found.append(
            NamedEffect(
                name=name,
                params={key: float(values[k]) for key, k in own.items()},
                std={key: float(std[k] * scale[k]) for key, k in own.items() if k in std},
                noise_std={key: float(noise[k] * scale[k]) for key, k in own.items() if k in noise},
                frozen=tuple(key for key, k in own.items() if k not in std and is_number(*fit.owners[k])),
                confidence=min(inclusion[name], MOST_CONFIDENT),
                ablation=ablations[name],
                regime=regimes[name],
                ties=tuple(tied_rivals(name, selection)),
                in_part=tuple(rival for rival in selection.chosen.in_part if rival.effect == name),
                correlation={
                    key: dict(zip(numbers[:i], correlation[i, :i].tolist(), strict=True))
                    for key in own
                    if f"{name}.{key}" in numbers and (i := numbers.index(f"{name}.{key}")) > 0
                },
            )
        )
    return tuple(found)


def immaterial(effects: Sequence[NamedEffect]) -> list[str]:
    """Return a note for each effect whose absence is hardly seen on the test flights, or not for certain."""
    notes = []
    for effect in effects:
        if (worth := effect.ablation) is None or worth.material:
            continue
        channel, rise = worth.most
        most = f"{channel} rises most, by {rise.value:.1%} [{rise.low:+.1%}, {rise.high:+.1%}]"
        if worth.material is None:
            notes.append(f"whether {effect.name} is material is not shown by the test flights: without it {most}")
        else:
            notes.append(
                f"{effect.name} is immaterial: without it no residual and no rollout error of the test flights rises by "
                f"{worth.least:.0%}, by its interval ({most}); it may be left out of the robot file"
            )
    return notes


def tied_rivals(name: str, selection: Selection) -> list[str]:
    """Return the registered effects that cannot be told from an accepted one."""
    return [rival.effect for rival in selection.ties_of(name)]


def decide(
    selection: Selection,
    unexplained: Sequence[str],
    floor_known: bool,
    *,
    open_to: Sequence[str] = (),
    left_open: Sequence[str] = (),
    of_flights: Sequence[str] = (),
) -> tuple[str, str, tuple[str, ...]]:
    """Return verdict, reason and candidates.

    Args:
        selection: What the training flights ask for.
        unexplained: Channels of the test flights in which more remains than is allowed.
        floor_known: Whether the logs show a noise floor.
        open_to: Effects that would make what remains, and that training flights do not show.
        left_open: Channels in which more than noise remains, and no more than training flights leave open.
        of_flights: Channels in which an offset of each flight's own remains.
    """
    tied = {name: tied_rivals(name, selection) for name in selection.accepted}
    candidates = list(selection.accepted)
    for name in selection.accepted:
        candidates += tied[name]
    names = ", ".join(selection.accepted)
    unique = tuple(dict.fromkeys(candidates))
    if any(tied.values()):
        doubts = [f"{name} cannot be told from {' or '.join(rivals)}" for name, rivals in tied.items() if rivals]
        rest = f"; more than noise and tolerances remains in {', '.join(unexplained)}" if unexplained else ""
        return "ambiguous", f"{'; '.join(doubts)}{rest}", unique
    if unexplained and open_to:
        start = f"{names} found, but more" if names else "more"
        rest = f"{start} than noise and tolerances remains in {', '.join(unexplained)} of the test flights"
        would = f"{' or '.join(open_to)} would make it, which the training flights do not show"
        return "ambiguous", f"{rest}; {would}", tuple(dict.fromkeys((*unique, *open_to)))
    if unexplained:
        start = f"{names} found, but" if names else "no registered effect explains it:"
        return "unexplained", f"{start} more than noise and tolerances remains in {', '.join(unexplained)}", unique
    if not selection.accepted and not floor_known:
        start = "no registered effect explains more of the flights than the declared model, but the logs are too slow or short"
        return "none", f"{start} to show a noise floor: whether more than noise remains cannot be told", unique
    own = f"; each flight has an offset of its own in {', '.join(of_flights)}" if of_flights else ""
    if not selection.accepted:
        if left_open:
            rest = f"what remains in {', '.join(left_open)} is no more than the training flights leave open"
            return NOT_SHOWN, f"the flights show no registered effect{own}; {rest}", unique
        return "none", f"the declared model explains the flights within noise and tolerances{own}", unique
    if left_open:
        rest = f"what remains in {', '.join(left_open)} is no more than they leave open: fly more to know it better"
    elif of_flights:
        rest = "what else remains is near the noise floor"
    elif floor_known:
        rest = "what remains is near the noise floor"
    else:
        rest = "the logs are too slow or short to show a noise floor"
    return "explained", f"the flights show {names}{own}; {rest}", unique
