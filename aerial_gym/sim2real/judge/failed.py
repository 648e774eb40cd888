"""A verdict on flights of which some failed: what failed is told first, and is in the robot file if every flight has it."""

from collections.abc import Sequence
from dataclasses import replace

from aerial_gym.config.robot import RobotCfg
from aerial_gym.physics import EFFECTS
from aerial_gym.sim2real.failures.finding import Failure, same_in_all
from aerial_gym.sim2real.judge.analysis import Judged, with_effects
from aerial_gym.sim2real.judge.outcome import NOTHING_NAMED
from aerial_gym.sim2real.judge.verdict import MOST_CONFIDENT, NamedEffect, Verdict


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
    effect = None if every is None else _effect(every)
    verdict = _told(judged.verdict, failures, effect)
    if effect is None:
        return replace(judged, verdict=verdict)
    return replace(judged, verdict=verdict, corrected=_failing(judged.corrected, effect))


def with_suspicions(judged: Judged, failures: Sequence[Failure]) -> Judged:
    """Return what was judged with a note on each flight that looks as if something failed in it, of which nothing was made."""
    if not failures:
        return judged
    return replace(judged, verdict=replace(judged.verdict, notes=(*judged.verdict.notes, *map(_suspected, failures))))


def _suspected(failure: Failure) -> str:
    return (
        f"{failure.sentence}: so it looks beside the declared vehicle (log odds {failure.log_odds:.1f}), and nothing was made "
        f"of it. If that may have happened, --failures compares {failure.flight} up to there; a vehicle that is declared wrong "
        "by much can look so too"
    )


def _told(verdict: Verdict, failures: Sequence[Failure], effect: NamedEffect | None) -> Verdict:
    """Return a verdict that begins with the failures; where nothing else is to be named, they are what explains."""
    sentences = "; ".join(failure.sentence for failure in failures)
    return replace(
        verdict,
        verdict="explained" if verdict.verdict in NOTHING_NAMED else verdict.verdict,
        reason=verdict.told_before(f"{sentences}; up to then: "),
        effects=verdict.effects if effect is None else (*verdict.effects, effect),
        candidates=verdict.candidates if effect is None else (*verdict.candidates, effect.name),
        failures=tuple(failures),
        notes=(*(_how_to_train(failure) for failure in failures if effect is None), *verdict.notes),
    )


def _effect(failure: Failure) -> NamedEffect | None:
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
    )


def _in_robot_file(failure: Failure) -> dict[str, float]:
    """Return the parameters that a robot file has; of what does not end, a duration as long as any."""
    known = {parameter.name: parameter for parameter in EFFECTS.get(failure.name).parameters}
    params = {name: value for name, value in failure.params.items() if name in known}
    if "duration" in known:
        params.setdefault("duration", known["duration"].high)
    return {name: float(f"{value:.6g}") for name, value in params.items()}


def _how_to_train(failure: Failure) -> str:
    """Return what a robot file needs to have a failure that is not in all flights."""
    name, params = failure.name, _in_robot_file(failure)
    if "time" not in params:  # a propeller that breaks: the speed that leaves as much thrust
        name, params = (
            "motor_failure",
            {"motor": params["motor"], "scale": params["scale"] ** 0.5, "time": failure.time},
        )
    text = ", ".join(f"{key}: {value:.4g}" for key, value in params.items())
    return (
        f"{failure.flight} is compared up to its failure; that is not in robot.yaml, for not every flight has it: to train "
        f"with it add to effects: {name}: {{{text}}}"
    )


def _failing(robot: RobotCfg, effect: NamedEffect) -> RobotCfg:
    """Return the robot with a failure that every flight has."""
    effects = {**robot.effects, effect.name: effect.params}
    return with_effects(robot, effects, f"{effect.name}: aerial-gym close-loop, in every flight")
