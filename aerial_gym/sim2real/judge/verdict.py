"""The verdict: the named effects with their certainty, the outcomes on test flights, and the open points.

The mapping for ``verdict.json`` is a contract (DESIGN.md, section 4).
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from aerial_gym.config.robot import RobotCfg
from aerial_gym.physics import EFFECTS
from aerial_gym.sim2real.arrays import Array
from aerial_gym.sim2real.failures.flight_event import Failure
from aerial_gym.sim2real.findings import Finding, unit_suffix
from aerial_gym.sim2real.identify.candidates.structure import Structure
from aerial_gym.sim2real.identify.learned import ResidualFit
from aerial_gym.sim2real.identify.least_squares.derivatives import (
    is_continuous_parameter,
    parameter_row,
    parameter_scales,
)
from aerial_gym.sim2real.identify.selection.partial_rivals import ParameterRival
from aerial_gym.sim2real.identify.selection.select import SelectionResult
from aerial_gym.sim2real.identify.selection.value_ties import ValueTie
from aerial_gym.sim2real.json_values import plain, select_fields
from aerial_gym.sim2real.judge.ablation import Ablation
from aerial_gym.sim2real.judge.breakdown import ErrorsWhereActive, FlightError
from aerial_gym.sim2real.judge.evaluation import ModelEvaluation
from aerial_gym.sim2real.judge.experiments.design import Advice
from aerial_gym.sim2real.judge.outcome import Outcome
from aerial_gym.sim2real.judge.whiteness import Whiteness
from aerial_gym.sim2real.logs.rotor_model import place_of_rotor

MOST_CONFIDENT = 0.9999
LEAST_SHOWN = 0.05  # Smallest probability at which a report lists an effect under ``inclusion``


@dataclass(frozen=True, kw_only=True)
class NamedEffect:
    """An accepted effect with its parameters, certainty, ablation and rivals."""

    name: str
    params: dict[str, float]  # Fitted values as in a robot file, not changes from the declared ones

    std: dict[str, float]
    """Half width of the 95 % interval divided by 1.96; includes the small number of flights and the tolerances."""

    noise_std: dict[str, float]  # The part of ``std`` that more flights would make smaller
    frozen: tuple[str, ...]  # Parameters that these flights do not show; they keep their neutral value
    confidence: float  # Posterior inclusion probability: that of all sets which contain the effect

    ablation: Ablation | None = None
    """Rise of the errors without it, and its rivals; None for gusts and failures, which the selection does not compare."""

    regime: ErrorsWhereActive | None = (
        None  # Errors of both models in the rows in which it acts most; None for gusts and failures
    )
    ties: tuple[str, ...] = ()  # Effects that explain the flights equally well in its place

    in_part: tuple[ParameterRival, ...] = ()
    """Effects that explain the flights equally well in place of one of its parameters."""

    correlation: dict[str, dict[str, float]] = field(default_factory=dict)
    """Correlation of a parameter with those before it, by ``name.parameter``."""

    declared: dict[str, float] = field(default_factory=dict)  # Parameters in the declared robot file, or neutral ones
    place: str = ""  # Place of its rotor on the vehicle, such as ``front left``

    def __repr__(self) -> str:
        units = {each.name: each.unit for each in EFFECTS.get(self.name).parameters}
        values = (
            f"{name} = {value:.4g}{f' ± {1.96 * self.std[name]:.2g}' if name in self.std else ''} {units.get(name, '')}".rstrip(
                " -"
            )
            for name, value in self.params.items()
        )
        return f"{self.name} ({', '.join(values)}), probability {min(self.confidence, MOST_CONFIDENT):.4g}"

    @property
    def material(self) -> bool | None:
        """Return whether it is material on the test flights; None if they do not show that."""
        return True if self.ablation is None else self.ablation.material

    @property
    def finding(self) -> Finding:
        """Return the effect with its parameters, each with its declared value and the half width of its interval.

        A parameter that may be another effect is left out, unless all of them may.
        """
        own = [parameter for parameter in EFFECTS.get(self.name).parameters if parameter.name in self.params]
        rivals = {rival.parameter for rival in self.in_part}
        numbers = [one.name for one in own if one.kind == "number" and one.name not in self.frozen]
        shown = [name for name in numbers if name not in rivals] or numbers
        values: dict[str, object] = {"place": self.place} if self.place else {}
        values |= {} if self.material else {"material": self.material}
        for parameter in own:
            if parameter.name in shown or parameter.kind != "number":
                std = self.std.get(parameter.name)
                values[f"{parameter.name}_{unit_suffix(parameter.unit)}"] = {
                    "value": self.params[parameter.name],
                    "declared": self.declared.get(parameter.name),
                    "half_width": None if std is None else 1.96 * std,
                }
        return Finding("effect_found", self.name, {**values, "probability": self.confidence, "ties": list(self.ties)})

    @property
    def interval(self) -> dict[str, tuple[float, float]]:
        """Return the 95 % interval of every parameter that has one."""
        half_width = {key: 1.96 * std for key, std in self.std.items()}
        return {k: (v - half_width[k], v + half_width[k]) for k, v in self.params.items() if k in half_width}

    def as_mapping(self) -> dict[str, object]:
        """Return it for JSON."""
        worth = self.ablation
        return {
            "name": EFFECTS.get(self.name).cause,
            "law": EFFECTS.get(self.name).law,
            **select_fields(self, "params", "std", "interval", "noise_std", "frozen", "confidence", "ties"),
            "ties_in_part": plain(self.in_part),
            "material": self.material,
            "without_it": plain(worth),
            "where_it_acts": plain(self.regime),
            "rival": plain(worth.rivals[0]) if worth and worth.rivals else None,
        }


@dataclass(frozen=True, kw_only=True)
class Verdict:
    """The result of the loop: effects, outcomes on the test flights, open points and next steps."""

    verdict: str
    """explained, none, not shown, unexplained or ambiguous."""

    open_points: tuple[Finding, ...]
    """Residuals that remain and questions that stay open."""

    effects: tuple[NamedEffect, ...]
    """In the order in which they were named; a failure that every flight has comes last."""

    candidates: tuple[str, ...]
    """Named effects and those that fit the flights equally well."""

    not_testable: dict[str, Finding]
    """Effects that the flights cannot show, with the reason."""

    manoeuvre: Advice | None
    """Manoeuvre that distinguishes tied candidates; None if there are none."""

    fly_next: dict[str, Advice]
    """Manoeuvre for each effect that this vehicle can show and these flights do not."""

    inclusion: dict[str, float]
    """Posterior inclusion probability of every effect, over all sets that were compared."""

    sets: dict[tuple[str, ...], float]
    """Probability of each set, the most probable first."""

    structure: Structure
    before: ModelEvaluation
    after: ModelEvaluation

    outcomes: tuple[Outcome, ...]
    """Change of each channel and rollout error on the test flights; empty if nothing is corrected."""

    flights: dict[str, list[FlightError]]
    """Errors of the declared and the corrected model on each test flight."""

    unexplained: tuple[str, ...]
    """Channels whose test residual exceeds noise and the parameter uncertainty after the correction."""

    not_shown: tuple[str, ...] = ()
    """Channels whose residual exceeds noise, but not the parameter uncertainty that training leaves."""

    whiteness: dict[str, Whiteness] = field(default_factory=dict)
    """Whiteness of each channel's test residual with the best deviations within the tolerances."""

    learned: ResidualFit | None = None
    """The learned residual with its test result, if one was requested."""

    value_ties: tuple[ValueTie, ...] = ()
    """Combinations of declared values that explain the training flights as well as named effects."""

    failures: tuple[Failure, ...] = ()
    """Failures of flights, training flights first; each flight is compared up to its failure."""

    joints: tuple[dict[str, object], ...] = ()
    """Fitted passive joints with their parameters, and those that differ from the declared ones."""

    joint_findings: tuple[Finding, ...] = ()
    """Joints that differ from the declared ones."""

    notes: tuple[Finding, ...] = ()
    """Further results, and changes that were made to the logs."""

    def __repr__(self) -> str:
        effects = "; ".join(map(repr, self.effects)) or "no effect named"
        judged = f"{len(self.flights)} test flights" if self.flights else "test flights"
        return f"Verdict {self.verdict}: {effects}; judged on {judged}; {len(self.not_testable)} effects not testable"

    @property
    def corrects(self) -> bool:
        """Whether the corrected robot differs from the declared one."""
        return bool(self.effects) or (self.learned is not None and self.learned.cfg is not None)

    def as_mapping(self) -> dict[str, object]:
        """Return the verdict for JSON without its findings, which ``report.verdict_json`` adds."""
        learned = [self.learned] if self.learned is not None and self.learned.cfg is not None else []
        return {
            "test_flights": {results.name: plain(results) for results in self.outcomes},
            "effects": plain([*self.effects, *learned]),
            **select_fields(self, "value_ties", "failures", "joints"),
            "candidates": list(dict.fromkeys(map(cause_name, self.candidates))),
            "not_testable": list(dict.fromkeys(map(cause_name, self.not_testable))),
            **select_fields(self, "manoeuvre", "fly_next"),
            "inclusion": {name: share for name, share in cause_shares(self.inclusion).items() if share >= LEAST_SHOWN},
            **select_fields(self, "structure", "whiteness", "unexplained", "not_shown"),
            "before": self.before.as_mapping(),
            "after": self.after.as_mapping(before=self.before),
            "flights": {
                name: {part.became.name: plain(part) for part in parts} for name, parts in self.flights.items()
            },
        }


