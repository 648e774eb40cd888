"""The verdict on flights with failures: a failure that every flight has goes into the robot file."""

from collections.abc import Sequence
from dataclasses import replace

from aerial_gym.config.robot import RobotCfg
from aerial_gym.physics import EFFECTS
from aerial_gym.sim2real.failures.flight_event import Failure, failure_of_all_flights
from aerial_gym.sim2real.findings import Finding
from aerial_gym.sim2real.judge.analysis import LoopResult, robot_with_effects
from aerial_gym.sim2real.judge.outcome import NOTHING_NAMED
from aerial_gym.sim2real.judge.verdict import MOST_CONFIDENT, NamedEffect, parameters_in_file


def result_with_failures(judged: LoopResult, failures: Sequence[Failure], flights: int) -> LoopResult:
    """Return the result with its failures added, and in the corrected robot a failure that every flight has.

    Args:
        flights: Number of all flights, including those that fail at once.
    """
    if not failures:
        return judged
    every, verdict, robot = failure_of_all_flights(failures, flights), judged.verdict, judged.corrected
    effect = None if every is None else _failure_as_effect(every, judged.declared.stated)
    if effect is None:
        advice = tuple(_training_advice(failure) for failure in failures)
        verdict = replace(verdict, notes=(*advice, *verdict.notes))
    else:
        added, candidates = (*verdict.effects, effect), (*verdict.candidates, effect.name)
        verdict = replace(verdict, effects=added, candidates=candidates)
        effects = {**robot.effects, effect.name: effect.params}
        robot = robot_with_effects(robot, effects, f"{effect.name}: aerial-gym close-loop, in every flight")
    kind = "explained" if verdict.verdict in NOTHING_NAMED else verdict.verdict  # the failures explain the flights
    return replace(judged, verdict=replace(verdict, verdict=kind, failures=tuple(failures)), corrected=robot)


def result_with_suspicions(judged: LoopResult, failures: Sequence[Failure]) -> LoopResult:
    """Return the result with a note on each flight with a suspected failure, which changes nothing else."""
    if not failures:
        return judged
    notes = [
        Finding("failure_suspected", one.flight, {**one.finding.values, "log_odds": one.log_odds}) for one in failures
    ]
    return replace(judged, verdict=replace(judged.verdict, notes=(*judged.verdict.notes, *notes)))


def _failure_as_effect(failure: Failure, robot: RobotCfg) -> NamedEffect | None:
    """Return a failure as an effect of the vehicle; None if its parameters are not all those of the effect."""
    params = _robot_file_parameters(failure)
    if set(params) != {parameter.name for parameter in EFFECTS.get(failure.name).parameters}:
        return None
    std = {name: one for name, one in failure.std.items() if name in params}
    confidence, declared = min(failure.probability, MOST_CONFIDENT), parameters_in_file(failure.name, robot)
    more = {"frozen": (), "confidence": confidence, "declared": declared, "place": failure.place}
    return NamedEffect(name=failure.name, params=params, std=std, noise_std=std, **more)


def _robot_file_parameters(failure: Failure) -> dict[str, float]:
    """Return the parameters that a robot file holds; a failure without end gets the longest duration allowed."""
    known = {parameter.name: parameter for parameter in EFFECTS.get(failure.name).parameters}
    params = {name: value for name, value in failure.params.items() if name in known}
    if "duration" in known:
        params.setdefault("duration", known["duration"].high)
    return {name: float(f"{value:.6g}") for name, value in params.items()}


def _training_advice(failure: Failure) -> Finding:
    """Return the advice for training with a failure that only single flights have: the effect for a robot file."""
    name, params = failure.name, _robot_file_parameters(failure)
    if "time" not in params:  # a broken propeller: thrust is quadratic in speed, so the speed scale is the root
        params = {"motor": params["motor"], "scale": params["scale"] ** 0.5, "time": failure.time}
        name = "motor_failure"
    return Finding("train_with_failure", failure.flight, {"effect": name, "params": params})
