"""The closed loop: flights against the declared model, a named cause for what differs, a corrected robot file.

``close_loop`` reads and judges; ``judge_flights`` does the same for flights in memory.
"""

import json
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from aerial_gym.config import dump_yaml
from aerial_gym.config.robot import RobotCfg
from aerial_gym.env_manager.sim_builder import robot_by_name
from aerial_gym.errors import ConfigError, DataError
from aerial_gym.interop import one_thread
from aerial_gym.physics import EFFECTS
from aerial_gym.physics.effects import LearnedResidual
from aerial_gym.physics.model import check_effects, check_rotors
from aerial_gym.sim2real.identify.battery import with_battery
from aerial_gym.sim2real.identify.learned import Learned, judge_on_test, train_residual
from aerial_gym.sim2real.identify.least_squares.gauss_newton import params_of, with_params
from aerial_gym.sim2real.identify.output_error import refit_on_rollouts
from aerial_gym.sim2real.identify.selection.inclusion import inclusion
from aerial_gym.sim2real.identify.selection.scoring import Criteria
from aerial_gym.sim2real.identify.selection.select import Selection, select_effects
from aerial_gym.sim2real.judge.ablation import ablations
from aerial_gym.sim2real.judge.analysis import Analysis
from aerial_gym.sim2real.judge.breakdown import by_flight, where_it_acts
from aerial_gym.sim2real.judge.evaluation import evaluate
from aerial_gym.sim2real.judge.experiments.design import Advice, Catalogue, showable, what_shows, what_tells
from aerial_gym.sim2real.judge.noise_floor import noise_floor
from aerial_gym.sim2real.judge.random_wind.gusts import NAME, declared_wind, with_random
from aerial_gym.sim2real.judge.unexplained import find_unexplained, judges_forces
from aerial_gym.sim2real.judge.verdict import Verdict, decide, immaterial, named_effects, tied_rivals
from aerial_gym.sim2real.judge.whiteness import whiteness
from aerial_gym.sim2real.logs.flights import Flight, load_flights
from aerial_gym.sim2real.logs.mapping import find_mapping
from aerial_gym.sim2real.predict.predictor import (
    ModelParams,
    Predictor,
    comparison_band,
    declared_params,
    find_channels,
)
from aerial_gym.sim2real.predict.scene import check_scene
from aerial_gym.sim2real.predict.tolerances import Tolerances
from aerial_gym.sim2real.progress import Progress, silent
from aerial_gym.sim2real.report.ranges import with_found_ranges
from aerial_gym.sim2real.report.run_folder import check_out_dir, whole_folder, write_record

Array = NDArray[np.float64]

SIGNIFICANT_DIGITS = 6
"""Of parameters in the corrected robot file."""


def close_loop(
    robot: str | Path,
    train: Sequence[str | Path],
    test: Sequence[str | Path],
    out_dir: str | Path,
    *,
    mapping: str | Path | None = None,
    bandwidth: float = 10.0,
    seed: int = 0,
    criteria: Criteria | None = None,
    tolerances: Tolerances | None = None,
    learn_residual: bool = False,
    ranges: bool = False,
    progress: Progress = silent,
) -> Verdict:
    """Find what the declared robot lacks, and write verdict.json, robot.yaml, report.html, report.md, residuals.csv.

    Args:
        robot: Registered robot, or a robot file.
        train: Logs to fit on.
        test: Logs to judge on; no fit sees them.
        out_dir: Folder of the results; it appears when all is done, and not at all if something fails.
        mapping: Name or file of a log mapping; None for logs of this package's layout.
        bandwidth: Residuals are compared below it [Hz].
        seed: Of the bootstrap.
        criteria: When an effect is accepted.
        tolerances: How well the robot is declared.
        learn_residual: Whether a small network may be added for what no named effect explains. The verdict stays as it is.
        ranges: Whether robot.yaml also draws what was found from its intervals at every reset (``randomize:``).
        progress: Told what is being done.

    Raises:
        DataError: If a log cannot be used.
        ConfigError, UnknownNameError: If robot or mapping cannot.
    """
    from aerial_gym.sim2real.report.report import write_report  # matplotlib is slow to import

    out_dir = Path(out_dir)
    check_out_dir(out_dir)
    declared = robot_by_name(robot)
    with one_thread():
        flights = load_train_and_test(declared, train, test, mapping, bandwidth, progress)
        analysis = judge_flights(
            declared,
            *flights,
            bandwidth=bandwidth,
            seed=seed,
            criteria=criteria,
            tolerances=tolerances,
            learn_residual=learn_residual,
            progress=progress,
        )
        corrected = analysis.corrected
        if ranges:
            corrected = with_found_ranges(corrected, analysis.verdict.effects)
        progress("writing the report", 0.97)
        config = {
            "command": "close-loop",
            "robot": str(robot),
            "train": [str(path) for path in train],
            "test": [str(path) for path in test],
            "mapping": None if mapping is None else str(mapping),
            "bandwidth_hz": bandwidth,
            "seed": seed,
            "learn_residual": learn_residual,
            "ranges": ranges,
            "criteria": vars(analysis.selection.criteria),
            "tolerances": vars(analysis.train_predictor.tolerances),
        }
        with whole_folder(out_dir) as folder:
            text = json.dumps(analysis.verdict.as_mapping(), indent=1, ensure_ascii=False, allow_nan=False)
            (folder / "verdict.json").write_text(text + "\n", encoding="utf-8")
            (folder / "robot.yaml").write_text(dump_yaml(corrected), encoding="utf-8")
            write_report(folder, analysis)
            write_record(folder, config, [*train, *test])
    progress("done", 1.0)
    return analysis.verdict