def cause_name(name: str) -> str:
    """Return the name of the cause of an effect, which all its laws share; another name as it is."""
    return EFFECTS.get(name).cause if name in EFFECTS else name


def cause_shares(inclusion: Mapping[str, float]) -> dict[str, float]:
    """Return the inclusion probability of each cause: the sum over its laws, of which a set has at most one."""
    results = dict[str, float]()
    for name, share in inclusion.items():
        results[cause_name(name)] = min(results.get(cause_name(name), 0.0) + share, 1.0)
    return results


def notes_on_laws(selection: SelectionResult) -> list[Finding]:
    """Return a note for each named effect on its law and each other one that was fitted, with the log odds between them."""
    return [
        Finding(
            "law_preferred" if rival.is_clearly_less_probable else "laws_tied",
            name,
            {"law": EFFECTS.get(name).law, "other": EFFECTS.get(rival.effect).law, "log_odds": -rival.log_odds},
        )
        for name in selection.effect_names
        for rival in selection.effect_rivals(name)
        if cause_name(rival.effect) == cause_name(name)
    ]


def parameters_in_file(name: str, robot: RobotCfg) -> dict[str, float]:
    """Return the parameters of an effect in a robot file; neutral values where the file has none."""
    effect, stated = EFFECTS.get(name), robot.effects.get(name, {})
    neutral = zip(effect.parameters, effect.neutral(robot), strict=True)
    return {parameter.name: float(stated.get(parameter.name, value)) for parameter, value in neutral}


