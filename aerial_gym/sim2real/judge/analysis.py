"""The last stage of the loop: the verdict of the test flights on the corrected model, and the corrected robot."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from aerial_gym.config.robot import RobotCfg
from aerial_gym.physics import EFFECTS
from aerial_gym.sim2real.arrays import Array
from aerial_gym.sim2real.findings import Finding, unit_suffix
from aerial_gym.sim2real.identify.candidates.library import neutral_params
from aerial_gym.sim2real.identify.candidates.testable import parameters_at_bounds
from aerial_gym.sim2real.identify.least_squares.gauss_newton import FARTHEST_DEVIATION
from aerial_gym.sim2real.identify.selection.select import SelectionResult, selection_without_effects
from aerial_gym.sim2real.identify.stages import LoopSetup, final_model_of_robot_file
from aerial_gym.sim2real.judge.ablation import ablations_of_effects
from aerial_gym.sim2real.judge.breakdown import errors_by_flight, errors_where_effect_acts
from aerial_gym.sim2real.judge.evaluation import ModelEvaluation, evaluate_models
from aerial_gym.sim2real.judge.experiments.design import can_have_effect, recommend_manoeuvres
from aerial_gym.sim2real.judge.outcome import (
    Decision,
    Outcome,
    channel_outcomes,
    decision_on_materiality,
    decision_with_doubts,
    decision_with_harm,
    error_outcomes,
    verdict_decision,
)
from aerial_gym.sim2real.judge.pairs.clock import clock_findings
from aerial_gym.sim2real.judge.predictive import notes_on_doubt, selection_with_test_odds
from aerial_gym.sim2real.judge.random_wind.gusts import (
    NAME,
    noise_floors_in_declared_wind,
    noise_floors_with_wind,
)
from aerial_gym.sim2real.judge.remainder import effects_below_remainder
from aerial_gym.sim2real.judge.residual_excess import (
    ResidualExcess,
    can_judge_forces,
    channel_rms,
    find_residual_excess,
    model_with_training_deviations,
)
from aerial_gym.sim2real.judge.residual_model import can_learn_residual, fit_residual
from aerial_gym.sim2real.judge.verdict import (
    NamedEffect,
    Verdict,
    effects_of_selection,
    names_of_ties,
    notes_on_laws,
)
from aerial_gym.sim2real.judge.whiteness import whiteness_of_channels
from aerial_gym.sim2real.logs.flights import findings_on_rigid_joints, merge_findings_of_flights
from aerial_gym.sim2real.predict.channels import UNITS
from aerial_gym.sim2real.predict.model_params import ModelParams
from aerial_gym.sim2real.predict.noise_floor import rms_of_noise_floors
from aerial_gym.sim2real.predict.redeclare import deviation_of_vehicle, deviations_beyond_tolerance, redeclare
from aerial_gym.sim2real.predict.tolerances import OF_COMMANDS, STRAINED
from aerial_gym.sim2real.progress import Progress


@dataclass(frozen=True)
class LoopResult:
    """Everything that a report shows."""

    declared: LoopSetup
    selection: SelectionResult
    params: ModelParams  # The final model, including a learned residual if one was accepted
    within: ModelParams  # The final model with the deviations within the tolerances that fit the training flights best

    corrected: RobotCfg
    verdict: Verdict


def judge_on_test_flights(
    declared: LoopSetup, selection: SelectionResult, *, seed: int, learn_residual: bool, progress: Progress
) -> LoopResult:
    """Return the verdict on the test flights, to which nothing is fitted, and the corrected robot."""
    if minor := effects_below_remainder(declared.train, declared.params, selection):
        selection = selection_without_effects(declared.train, declared.params, selection, minor)
    tested, model = declared.test, model_with_new_values(declared, selection)

    progress("the noise floor of the test flights", 0.7)
    floors = noise_floors_in_declared_wind(tested, model)
    still = rms_of_noise_floors(floors)
    progress("rollouts of the declared and the corrected model", 0.8)
    pair = (declared.params, model) if selection.effect_names else (declared.params,)
    evaluations = evaluate_models(declared.robot, tested, pair, floor=still, seed=seed)
    before, named = evaluations[0], evaluations[-1]
    unexplained = find_residual_excess(declared.train, tested, selection, (declared.params, model), named, still)
    doubtful = selection.effect_names and (unexplained.left_open or unexplained.open_to)
    result = selection_with_test_odds(selection, tested) if doubtful else selection
    progress("ablation of each effect", 0.93)
    effects = effects_with_ablations(declared, result, model, (before, named), unexplained, seed=seed)
    gusts = ()
    if NAME not in declared.robot.effects and unexplained.wind.is_accepted:
        gusts = (unexplained.wind.as_effect(declared.stated),)
    made = decision_with_gusts(declared, result, unexplained, gusts)
    made = decision_on_materiality(made, [one.material for one in (*effects, *gusts)])
    clocks = clock_findings(declared.train, unexplained.within, result.criteria.significance)
    made = decision_with_doubts(made, clocks)
    models, both, least = (declared.params, model), (before, named), result.criteria.material
    became = error_outcomes(tested, models, both, least=least) if effects or gusts else ()
    if any(one.is_materially_worse for one in became):
        made = decision_with_harm(made, channels_worse_within_tolerances(declared, result, unexplained, model))
    learned, params, after = None, model, unexplained.evaluation_with_wind_floor(named)
    if learn_residual or (made.kind == "unexplained" and can_learn_residual(declared)):
        progress("fit of the learned residual", 0.9)
        learned = fit_residual(declared, result, model, unexplained.within, unexplained.floor, seed=seed)
    if learned is not None and learned.effect is not None:
        params = replace(model, learned=learned.effect)
        (after,) = evaluate_models(declared.robot, tested, [params], floor=unexplained.floor, seed=seed)
        models, both = (declared.params, params), (before, after)
        became = error_outcomes(tested, models, both, least=least)
    manoeuvre, fly_next = recommend_manoeuvres(declared, result, unexplained.open_to)
    spectra = whiteness_of_channels(tested.times, unexplained.left, declared.channels, declared.bandwidth)
    floors_with_gusts = noise_floors_with_gusts(floors, unexplained)
    verdict = Verdict(
        verdict=made.kind, open_points=made.findings, effects=(*effects, *gusts), candidates=made.candidates,
        not_testable=untestable_effects(result, declared.stated, unexplained), manoeuvre=manoeuvre, fly_next=fly_next,
        inclusion=result.inclusion, sets=result.sets, structure=unexplained.structure,
        before=before, after=after, outcomes=became,
        flights=errors_by_flight(tested, models, both, floors_with_gusts, least=least, seed=seed),
        unexplained=unexplained.channels, not_shown=unexplained.left_open, learned=learned,
        value_ties=result.value_ties,
        whiteness=dict(zip((channel.name for channel in declared.channels), spectra, strict=True)),
        notes=(*clocks, *verdict_notes(declared, result, model, unexplained, effects, named)),
    )  # fmt: skip
    accepted = (*result.effect_names, *(effect.name for effect in gusts))
    gusty, wind = params, unexplained.wind
    if wind.is_accepted:
        gusty = params.with_effect(NAME, np.array(EFFECTS.get(NAME).parse_params(wind.params())))
    corrected = correct_robot(declared, gusty, accepted)
    return LoopResult(declared, result, params, unexplained.within, corrected, verdict)


def model_with_new_values(declared: LoopSetup, selection: SelectionResult) -> ModelParams:
    """Return the final model; if flights contradict declared values, with the values that fit the training flights best.

    They are fitted together with the effects, which would be wrong without them. Without effects nothing is corrected.
    """
    model = final_model_of_robot_file(declared, selection)
    if not selection.effect_names:
        return model
    deviation = model_with_training_deviations(model, selection.fit, selection.weights.weight).deviation
    assert deviation is not None
    for place, name in enumerate(declared.tolerances.names(declared.robot.num_rotors)):
        deviation[place] *= name not in tolerances_of_absent_parts(declared, model)
    if not deviations_beyond_tolerance(declared.tolerances, deviation, declared.robot):
        return model
    return replace(model, deviation=deviation_of_vehicle(deviation, declared.robot))


def channels_worse_within_tolerances(
    declared: LoopSetup, selection: SelectionResult, unexplained: ResidualExcess, params: ModelParams
) -> list[Outcome]:
    """Return the channels that the correction worsens even if both models have their best deviations, up to ``STRAINED``.

    Rollouts are left out: deviations within the tolerances move them by as much as effects do.
    """
    alone = [one.deviation for one in selection.fits if not one.effects and one.has_no_structures_but_offsets]
    if not alone:
        return []
    pairs = zip((declared.params, params), (alone[0], unexplained.deviation), strict=True)
    models = [replace(model, deviation=np.clip(off, -STRAINED, STRAINED)) for model, off in pairs]
    outcomes = channel_outcomes(declared.test, (models[0], models[1]), least=selection.criteria.material)
    return [one for one in outcomes if one.is_materially_worse]


def noise_floors_with_gusts(floors: Sequence[Array | None], unexplained: ResidualExcess) -> list[Array | None]:
    """Return the noise floors of flights, (C,) each, with the identified random wind added."""
    still = rms_of_noise_floors(floors)
    if still is None or unexplained.floor is None:
        return list(floors)
    return noise_floors_with_wind(floors, np.sqrt(np.maximum(unexplained.floor**2 - still**2, 0.0)))


def effects_with_ablations(
    declared: LoopSetup,
    selection: SelectionResult,
    model: ModelParams,
    evaluations: tuple[ModelEvaluation, ModelEvaluation],
    unexplained: ResidualExcess,
    *,
    seed: int,
) -> tuple[NamedEffect, ...]:
    """Return the accepted effects, each with its ablation and its active regime on the test flights."""
    test, models, floor = declared.test, (declared.params, model), unexplained.floor
    pair = declared.train, test
    worth = ablations_of_effects(declared.robot, test.flights, pair, models, evaluations, selection, unexplained.left)
    weight = selection.weights.weight
    regimes = {
        name: errors_where_effect_acts(test, *models, name, weight, floor, seed=seed) for name in selection.effect_names
    }
    return effects_of_selection(selection, worth, regimes, declared.stated)


def decision_with_gusts(
    declared: LoopSetup, selection: SelectionResult, unexplained: ResidualExcess, gusts: Sequence[NamedEffect]
) -> Decision:
    """Return the kind, candidates and open points of the verdict, accepted gusts included."""
    made = verdict_decision(
        {name: names_of_ties(name, selection) for name in selection.effect_names},
        unexplained.channels,
        unexplained.floor is not None,
        open_to=unexplained.open_to,
        left_open=unexplained.left_open,
        of_flights=unexplained.of_flights,
    )
    made = unexplained.wind.decision(made) if gusts else made
    if can_judge_forces(declared.flights) or all(channel.kind != "specific_force" for channel in declared.channels):
        return made
    return replace(made, findings=(*made.findings, Finding("forces_not_judged")))


def verdict_notes(
    declared: LoopSetup,
    selection: SelectionResult,
    model: ModelParams,
    unexplained: ResidualExcess,
    effects: Sequence[NamedEffect],
    named: ModelEvaluation,
) -> tuple[Finding, ...]:
    """Return the notes, the most important first; those on the logs come last.

    ``named`` is the evaluation of the named effects on the test flights.
    """
    open_channels = list(unexplained.left_open)
    return (
        *findings_on_rigid_joints(declared.stated),
        *notes_on_doubt(selection),
        *([Finding("left_open_note", "", {"channels": open_channels})] if open_channels else []),
        *unexplained.wind.notes,
        *notes_on_laws(selection),
        *notes_on_bounds(declared, selection),
        *(rival.finding for effect in effects for rival in effect.in_part),
        *(tie.finding for tie in selection.value_ties),
        *notes_on_redeclared_values(declared, model),
        *notes_on_implausible_deviations(declared, model, selection.criteria.material, unexplained, named),
        *notes_on_surrogates_and_offsets(selection),
        *(reason for reason in selection.refused.values() if reason.code == "remainder_larger"),
        *notes_on_logs(declared),
    )


def notes_on_bounds(declared: LoopSetup, selection: SelectionResult) -> list[Finding]:
    """Return a note on each named effect with a parameter at a physical bound: its law fits only as far as it goes."""
    params, robot = selection.fit.params, declared.train.robot
    ends = {
        name: parameters_at_bounds(name, params, neutral_params(name, declared.params, robot), robot)
        for name in selection.effect_names
    }
    return [Finding("at_bound", name, {"parameters": at_end}) for name, at_end in ends.items() if at_end]


def notes_on_redeclared_values(declared: LoopSetup, model: ModelParams) -> list[Finding]:
    """Return a note on the declared values that the flights contradict, which the corrected robot file replaces."""
    if model.deviation is None:
        return []
    strained = deviations_beyond_tolerance(declared.tolerances, model.deviation, declared.robot)
    sizes = [{"value": name, "deviation_std": size} for name, size in strained.items()]
    return [Finding("values_redeclared", "", {"values": sizes})]


def notes_on_implausible_deviations(
    declared: LoopSetup, model: ModelParams, least: float, unexplained: ResidualExcess, named: ModelEvaluation
) -> list[Finding]:
    """Return a note on each implausible deviation, and one on the errors that all deviations together change."""
    results = declared.tolerances.implausible_deviations(
        unexplained.deviation, absent=tolerances_of_absent_parts(declared, model), farthest=FARTHEST_DEVIATION
    )
    if not results:
        return []
    changed = []
    rms = channel_rms(unexplained.left).tolist()
    for channel, value, bare in zip(declared.channels, rms, named.residual, strict=True):
        if abs(value - bare.value) > least * bare.value:
            unit = unit_suffix(channel.unit)
            changed.append({"channel": channel.name, f"with_{unit}": value, f"without_{unit}": bare.value})
    if not changed:
        return [*results, Finding("strained_changes_little")]
    return [*results, Finding("strained_changes", "", {"errors": changed})]


def tolerances_of_absent_parts(declared: LoopSetup, params: ModelParams) -> set[str]:
    """Return the tolerances of parts and sensors that the vehicle or its logs lack: their deviations mean nothing."""
    flights = declared.train.flights
    soft = any(effect.replayed and effect.remembers for effect in map(EFFECTS.get, params.effects))
    forces = [flight.lin_vel is not None and not flight.attitude_integrated for flight in flights]
    has = {
        "nominal_voltage": declared.stated.battery is not None,
        "joint_rest": soft,
        **dict.fromkeys(
            ("time_constant", "command_hold", *OF_COMMANDS), any(f.rotor_command is not None for f in flights)
        ),
        **dict.fromkeys([f"acc_bias_{axis}" for axis in "xyz"], any(flight.accelerometer for flight in flights)),
        **dict.fromkeys([f"gyro_bias_{axis}" for axis in "xyz"], any(flight.gyro for flight in flights)),
        **dict.fromkeys([f"attitude_{axis}" for axis in "xyz"], any(forces)),  # velocity and attitude imply the force
    }
    return {name for name, present in has.items() if not present}


def notes_on_surrogates_and_offsets(selection: SelectionResult) -> list[Finding]:
    """Return notes on effects that follow a structure, and on offsets of flights: neither belongs to the vehicle."""
    flights = {"flights": selection.spread.num_flights}
    results = [
        Finding("stands_in", name, {"structure": kind, **flights}) for name, kind in selection.surrogates.items()
    ]
    offsets = selection.best.flight_offsets
    sizes = [{"channel": o.channel, f"rms_{unit_suffix(UNITS[o.channel.split('.')[0]])}": o.size} for o in offsets]
    return [*results, *([Finding("offsets_sizes", "", {"offsets": sizes})] if sizes else [])]


def notes_on_logs(declared: LoopSetup) -> list[Finding]:
    """Return the notes on the logs, their rate and their number."""
    flights, band = declared.flights, declared.bandwidth
    results = merge_findings_of_flights(flights)
    if band < declared.asked_bandwidth:
        slowest = min(flight.rate for flight in flights)
        results.append(Finding("band_limited", "", {"band_hz": band, "slowest_hz": slowest}))
    if (count := len(declared.train.flights)) < 3:
        results.append(Finding("few_flights", "", {"flights": count}))
    return results


def untestable_effects(selection: SelectionResult, robot: RobotCfg, unexplained: ResidualExcess) -> dict[str, Finding]:
    """Return the effects that the flights cannot show, with the reason; also confounders that are not registered.

    A vehicle without soft arms gets no advice to fly for them. One with joints is compared as rigid, without link effects.
    """
    results = dict(selection.not_testable)
    if robot.joints is not None:
        results |= {name: Finding("acts_on_links", name) for name in EFFECTS if not EFFECTS.get(name).on_rigid}
    for name in results:
        if robot.joints is None and not can_have_effect(name, selection, robot):
            results[name] = Finding("no_soft_arms", name)
    for name in selection.effect_names:
        for other in EFFECTS.get(name).confused_with:
            if other not in EFFECTS:
                results.setdefault(other, Finding("no_such_effect", other, {"alike": name}))
    return results | ({NAME: wind} if (wind := unexplained.wind.untestable) is not None else {})


def correct_robot(declared: LoopSetup, params: ModelParams, accepted: Sequence[str]) -> RobotCfg:
    """Return the declared robot with the accepted effects and the learned residual added."""
    robot = declared.robot if "battery_sag" in accepted else declared.stated
    flights = ", ".join(flight.name for flight in declared.train.flights)
    if params.deviation is not None:
        robot = redeclare(
            robot, declared.tolerances, params.deviation, f"aerial-gym close-loop on the flights {flights}"
        )
    learned = robot if params.learned is None else replace(robot, learned_residual=params.learned.cfg)
    if not accepted:
        return learned
    effects = {name: dict(values) for name, values in robot.effects.items() if not EFFECTS.get(name).is_in_prediction}
    effects |= {
        name: {p.name: float(v) for p, v in zip(EFFECTS.get(name).parameters, values, strict=True)}
        for name, values in params.effects.items()
    }
    source = f"{', '.join(accepted)}: aerial-gym close-loop on the flights {flights}"
    return robot_with_effects(learned, effects, source)


def robot_with_effects(robot: RobotCfg, effects: dict[str, dict[str, float]], source: str) -> RobotCfg:
    """Return a robot with its effects replaced; ``source`` precedes its previous ``effects_source``."""
    before = f"; before: {robot.effects_source}" if robot.effects_source else ""
    return replace(robot, effects=effects, effects_source=f"{source}{before}")