def load_train_and_test(
    robot: RobotCfg,
    train: Sequence[str | Path],
    test: Sequence[str | Path],
    mapping: str | Path | None,
    bandwidth: float,
    progress: Progress,
) -> tuple[list[Flight], list[Flight]]:
    """Return training and test flights; no file may be both."""
    if not train or not test:
        raise DataError("needs at least one flight to train on (--train) and another one to test on (--test)")
    if not 0.5 <= bandwidth <= 100.0:
        raise ConfigError(f"bandwidth_hz = {bandwidth!r}: must lie in [0.5, 100] Hz")
    progress("reading flights", 0.0)
    layout = None if mapping is None else find_mapping(mapping)
    flights = load_flights([*train, *test], robot, mapping=layout, bandwidth=bandwidth, learning=len(train))
    return flights[: len(train)], flights[len(train) :]


def judge_flights(
    robot: RobotCfg,
    train: Sequence[Flight],
    test: Sequence[Flight],
    *,
    bandwidth: float = 10.0,
    seed: int = 0,
    criteria: Criteria | None = None,
    tolerances: Tolerances | None = None,
    learn_residual: bool = False,
    progress: Progress = silent,
) -> Analysis:
    """Return the analysis of flights in memory; arguments as for ``close_loop``."""
    check_effects(robot)
    if learn_residual:
        check_rotors(LearnedResidual, robot.rotor_traits)
    stated, robot = robot, with_battery(robot, train)
    tolerances = tolerances or Tolerances()
    flights = [*train, *test]
    band = comparison_band(flights, bandwidth)
    channels = find_channels(flights)
    train_predictor, test_predictor = (
        Predictor(robot, part, bandwidth=band, channels=channels, tolerances=tolerances) for part in (train, test)
    )
    declared = declared_params(robot)
    check_scene(tuple(robot.effects), flights)
    criteria = criteria or Criteria()
    selection = select_effects(
        train_predictor,
        declared,
        criteria,
        lambda stage, share: progress(stage, 0.05 + 0.58 * share),
        test=test,
    )
    progress("rollouts of the training flights", 0.63)
    refit = refit_on_rollouts(train_predictor, selection)
    if refit.adopted and refit.scored is not None:
        selection = replace(selection, final=refit.scored)
    final = rounded(robot, selection.final.fit.point, selection.accepted)
    progress("selections on flights drawn again", 0.65)
    included = inclusion(train_predictor, declared, selection, seed=seed)
    progress("rollouts of the declared and the corrected model", 0.7)
    floor = noise_floor(robot, test, final, channels, bandwidth=band)
    if floor is not None:
        floor = np.hypot(floor, declared_wind(robot).adds(test_predictor, final))
    before = evaluate(robot, test, test_predictor, declared, floor=floor, seed=seed)
    progress("rollouts of the corrected model", 0.85)
    after = evaluate(robot, test, test_predictor, final, floor=floor, seed=seed) if selection.accepted else before
    progress("what each effect is worth", 0.93)
    worth = ablations(
        robot, test, (train_predictor, test_predictor), (declared, final), (before, after), selection, seed=seed
    )
    weight = selection.weights.weight
    regimes = {
        name: where_it_acts(test_predictor, declared, final, name, weight, after.floor, seed=seed)
        for name in selection.accepted
    }
    named = named_effects(selection, included, worth, regimes)
    manoeuvre, fly_next = what_to_fly(train_predictor, declared, selection)
    unexplained = find_unexplained(train_predictor, test_predictor, selection, after, floor)
    floor, wind = unexplained.floor, unexplained.wind
    if wind.accepted and floor is not None:
        after = replace(after, floor=tuple(floor.tolist()))
    found = () if NAME in robot.effects or not wind.accepted else (wind.named(),)
    kind, reason, candidates = decide(selection, unexplained.channels, floor is not None)
    if found:
        kind, reason, candidates = wind.decision((kind, reason, candidates))
    if not judges_forces(flights) and any(channel.kind == "specific_force" for channel in channels):
        reason += (
            "; without velocity drag is not known, so that what remains of the specific force is not judged: log v or p"
        )
    learned: Learned | None = None
    if learn_residual:
        progress("learning what remains", 0.9)
        trained = train_residual(train_predictor, final, selection.left_out, seed=seed)
        learned = judge_on_test(trained, test_predictor, final, floor)
        if learned.effect is not None:
            final = replace(final, learned=learned.effect)
            after = evaluate(robot, test, test_predictor, final, floor=floor, seed=seed)
    verdict = Verdict(
        verdict=kind,
        reason=reason,
        effects=(*named, *found),
        candidates=candidates,
        not_testable=not_testable(selection) | ({NAME: wind.untestable} if wind.untestable else {}),
        manoeuvre=manoeuvre,
        fly_next=fly_next,
        inclusion=included,
        output_error=refit,
        structure=unexplained.structure,
        before=before,
        after=after,
        flights=by_flight(test_predictor, declared, final, before, after, seed=seed),
        unexplained=unexplained.channels,
        whiteness=dict(
            zip(
                (c.name for c in channels),
                whiteness(test_predictor.times, unexplained.left, channels, band),
                strict=True,
            )
        ),
        learned=learned,
        notes=(
            *wind.notes,
            *about_logs(train, test, band, bandwidth),
            *immaterial(named),
            *refit.contradictions,
            *tolerances.strained(unexplained.deviation),
            *surrogate_notes(selection),
        ),
    )
    return Analysis(
        robot=stated,
        corrected=corrected_robot(
            robot if "battery_sag" in selection.accepted else stated,
            with_random(final, wind),
            (*selection.accepted, *(effect.name for effect in found)),
            [flight.name for flight in train],
        ),
        train=tuple(train),
        test=tuple(test),
        channels=channels,
        bandwidth=band,
        selection=selection,
        declared=declared,
        final=final,
        train_predictor=train_predictor,
        test_predictor=test_predictor,
        verdict=verdict,
    )