def place_of_affected_rotor(name: str, params: Array, robot: RobotCfg) -> str:
    """Return the place of the rotor that an effect acts on, such as ``front left``; empty if it acts on no single one."""
    kinds = [parameter.kind for parameter in EFFECTS.get(name).parameters]
    return place_of_rotor(robot, round(float(params[kinds.index("rotor")]))) if "rotor" in kinds else ""


def effects_of_selection(
    selection: SelectionResult, ablations: dict[str, Ablation], regimes: dict[str, ErrorsWhereActive], robot: RobotCfg
) -> tuple[NamedEffect, ...]:
    """Return the accepted effects of a declared robot with parameters, intervals, confidence, ablation and regime."""
    fit, spread, inclusion = selection.fit, selection.spread, selection.inclusion
    values, scale = parameter_row(fit.params, fit.effects), parameter_scales(fit.effects)
    std = dict(zip(fit.indices_of_fitted_effect_params.tolist(), spread.std, strict=True))
    noise = dict(zip(fit.indices_of_fitted_effect_params.tolist(), np.sqrt(np.diag(spread.blocks)), strict=True))
    owners = (fit.parameter_owners[k] for k in fit.indices_of_fitted_effect_params.tolist())
    numbers = [f"{name}.{EFFECTS.get(name).parameters[place].name}" for name, place in owners]
    correlation = spread.correlation
    results = []
    for name in fit.effects:
        own = dict(
            zip((p.name for p in EFFECTS.get(name).parameters), fit.indices_of_effect(name).tolist(), strict=True)
        )
        results.append(
            NamedEffect(
                name=name,
                params={key: float(values[k]) for key, k in own.items()},
                std={key: float(std[k] * scale[k]) for key, k in own.items() if k in std},
                noise_std={key: float(noise[k] * scale[k]) for key, k in own.items() if k in noise},
                frozen=tuple(
                    key for key, k in own.items() if k not in std and is_continuous_parameter(*fit.parameter_owners[k])
                ),
                confidence=min(inclusion[name], MOST_CONFIDENT),
                ablation=ablations[name],
                regime=regimes[name],
                ties=tuple(names_of_ties(name, selection)),
                in_part=tuple(rival for rival in selection.in_part if rival.effect == name),
                correlation={
                    key: dict(zip(numbers[:i], correlation[i, :i].tolist(), strict=True))
                    for key in own
                    if f"{name}.{key}" in numbers and (i := numbers.index(f"{name}.{key}")) > 0
                },
                declared=parameters_in_file(name, robot),
                place=place_of_affected_rotor(name, fit.params.effects[name], robot),
            )
        )
    return tuple(results)


