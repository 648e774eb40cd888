"""Replay of flights with a declared model, without any fit: residuals, rollouts and a page with figures."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

from aerial_gym.config.robot import RobotCfg
from aerial_gym.errors import ConfigError, DataError
from aerial_gym.interop import one_thread
from aerial_gym.physics.model import check_effects
from aerial_gym.robots.catalog import robot_by_name
from aerial_gym.sim2real.findings import Finding
from aerial_gym.sim2real.json_values import write_json
from aerial_gym.sim2real.judge.evaluation import LEAST_GAP, ModelEvaluation, evaluate_models, reason_against_rollouts
from aerial_gym.sim2real.logs.conversion import PlotTable
from aerial_gym.sim2real.logs.flights import (
    Flight,
    check_bandwidth,
    file_digests,
    findings_on_rigid_joints,
    load_flights,
    merge_findings_of_flights,
)
from aerial_gym.sim2real.logs.readers.mapping import find_mapping
from aerial_gym.sim2real.predict.channels import comparison_band, find_channels
from aerial_gym.sim2real.predict.model_params import ModelParams, params_from_robot
from aerial_gym.sim2real.predict.noise_floor import noise_floor
from aerial_gym.sim2real.predict.predictor import Predictor
from aerial_gym.sim2real.predict.rollout import QUANTITIES
from aerial_gym.sim2real.predict.round_trip.trip import TRIP_VEHICLES, UNITS_OF_TRIP, RoundTrip, fly_round_trip
from aerial_gym.sim2real.predict.scene import check_scene
from aerial_gym.sim2real.predict.tolerances import Tolerances
from aerial_gym.sim2real.progress import Progress, silent
from aerial_gym.sim2real.report.run_folder import atomic_run_folder, check_out_dir, write_record
from aerial_gym.sim2real.wording import text


@dataclass(frozen=True)
class Replay:
    """A declared model with the errors of its predictions."""

    robot: RobotCfg
    flights: tuple[Flight, ...]
    predictor: Predictor
    params: ModelParams
    bandwidth: float
    evaluation: ModelEvaluation
    left_out: tuple[Finding, ...] = ()  # One finding for each unusable log
    round_trip: RoundTrip | None = None  # Recorded setpoints flown in the model, if asked for

    @property
    def answer(self) -> Finding:
        """Return the number of errors above their noise floor, and the error that exceeds it most."""
        floor, channels = self.evaluation.floor, self.evaluation.channels
        if floor is None:
            return Finding("floor_unknown")
        ratios = [rms.value / max(level, 1e-300) for rms, level in zip(self.evaluation.residual, floor, strict=True)]
        above, most = sum(ratio**2 >= LEAST_GAP for ratio in ratios), ratios.index(max(ratios))
        if not above:
            return Finding("errors_at_floor", "", {"channels": len(ratios)})
        values = {"above": above, "channels": len(ratios), "channel": channels[most].name, "ratio": ratios[most]}
        return Finding("errors_above_floor", "", values)

    @property
    def notes(self) -> list[Finding]:
        """Findings on logs left out, the vehicle, the logs and missing rollouts."""
        missing = reason_against_rollouts(self.flights)
        return [
            *(() if self.round_trip is None else self.round_trip.findings),
            *self.left_out,
            *findings_on_rigid_joints(self.robot),
            *merge_findings_of_flights(self.flights),
            *([] if missing is None else [missing]),
        ]

    def as_mapping(self) -> dict[str, object]:
        """Return the results for JSON."""
        return {
            "flights": [flight.path for flight in self.flights],
            "left_out": [text(note) for note in self.left_out],
            "bandwidth_hz": self.bandwidth,
            "answer": text(self.answer),
            "replay": self.evaluation.as_mapping(),
            **({} if self.round_trip is None else {"round_trip": self.round_trip.as_mapping()}),
            "notes": [text(note) for note in self.notes],
        }


def replay(
    robot: str | Path, flights: Sequence[str | Path], out_dir: str | Path | None = None, *,
    mapping: str | Path | None = None, bandwidth: float = 10.0, setpoints: bool = False,
    corrected: str | Path | None = None, controller: str | None = None, seed: int = 0, progress: Progress = silent,
) -> Replay:  # fmt: skip
    """Return the prediction errors of a declared robot on flights; unusable logs become findings.

    With ``out_dir``, write replay.json, report.html, residuals.csv and profiles.csv there.

    Args:
        robot: Registered robot, or a robot file.
        flights: Flight logs.
        out_dir: Output folder, written only if the run succeeds.
        mapping: Name or file of a log mapping; None for logs of this package's layout.
        bandwidth: Bandwidth of the comparison [Hz].
        setpoints: Whether to fly the recorded setpoints as well (``RoundTrip``).
        corrected: Corrected robot that flies the setpoints too, with the law of the declared one; None for none.
        controller: Registered controller for the setpoints; None for that of the log's firmware.
        seed: Seed of the bootstrap.
        progress: Called with each stage and the completed share.

    Raises:
        DataError: If no log is usable.
        ConfigError, UnknownNameError: If robot or mapping is invalid or unknown.
    """
    if not flights:
        raise DataError("needs at least one flight to replay")
    check_bandwidth(bandwidth)
    if not setpoints and (corrected, controller) != (None, None):
        raise ConfigError("corrected and controller: fly the recorded setpoints; give setpoints (--setpoints) as well")
    if out_dir is not None:
        check_out_dir(Path(out_dir))
    declared = robot_by_name(robot)
    check_effects(declared)
    progress("reading flights", 0.0)
    layout = None if mapping is None else find_mapping(mapping)
    with one_thread():
        digests = file_digests(flights)
        refused = list[DataError]()
        results = load_flights(flights, declared, mapping=layout, bandwidth=bandwidth, refused=refused)
        if not results:
            raise refused[0]
        progress("predicting every row, rolling out every window", 0.3)
        result = replay_flights(declared, results, bandwidth=bandwidth, seed=seed)
        left_out = tuple(Finding("flight_left_out", "", {"error": str(error)}) for error in refused)
        result = replace(result, left_out=left_out)
        if setpoints:
            vehicles = {"declared": declared} | ({} if corrected is None else {"corrected": robot_by_name(corrected)})
            part = partial(_show_trip_progress, progress)
            trip = fly_round_trip(vehicles, results, controller=controller, seed=seed, progress=part)
            result = replace(result, round_trip=trip)
        if out_dir is not None:
            progress("writing the report", 0.9)
            config = {"command": "replay", "robot": str(robot), "flights": [str(path) for path in flights]}
            config |= {"mapping": mapping and str(mapping), "bandwidth_hz": bandwidth, "seed": seed}
            config |= {"setpoints": setpoints, "corrected": corrected and str(corrected), "controller": controller}
            with atomic_run_folder(Path(out_dir)) as folder:
                _write_report(folder, result)
                write_record(folder, config, digests)
    progress("done", 1.0)
    return result


def _show_trip_progress(progress: Progress, stage: str, share: float) -> None:
    progress(stage, 0.4 + 0.5 * share)


def replay_flights(robot: RobotCfg, flights: Sequence[Flight], *, bandwidth: float, seed: int = 0) -> Replay:
    """Return the replay of flights in memory."""
    band = comparison_band(flights, bandwidth)
    channels = find_channels(flights)
    predictor = Predictor(robot, flights, bandwidth=band, channels=channels, tolerances=Tolerances())
    params = params_from_robot(robot)
    check_scene(tuple(robot.effects), flights)
    floor = noise_floor(robot, flights, params, channels, bandwidth=band)
    (evaluation,) = evaluate_models(robot, predictor, [params], floor=floor, seed=seed)
    return Replay(robot, tuple(flights), predictor, params, band, evaluation)


def residual_tables(result: Replay) -> dict[str, PlotTable]:
    """Return the residuals of each flight by its path, at the rows that are compared."""
    predictor, names = result.predictor, [channel.name.replace(".", "_") for channel in result.predictor.channels]
    units = dict(zip(names, (channel.unit for channel in predictor.channels), strict=True))
    residuals = predictor.residuals(result.params)
    return {
        flight.path: PlotTable(time=time, columns=dict(zip(names, rows.T, strict=True)), units=units)
        for flight, time, rows in zip(predictor.flights, predictor.times, residuals, strict=True)
    }


def replay_rollout_rows(result: Replay) -> list[dict[str, str]]:
    """Return one row per rollout error: variant, quantity with unit, horizon [s], rms with its interval."""
    from aerial_gym.sim2real.report.tables import interval_text

    return [
        {"variant": variant, "quantity": f"{name} [{QUANTITIES[name]}]", "horizon": f"{h:g}", "rms": interval_text(rms)}
        for variant, quantities in result.evaluation.rollout.items()
        for name, horizons in quantities.items()
        for h, rms in horizons.items()
    ]


def round_trip_rows(trip: RoundTrip | None) -> list[dict[str, str]]:
    """Return one row per level of setpoints, quantity and horizon: errors with intervals; empty without a round trip."""
    from aerial_gym.sim2real.report.tables import format_rise, interval_text

    rows = list[dict[str, str]]()
    for level in () if trip is None else trip.levels:
        for quantity in level.errors["declared"]:
            rms = {vehicle: level.rms(vehicle, quantity) for vehicle in level.errors}
            changes = level.rises(quantity) if "corrected" in rms else {}
            name = f"{quantity.replace('_', ' ')} [{UNITS_OF_TRIP[quantity]}]"
            for horizon in level.horizons:
                cells = {
                    vehicle: interval_text(rms[vehicle][horizon]) if vehicle in rms else "–"
                    for vehicle in TRIP_VEHICLES
                }
                change = format_rise(changes[horizon]) if horizon in changes else "–"
                rows.append(
                    {"level": level.level, "quantity": name, "horizon": f"{horizon:g}", **cells, "change": change}
                )
    return rows


def _write_report(folder: Path, result: Replay) -> None:
    from aerial_gym.sim2real.report import plots
    from aerial_gym.sim2real.report.figures import figures_of_errors
    from aerial_gym.sim2real.report.page import write_page
    from aerial_gym.sim2real.report.profiles import mean_residual_profiles, write_profiles
    from aerial_gym.sim2real.report.report import write_residuals
    from aerial_gym.sim2real.report.tables import SHOWN_NOTES, channel_rows

    write_json(folder / "replay.json", result.as_mapping())
    write_residuals(folder / "residuals.csv", {"replay": result.predictor}, {"declared": result.params})
    channels, results = result.predictor.channels, mean_residual_profiles(result.predictor, {"declared": result.params})
    write_profiles(folder / "profiles.csv", results, channels)
    figures = figures_of_errors(result.evaluation, None)
    for kind in dict.fromkeys(channel.kind for channel in channels):
        figures.append(plots.trace_figure(result.predictor, {"declared": result.params}, kind))
        figures.append(plots.profile_figure(results, channels, kind))
    context = {
        "robot": result.robot,
        "flights": [flight.name for flight in result.flights],
        "bandwidth": result.bandwidth,
        "channels": channel_rows(result.evaluation, None),
        "rollouts": replay_rollout_rows(result),
        "round_trip": round_trip_rows(result.round_trip),
        "figures": figures,
        "answer": text(result.answer),
        "notes": [text(note) for note in result.notes],
        "shown_notes": SHOWN_NOTES,
        "no_rollouts": reason_against_rollouts(result.flights),
    }
    write_page(folder / "report.html", "replay.html", context)