def about_logs(train: Sequence[Flight], test: Sequence[Flight], band: float, asked: float) -> list[str]:
    """Return notes on the logs, and on what they are too slow or too few for."""
    flights = [*train, *test]
    notes = [f"{flight.name}: {note}" for flight in flights for note in flight.notes]
    if band < asked:
        slowest = min(flight.rate for flight in flights)
        notes.append(f"compared below {band:.3g} Hz: the slowest log has {slowest:.4g} rows per second")
    if len(train) < 3:
        notes.append(
            f"only {len(train)} training flights: intervals rest on blocks of time, not on the spread of flights"
        )
    return notes


def surrogate_notes(selection: Selection) -> list[str]:
    """Return a note on each effect that lost its name to a structure."""
    return [
        f"{name} is not named: it only stands in for a part of what remains, whose structure ({kind}) no effect has"
        for name, kind in selection.surrogates.items()
    ]


def what_to_fly(
    train: Predictor, declared: ModelParams, selection: Selection
) -> tuple[Advice | None, dict[str, Advice]]:
    """Return the manoeuvre that tells tied candidates apart, and those that show what the flights do not."""
    tied = {name: tied_rivals(name, selection) for name in selection.accepted}
    hidden = showable(selection, train.robot, train.flights)
    if not any(tied.values()) and not hidden:
        return None, {}
    catalogue = Catalogue(train, selection)
    return what_tells(catalogue, selection, tied), what_shows(catalogue, selection, declared, hidden)


def not_testable(selection: Selection) -> dict[str, str]:
    """Return what the flights cannot show: registered effects without excitation, and look-alikes without a model."""
    found = dict(selection.not_testable)
    for name in selection.accepted:
        for other in EFFECTS.get(name).confused_with:
            if other not in EFFECTS:
                found.setdefault(other, f"looks like {name}; there is no registered effect of this name to weigh it")
    return found


def rounded(robot: RobotCfg, point: ModelParams, effects: Sequence[str]) -> ModelParams:
    """Return the point with the parameters as the robot file will hold them."""
    values = np.array([float(f"{value:.{SIGNIFICANT_DIGITS}g}") for value in params_of(point, effects)])
    return with_params(robot, point, effects, values)


def corrected_robot(robot: RobotCfg, final: ModelParams, accepted: Sequence[str], flights: Sequence[str]) -> RobotCfg:
    """Return the declared robot with the accepted effects, and what was learned, in it."""
    if final.learned is not None:
        robot = replace(robot, learned_residual=final.learned.cfg)
    if not accepted:
        return robot
    effects = {
        name: {p.name: float(v) for p, v in zip(EFFECTS.get(name).parameters, params, strict=True)}
        for name, params in final.effects.items()
    }
    source = f"{', '.join(accepted)}: aerial-gym close-loop on the flights {', '.join(flights)}"
    if robot.effects_source:
        source = f"{source}; before: {robot.effects_source}"
    return replace(robot, effects=effects, effects_source=source)