def notes_on_materiality(effects: Sequence[NamedEffect]) -> list[Finding]:
    """Return a note for each effect that is immaterial, or not shown to be material."""
    notes = []
    for effect in effects:
        if (ablation := effect.ablation) is None or ablation.material:
            continue
        channel, rise = ablation.largest_rise
        values = {"channel": channel, "rise": rise.value, "rise_low": rise.low, "rise_high": rise.high}
        if ablation.material is None:
            notes.append(Finding("materiality_open", effect.name, values))
        else:
            notes.append(Finding("effect_immaterial", effect.name, {**values, "least": ablation.least}))
    return notes


def names_of_ties(name: str, selection: SelectionResult) -> list[str]:
    """Return the effects that explain the flights as well as an accepted one in its place.

    An effect whose first parameter is the same physical quantity, and that the logs cannot show for want of a column, is one
    of them: a slung load is a mass as a payload is. Without torques an error of one rotor looks like one of all, and without
    rotor speeds a loss of speed with the voltage looks like a loss of thrust.
    """
    alike = {
        other: reason.code
        for other, reason in selection.not_testable.items()
        if name in EFFECTS.get(other).confused_with
        and not (reason.code == "torques_not_compared" and EFFECTS.get(name).shown_by_forces)
    }
    unit, follows = EFFECTS.get(name).parameters[0].unit, set(EFFECTS.get(name).follows)
    hidden = [
        other
        for other, code in alike.items()
        if (code == "logs_lack" and unit == EFFECTS.get(other).parameters[0].unit != "-")
        or (
            code == "logs_lack"
            and EFFECTS.get(other).told_by_rotor_speeds
            and follows & set(EFFECTS.get(other).follows)
        )
        or (code == "torques_not_compared" and EFFECTS.get(other).acts_on == "rotor")
    ]
    rivals = [rival.effect for rival in selection.effect_ties(name)]
    simple = [tie for tie in selection.value_ties if tie.is_as_simple and name in tie.replaced]
    values = [other for tie in simple for other in tie.causes if other in selection.looked_for]
    names = dict.fromkeys((*rivals, *selection.rotor_ties.get(name, ()), *values, *hidden))
    return [other for other in names if cause_name(other) != cause_name(name)]
