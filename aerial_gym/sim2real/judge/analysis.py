"""The last stage of the loop: what test flights say of the corrected model, and the robot that comes out."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from aerial_gym.config.robot import RobotCfg
from aerial_gym.physics import EFFECTS
from aerial_gym.sim2real.arrays import Array
from aerial_gym.sim2real.findings import Finding, unit_key
from aerial_gym.sim2real.identify.learned import judge_on_test, train_residual
from aerial_gym.sim2real.identify.least_squares.gauss_newton import FARTHEST_DEVIATION
from aerial_gym.sim2real.identify.selection.select import SelectionResult
from aerial_gym.sim2real.identify.stages import Declared, named_model
from aerial_gym.sim2real.judge.ablation import ablations
from aerial_gym.sim2real.judge.breakdown import by_flight, where_it_acts
from aerial_gym.sim2real.judge.decision import Decision, decide
from aerial_gym.sim2real.judge.doubt import doubt_notes, with_doubt
from aerial_gym.sim2real.judge.evaluation import Evaluation, evaluate
from aerial_gym.sim2real.judge.experiments.design import fits_vehicle, what_to_fly
from aerial_gym.sim2real.judge.outcome import Outcome, outcomes
from aerial_gym.sim2real.judge.random_wind.gusts import NAME, declared_wind, with_random
from aerial_gym.sim2real.judge.unexplained import Unexplained, find_unexplained, judges_forces, rms_of
from aerial_gym.sim2real.judge.verdict import NamedEffect, Verdict, immaterial, named_effects, tied_rivals
from aerial_gym.sim2real.judge.whiteness import whiteness
from aerial_gym.sim2real.logs.flights import Flight, notes_of, rigid_notes
from aerial_gym.sim2real.predict.channels import UNITS
from aerial_gym.sim2real.predict.model_params import ModelParams
from aerial_gym.sim2real.predict.noise_floor import floor_of_flight, of_all_flights
from aerial_gym.sim2real.progress import Progress


@dataclass(frozen=True, kw_only=True)
class Judged:
    """Everything that a report shows."""

    declared: Declared
    selection: SelectionResult
    params: ModelParams
    """The final model, with what was learned."""

    within: ModelParams
    """The final model with the deviations within the tolerances that fit the training flights best."""

    corrected: RobotCfg
    verdict: Verdict


def judge(
    declared: Declared, selection: SelectionResult, *, seed: int, learn_residual: bool, progress: Progress
) -> Judged:
    """Return what the test flights say; nothing is fitted to them.

    Args:
        declared: The declared robot beside the flights.
        selection: The effects that the training flights ask for.
        seed: Of the resampling behind intervals, and of the first weights of a network.
        learn_residual: Whether a small network may be added for what no named effect explains.
        progress: Told what is being done.
    """
    tested, model = declared.test, named_model(declared, selection)

    progress("the noise floor of the test flights", 0.7)
    floors = floors_in_declared_wind(declared, model)
    still = of_all_flights(floors)
    progress("rollouts of the declared and the corrected model", 0.8)
    pair = (declared.params, model) if selection.accepted else (declared.params,)
    evaluations = evaluate(declared.robot, tested, pair, floor=still, seed=seed)
    before, named = evaluations[0], evaluations[-1]
    unexplained = find_unexplained(declared.train, tested, selection, (declared.params, model), named, still)
    doubtful = selection.accepted and (unexplained.left_open or unexplained.open_to)
    result = with_doubt(selection, tested) if doubtful else selection
    progress("what each effect is worth", 0.93)
    effects = judged_effects(declared, result, model, (before, named), unexplained.floor, seed=seed)
    learned = None
    if learn_residual:
        progress("learning what remains", 0.9)
        trained = train_residual(declared.train, model, result.left_out, seed=seed)
        learned = judge_on_test(trained, tested, model, unexplained.floor)
    if learned is None or learned.effect is None:
        params, after = model, unexplained.above_its_floor(named)
    else:
        params = replace(model, learned=learned.effect)
        (after,) = evaluate(declared.robot, tested, [params], floor=unexplained.floor, seed=seed)
    gusts = ()
    if NAME not in declared.robot.effects and unexplained.wind.accepted:
        gusts = (unexplained.wind.named(declared.stated),)
    made = decision(declared, result, unexplained, gusts)
    became: tuple[Outcome, ...] = ()
    models, both, least = (declared.params, params), (before, after), result.criteria.material
    if effects or gusts or (learned is not None and learned.cfg is not None):
        became = outcomes(tested, models, both, least=least)
    manoeuvre, fly_next = what_to_fly(declared, result, unexplained.open_to)
    spectra = whiteness(tested.times, unexplained.left, declared.channels, declared.bandwidth)
    verdict = Verdict(
        verdict=made.kind,
        open_points=made.findings,
        effects=(*effects, *gusts),
        candidates=made.candidates,
        not_testable=not_testable(result, declared.stated, unexplained),
        manoeuvre=manoeuvre,
        fly_next=fly_next,
        inclusion=result.chosen.inclusion,
        sets=result.chosen.sets,
        structure=unexplained.structure,
        before=before,
        after=after,
        outcomes=became,
        flights=by_flight(tested, models, both, floors_with_gusts(floors, unexplained), least=least, seed=seed),
        unexplained=unexplained.channels,
        not_shown=unexplained.left_open,
        whiteness=dict(zip((channel.name for channel in declared.channels), spectra, strict=True)),
        learned=learned,
        notes=notes(declared, result, model, unexplained, effects, named),
    )
    accepted = (*result.accepted, *(effect.name for effect in gusts))
    return Judged(
        declared=declared,
        selection=result,
        params=params,
        within=unexplained.within,
        corrected=corrected_robot(declared, with_random(params, unexplained.wind), accepted),
        verdict=verdict,
    )


def floors_in_declared_wind(declared: Declared, params: ModelParams) -> list[Array | None]:
    """Return the noise floor of each channel on each test flight, declared random wind included, (C,); None: not shown."""
    test = declared.test
    wind = declared_wind(declared.robot).adds(test, params)
    floors = [floor_of_flight(declared.robot, f, params, test.channels, test.bandwidth) for f in test.flights]
    return beside_wind(floors, wind)


def beside_wind(floors: Sequence[Array | None], wind: Array) -> list[Array | None]:
    """Return the noise floors of flights with what random wind adds to each channel, (C,) each."""
    return [None if floor is None else np.hypot(floor, wind) for floor in floors]


def floors_with_gusts(floors: Sequence[Array | None], unexplained: Unexplained) -> list[Array | None]:
    """Return the noise floors of flights, (C,) each, with the random wind that was found in them."""
    still = of_all_flights(floors)
    if still is None or unexplained.floor is None:
        return list(floors)
    return beside_wind(floors, np.sqrt(np.maximum(unexplained.floor**2 - still**2, 0.0)))


def judged_effects(
    declared: Declared,
    selection: SelectionResult,
    model: ModelParams,
    evaluations: tuple[Evaluation, Evaluation],
    floor: Array | None,
    *,
    seed: int,
) -> tuple[NamedEffect, ...]:
    """Return the accepted effects with what each is worth on the test flights, and where it acts.

    ``floor`` is the noise floor of each channel with random wind in it, (C,).
    """
    test, models = declared.test, (declared.params, model)
    worth = ablations(declared.robot, test.flights, (declared.train, test), models, evaluations, selection)
    weight = selection.weights.weight
    regimes = {name: where_it_acts(test, *models, name, weight, floor, seed=seed) for name in selection.accepted}
    return named_effects(selection, worth, regimes, declared.stated)


def decision(
    declared: Declared, selection: SelectionResult, unexplained: Unexplained, gusts: Sequence[NamedEffect]
) -> Decision:
    """Return the decision of the verdict."""
    made = decide(
        {name: tied_rivals(name, selection) for name in selection.accepted},
        unexplained.channels,
        unexplained.floor is not None,
        open_to=unexplained.open_to,
        left_open=unexplained.left_open,
        of_flights=unexplained.of_flights,
    )
    made = unexplained.wind.decision(made) if gusts else made
    if judges_forces(declared.flights) or all(channel.kind != "specific_force" for channel in declared.channels):
        return made
    return replace(made, findings=(*made.findings, Finding("forces_not_judged")))


def notes(
    declared: Declared,
    selection: SelectionResult,
    model: ModelParams,
    unexplained: Unexplained,
    effects: Sequence[NamedEffect],
    named: Evaluation,
) -> tuple[Finding, ...]:
    """Return the notes, the most important first; those on the logs come last.

    ``named`` is the evaluation of the named effects on the test flights.
    """
    return (
        *rigid_notes(declared.stated),
        *doubt_notes(selection),
        *open_notes(unexplained),
        *unexplained.wind.notes,
        *immaterial(effects),
        *(rival.finding for effect in effects for rival in effect.in_part),
        *strained_notes(declared, model, selection.criteria.material, unexplained, named),
        *surrogate_notes(selection),
        *own_notes(selection),
        *about_logs(declared),
    )


def strained_notes(
    declared: Declared, model: ModelParams, least: float, unexplained: Unexplained, named: Evaluation
) -> list[Finding]:
    """Return a note on each strained tolerance, and one on the errors that all deviations together change."""
    found = declared.tolerances.strained(
        unexplained.deviation, absent=absent_tolerances(declared, model), farthest=FARTHEST_DEVIATION
    )
    if not found:
        return []
    changed = []
    rms = rms_of(unexplained.left).tolist()
    for channel, value, bare in zip(declared.channels, rms, named.residual, strict=True):
        if abs(value - bare.value) > least * bare.value:
            unit = unit_key(channel.unit)
            changed.append({"channel": channel.name, f"with_{unit}": value, f"without_{unit}": bare.value})
    if not changed:
        return [*found, Finding("strained_changes_little")]
    return [*found, Finding("strained_changes", "", {"errors": changed})]


def absent_tolerances(declared: Declared, params: ModelParams) -> set[str]:
    """Return the tolerances of what the vehicle, or its logs, do not have: a deviation there is no finding about it."""
    flights = declared.train.flights
    soft = any(effect.replayed and effect.remembers for effect in map(EFFECTS.get, params.effects))
    has = {
        "nominal_voltage": declared.stated.battery is not None,
        "joint_rest": soft,
        "time_constant": any(flight.rotor_command is not None for flight in flights),
        "command_hold": any(flight.rotor_command is not None for flight in flights),
        **{f"acc_bias_{axis}": any(flight.accelerometer for flight in flights) for axis in "xyz"},
        **{f"gyro_bias_{axis}": any(flight.gyro for flight in flights) for axis in "xyz"},
        **{f"attitude_{axis}": any(map(implies_force, flights)) for axis in "xyz"},
    }
    return {name for name, present in has.items() if not present}


def implies_force(flight: Flight) -> bool:
    """Return whether attitude and velocity of a flight say what an accelerometer reads."""
    return flight.lin_vel is not None and not flight.attitude_integrated


def own_notes(selection: SelectionResult) -> list[Finding]:
    """Return a note on the offsets that differ from flight to flight, and so belong to no vehicle."""
    offsets = [
        {"channel": one.channel, f"rms_{unit_key(UNITS[one.channel.split('.')[0]])}": one.size}
        for one in selection.chosen.best.own
    ]
    return [Finding("offsets_sizes", "", {"offsets": offsets})] if offsets else []


def about_logs(declared: Declared) -> list[Finding]:
    """Return the notes on the logs, their rate and their number."""
    flights, band = declared.flights, declared.bandwidth
    found = notes_of(flights)
    if band < declared.asked_bandwidth:
        slowest = min(flight.rate for flight in flights)
        found.append(Finding("band_limited", "", {"band_hz": band, "slowest_hz": slowest}))
    if (count := len(declared.train.flights)) < 3:
        found.append(Finding("few_flights", "", {"flights": count}))
    return found


def surrogate_notes(selection: SelectionResult) -> list[Finding]:
    """Return a note on each effect that lost its name to a structure."""
    return [Finding("stands_in", name, {"structure": kind}) for name, kind in selection.surrogates.items()]


def open_notes(unexplained: Unexplained) -> list[Finding]:
    """Return a note on the channels that the training flights leave open."""
    channels = list(unexplained.left_open)
    return [Finding("left_open_note", "", {"channels": channels})] if channels else []


def not_testable(selection: SelectionResult, robot: RobotCfg, unexplained: Unexplained) -> dict[str, Finding]:
    """Return the effects that the flights cannot show, with the reason; also look-alikes without a model.

    Nobody is told what to fly for soft arms of a vehicle that has none. Of one with joints no effect on links can be shown.
    """
    found = dict(selection.not_testable)
    if robot.joints is not None:
        found |= {name: Finding("acts_on_links", name) for name in EFFECTS if not EFFECTS.get(name).on_rigid}
    for name in found:
        if robot.joints is None and not fits_vehicle(name, selection, robot):
            found[name] = Finding("no_soft_arms", name)
    for name in selection.accepted:
        for other in EFFECTS.get(name).confused_with:
            if other not in EFFECTS:
                found.setdefault(other, Finding("no_such_effect", other, {"alike": name}))
    return found | ({NAME: wind} if (wind := unexplained.wind.untestable) is not None else {})


def corrected_robot(declared: Declared, params: ModelParams, accepted: Sequence[str]) -> RobotCfg:
    """Return the declared robot with the accepted effects, and what was learned, in it."""
    robot = declared.robot if "battery_sag" in accepted else declared.stated
    learned = robot if params.learned is None else replace(robot, learned_residual=params.learned.cfg)
    if not accepted:
        return learned
    effects = {name: dict(values) for name, values in robot.effects.items() if not EFFECTS.get(name).predicts}
    effects |= {
        name: {p.name: float(v) for p, v in zip(EFFECTS.get(name).parameters, values, strict=True)}
        for name, values in params.effects.items()
    }
    flights = ", ".join(flight.name for flight in declared.train.flights)
    source = f"{', '.join(accepted)}: aerial-gym close-loop on the flights {flights}"
    return with_effects(learned, effects, source)


def with_effects(robot: RobotCfg, effects: dict[str, dict[str, float]], source: str) -> RobotCfg:
    """Return a robot with these effects in place of its own, and with where they come from told before where its own did."""
    before = f"; before: {robot.effects_source}" if robot.effects_source else ""
    return replace(robot, effects=effects, effects_source=f"{source}{before}")
