"""Closed loop from flights to a corrected robot file, with a named cause of each difference."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from aerial_gym.config import dump_yaml
from aerial_gym.config.changes import Changes
from aerial_gym.config.robot import RobotCfg
from aerial_gym.errors import ConfigError, DataError
from aerial_gym.interop import one_thread
from aerial_gym.physics.effects import LearnedResidual
from aerial_gym.physics.model import check_effect_on_rotors
from aerial_gym.robots.catalog import robot_by_name
from aerial_gym.sim2real.failures.flight_event import Failure, FailureFinder, cut_at_failures
from aerial_gym.sim2real.identify.selection.criteria import Criteria
from aerial_gym.sim2real.identify.selection.select import SelectionResult, select_effects
from aerial_gym.sim2real.identify.stages import LoopSetup, prepare_comparison
from aerial_gym.sim2real.json_values import write_json
from aerial_gym.sim2real.judge.analysis import LoopResult, judge_on_test_flights
from aerial_gym.sim2real.judge.failure_verdict import result_with_failures, result_with_suspicions
from aerial_gym.sim2real.judge.pairs.vehicles import flights_by_vehicle, verdict_with_each_vehicle
from aerial_gym.sim2real.judge.remainder import are_gusts_sufficient
from aerial_gym.sim2real.judge.verdict import Verdict
from aerial_gym.sim2real.logs.flights import Flight, FlightInputs, read_flight_inputs
from aerial_gym.sim2real.logs.pairs import pair_logs
from aerial_gym.sim2real.logs.readers.mapping import find_mapping
from aerial_gym.sim2real.memory import give_back_memory, keep_large_arrays_apart
from aerial_gym.sim2real.predict.tolerances import Tolerances
from aerial_gym.sim2real.progress import Progress, silent
from aerial_gym.sim2real.report.ranges import uncertainty_ranges
from aerial_gym.sim2real.report.report import write_report
from aerial_gym.sim2real.report.run_folder import atomic_run_folder, check_out_dir, write_record
from aerial_gym.sim2real.report.verdict_json import verdict_json
from aerial_gym.sim2real.wording import text

if TYPE_CHECKING:
    from aerial_gym.sim2real.teststand.joints.flights import FlightJointStudy


def close_loop(
    robot: str | Path, train: Sequence[str | Path], test: Sequence[str | Path], out_dir: str | Path, *,
    mapping: str | Path | None = None, bandwidth: float = 10.0, seed: int = 0, criteria: Criteria | None = None,
    tolerances: Tolerances | None = None, effects: Sequence[str] | None = None, failures: bool = False,
    joints: bool = False, learn_residual: bool = False, ranges: bool = False, settings: Sequence[str] = (),
    pairs: Sequence[tuple[str | Path, str | Path]] = (), pair_clocks: Sequence[float] = (), progress: Progress = silent,
) -> Verdict:  # fmt: skip
    """Identify errors of the declared robot, and write verdict.json, robot.yaml, report.html, report.md and tables.

    Args:
        robot: Registered robot, or a robot file.
        train: Logs of the training flights.
        test: Logs of the test flights, which no fit uses. Logs are read once at the start, for joints once more.
        out_dir: Output folder, written only if the run succeeds.
        mapping: Name or file of a log mapping; None for logs of this package's layout.
        bandwidth: Bandwidth of the comparison [Hz].
        seed: Seed of the bootstrap.
        criteria: Acceptance criteria of effects.
        tolerances: Standard deviations of the declared values.
        effects: Candidate effects; None: all.
        failures: Whether to search each flight for failures and compare it only up to the first one.
        joints: Whether to fit the joint springs to the training flights as well (``fit_joints_to_flights``).
        learn_residual: Whether a small network may be added for the unexplained residual. It does not change the verdict.
        ranges: Whether robot.yaml also draws identified parameters from their uncertainty at every reset (``randomize:``).
        pairs: Logs of two vehicles in one flight. Each of them sees the other one's position; those among the training and
            test flights are of ``robot`` and share its parameters.
        pair_clocks: Added to the times of the second log of each pair, which gives those of the first [s]; 0 if not given.
        settings: Changed settings ``KEY=VALUE`` of ``robot``, ``tolerances`` and ``criteria``: ``robot.body.mass=0.3``.
        progress: Called with each stage and the completed share.

    Raises:
        DataError: If a file is missing, or no usable training or test log is left.
        ConfigError, UnknownNameError: If robot or mapping is invalid or unknown.
    """
    check_out_dir(Path(out_dir))
    changes = Changes(settings)
    declared = changes.apply("robot", robot_by_name(robot))
    tolerances = changes.apply("tolerances", tolerances or Tolerances())
    criteria = changes.apply("criteria", criteria or Criteria())
    changes.finish()
    if joints and mapping is not None:
        raise ConfigError(
            "joints are found in logs of the package's own layout: leave the mapping out, or convert the logs"
        )
    with one_thread():
        progress("reading flights", 0.0)
        layout = None if mapping is None else find_mapping(mapping)
        together = pair_logs(pairs, pair_clocks)
        inputs = read_flight_inputs(declared, train, test, mapping=layout, bandwidth=bandwidth, pairs=together)
        for note in inputs.left_out:
            progress(text(note), 0.0)
        joint_study = _identify_joints(declared, inputs, progress) if joints else None
        judged = judge_flights(
            declared, inputs.train, inputs.test, bandwidth=bandwidth, seed=seed, criteria=criteria, tolerances=tolerances,
            effects=effects, failures=failures, learn_residual=learn_residual, progress=progress,
        )  # fmt: skip
        notes = (*inputs.left_out, *judged.verdict.notes)
        judged = replace(judged, verdict=replace(judged.verdict, notes=notes))
        if joint_study is not None:
            judged = joint_study.add_to_verdict(judged)
        verdict = judged.verdict
        corrected = judged.corrected
        if ranges:
            drawn = {**corrected.randomize, **uncertainty_ranges(corrected, verdict.effects)}
            corrected = replace(corrected, randomize=drawn)
        progress("writing the report", 0.97)
        config = {
            "command": "close-loop",
            "robot": str(robot),
            "train": [str(path) for path in train],
            "test": [str(path) for path in test],
            "pairs": [vars(pair) for pair in together],
            "mapping": None if mapping is None else str(mapping),
            "bandwidth_hz": bandwidth,
            "seed": seed,
            "effects": None if effects is None else list(effects),
            **{"failures": failures, "joints": joints, "learn_residual": learn_residual, "ranges": ranges},
            "settings": list(settings),
            "criteria": vars(judged.selection.criteria),
            "tolerances": vars(judged.declared.tolerances),
        }
        with atomic_run_folder(Path(out_dir)) as folder:
            write_json(folder / "verdict.json", verdict_json(verdict))
            (folder / "robot.yaml").write_text(dump_yaml(corrected), encoding="utf-8", errors="surrogateescape")
            write_report(folder, judged)
            write_record(folder, config, inputs.digests)
    progress("done", 1.0)
    return verdict


def _identify_joints(robot: RobotCfg, inputs: FlightInputs, progress: Progress) -> "FlightJointStudy":
    """Return the joint parameters fitted to the training flights."""
    from aerial_gym.sim2real.teststand.joints.flights import BANDWIDTH_HZ, OF_RATE, fit_joints_to_flights

    used, rate = [Path(flight.path) for flight in inputs.train], min(flight.rate for flight in inputs.train)
    return fit_joints_to_flights(robot, used, bandwidth=min(BANDWIDTH_HZ, OF_RATE * rate), progress=progress)


def judge_flights(
    robot: RobotCfg, train: Sequence[Flight], test: Sequence[Flight], *, bandwidth: float = 10.0, seed: int = 0,
    criteria: Criteria | None = None, tolerances: Tolerances | None = None, effects: Sequence[str] | None = None,
    failures: bool = False, learn_residual: bool = False, progress: Progress = silent,
) -> LoopResult:  # fmt: skip
    """Return the result of the closed loop for flights in memory; arguments as for ``close_loop``.

    With ``failures``, flights are compared up to their first failure. Otherwise a note reports suspected failures.

    Raises:
        DataError: If failures leave no training or no test flight.
    """
    keep_large_arrays_apart()
    if learn_residual:
        check_effect_on_rotors(LearnedResidual, robot.rotor_traits)
    flights, off = [*train, *test], tolerances or Tolerances()
    finder = FailureFinder(robot, tolerances=off)
    seen = [failure for flight in flights if (failure := finder.find_first_failure(flight)) is not None]
    told = seen if failures else []
    learnt, judging = (_flights_until_failure(role, part, told) for role, part in (("train", train), ("test", test)))
    declared = prepare_comparison(robot, learnt, judging, bandwidth=bandwidth, tolerances=off)
    selection = _selection_beside_gusts(declared, criteria or Criteria(), effects, progress)
    give_back_memory()
    judged = judge_on_test_flights(declared, selection, seed=seed, learn_residual=learn_residual, progress=progress)
    give_back_memory()
    own = list(zip(flights_by_vehicle(learnt), flights_by_vehicle(judging), strict=True))
    if judged.verdict.verdict == "unexplained" and all(part for parts in own for part in parts):
        progress("each vehicle by itself", 0.95)
        settings = {"bandwidth": bandwidth, "seed": seed, "criteria": criteria, "tolerances": off, "effects": effects}
        alone = [judge_flights(robot, *parts, **settings).verdict for parts in own]
        complete = all(flight.pair is not None for flight in flights) and judged.verdict.learned is None
        judged = replace(judged, verdict=verdict_with_each_vehicle(judged.verdict, alone, is_complete=complete))
    return result_with_failures(judged, told, len(flights)) if failures else result_with_suspicions(judged, seen)


def _selection_beside_gusts(
    declared: LoopSetup, criteria: Criteria, effects: Sequence[str] | None, progress: Progress
) -> SelectionResult:
    """Return the selection among ``effects``; that of no effect if gusts alone explain the training flights."""
    asked = (declared.train, declared.params, criteria, lambda stage, share: progress(stage, 0.05 + 0.65 * share))
    first = select_effects(*asked, test=declared.test.flights, candidates=effects)
    if not are_gusts_sufficient(declared.train, declared.params, first):
        return first
    return replace(select_effects(*asked, candidates=()), not_testable=first.not_testable, looked_for=first.looked_for)


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
