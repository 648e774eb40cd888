"""The verdict on flights with failures: a failure that every flight has goes into the robot file."""

from collections.abc import Sequence
from dataclasses import replace

from aerial_gym.config.robot import RobotCfg
from aerial_gym.physics import EFFECTS
from aerial_gym.sim2real.failures.flight_event import Failure, same_in_all
from aerial_gym.sim2real.findings import Finding
from aerial_gym.sim2real.judge.analysis import Judged, with_effects
from aerial_gym.sim2real.judge.outcome import NOTHING_NAMED
from aerial_gym.sim2real.judge.verdict import MOST_CONFIDENT, NamedEffect, Verdict, declared_params_of


def with_failures(judged: Judged, failures: Sequence[Failure], flights: int) -> Judged:
    """Return what was judged of flights up to their failures, with these.

    Args:
        judged: Of the flights as far as they are compared.
        failures: Of all flights, training flights first.
        flights: How many flights there are, those that have nothing before their failure included.
    """
    if not failures:
        return judged
    every = same_in_all(failures, flights)
    effect = None if every is None else _effect(every, judged.declared.stated)
    verdict = _told(judged.verdict, failures, effect)
    if effect is None:
        return replace(judged, verdict=verdict)
    return replace(judged, verdict=verdict, corrected=_failing(judged.corrected, effect))


def with_suspicions(judged: Judged, failures: Sequence[Failure]) -> Judged:
    """Return what was judged with a note on each flight that looks as if something failed in it, of which nothing was made."""
    if not failures:
        return judged
    notes = [
        Finding("failure_suspected", one.flight, {**one.finding.values, "log_odds": one.log_odds}) for one in failures
    ]
    return replace(judged, verdict=replace(judged.verdict, notes=(*judged.verdict.notes, *notes)))


def _told(verdict: Verdict, failures: Sequence[Failure], effect: NamedEffect | None) -> Verdict:
    """Return a verdict with failures; they explain the flights if nothing else is named."""
    return replace(
        verdict,
        verdict="explained" if verdict.verdict in NOTHING_NAMED else verdict.verdict,
        effects=verdict.effects if effect is None else (*verdict.effects, effect),
        candidates=verdict.candidates if effect is None else (*verdict.candidates, effect.name),
        failures=tuple(failures),
        notes=(*(_how_to_train(failure) for failure in failures if effect is None), *verdict.notes),
    )


def _effect(failure: Failure, robot: RobotCfg) -> NamedEffect | None:
    """Return a failure as an effect of the vehicle, None if it has no onset there."""
    params = _in_robot_file(failure)
    if set(params) != {parameter.name for parameter in EFFECTS.get(failure.name).parameters}:
        return None
    std = {name: one for name, one in failure.std.items() if name in params}
    return NamedEffect(
        name=failure.name,
        params=params,
        std=std,
        noise_std=std,
        frozen=(),
        confidence=min(failure.probability, MOST_CONFIDENT),
        declared=declared_params_of(failure.name, robot),
        place=failure.place,
    )


def _in_robot_file(failure: Failure) -> dict[str, float]:
    """Return the parameters that a robot file has; of what does not end, a duration as long as any."""
    known = {parameter.name: parameter for parameter in EFFECTS.get(failure.name).parameters}
    params = {name: value for name, value in failure.params.items() if name in known}
    if "duration" in known:
        params.setdefault("duration", known["duration"].high)
    return {name: float(f"{value:.6g}") for name, value in params.items()}


def _how_to_train(failure: Failure) -> Finding:
    """Return the effect for a robot file that trains with a failure of single flights."""
    name, params = failure.name, _in_robot_file(failure)
    if "time" not in params:  # a propeller that breaks: the speed that leaves as much thrust
        name, params = (
            "motor_failure",
            {"motor": params["motor"], "scale": params["scale"] ** 0.5, "time": failure.time},
        )
    return Finding("train_with_failure", failure.flight, {"effect": name, "params": params})


def _failing(robot: RobotCfg, effect: NamedEffect) -> RobotCfg:
    """Return the robot with a failure that every flight has."""
    effects = {**robot.effects, effect.name: effect.params}
    return with_effects(robot, effects, f"{effect.name}: aerial-gym close-loop, in every flight")
