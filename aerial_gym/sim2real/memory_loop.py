"""Closed loop for flights in memory, stage by stage."""

from collections.abc import Sequence

from aerial_gym.config.robot import RobotCfg
from aerial_gym.errors import DataError
from aerial_gym.physics.effects import LearnedResidual
from aerial_gym.physics.model import check_rotors
from aerial_gym.sim2real.failures.flight_event import Failure, FailureFinder, cut_at_failures
from aerial_gym.sim2real.identify.selection.scoring import Criteria
from aerial_gym.sim2real.identify.stages import prepare_comparison, select_effects_of_setup
from aerial_gym.sim2real.judge.analysis import LoopResult, judge_on_test_flights
from aerial_gym.sim2real.judge.failure_verdict import result_with_failures, result_with_suspicions
from aerial_gym.sim2real.logs.flights import Flight
from aerial_gym.sim2real.memory import give_back_memory
from aerial_gym.sim2real.predict.tolerances import Tolerances
from aerial_gym.sim2real.progress import Progress, silent
from aerial_gym.sim2real.wording import text


def judge_flights(
    robot: RobotCfg,
    train: Sequence[Flight],
    test: Sequence[Flight],
    *,
    bandwidth: float = 10.0,
    seed: int = 0,
    criteria: Criteria | None = None,
    tolerances: Tolerances | None = None,
    effects: Sequence[str] | None = None,
    failures: bool = False,
    learn_residual: bool = False,
    progress: Progress = silent,
) -> LoopResult:
    """Return the result of the closed loop for flights in memory; arguments as for ``close_loop``.

    With ``failures``, flights are compared up to their first failure. Otherwise a note reports suspected failures.

    Raises:
        DataError: If failures leave no training or no test flight.
    """
    if learn_residual:
        check_rotors(LearnedResidual, robot.rotor_traits)
    flights, off = [*train, *test], tolerances or Tolerances()
    finder = FailureFinder(robot, tolerances=off)
    seen = [failure for flight in flights if (failure := finder.find_first_failure(flight)) is not None]
    told = seen if failures else []
    learnt, judging = (_flights_until_failure(role, part, told) for role, part in (("train", train), ("test", test)))
    declared = prepare_comparison(robot, learnt, judging, bandwidth=bandwidth, tolerances=off)
    selection = select_effects_of_setup(declared, criteria or Criteria(), progress, candidates=effects)
    give_back_memory()
    judged = judge_on_test_flights(declared, selection, seed=seed, learn_residual=learn_residual, progress=progress)
    give_back_memory()
    return result_with_failures(judged, told, len(flights)) if failures else result_with_suspicions(judged, seen)


def _flights_until_failure(role: str, flights: Sequence[Flight], failures: Sequence[Failure]) -> list[Flight]:
    """Return the flights up to their failures; raise ``DataError`` if none is left."""
    left = cut_at_failures(flights, failures)
    if flights and not left:
        first = next(failure for failure in failures if failure.flight in {flight.name for flight in flights})
        raise DataError(
            f"{text(first.finding)} Too little comes before it to {role} on, and no other flight is left: add one that does "
            "not fail"
        )
    return left
