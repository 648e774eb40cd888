"""A recorded flight for the page: measured states, rollouts of the declared and the corrected vehicle, residuals, events.

The bits are the same each time if torch runs on one thread. World is z up, body is x forward, y left, z up.
Letters: T rows of the log, K rows of the page.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from aerial_gym.config.robot import RobotCfg
from aerial_gym.errors import ConfigError, DataError
from aerial_gym.physics.model import check_effects
from aerial_gym.robots.catalog import robot_by_name
from aerial_gym.sim2real.arrays import Array, Flags
from aerial_gym.sim2real.failures.flight_event import FailureFinder
from aerial_gym.sim2real.judge.evaluation import reason_against_rollouts
from aerial_gym.sim2real.logs.flights import Flight, load_flights
from aerial_gym.sim2real.logs.readers.flight_log import open_log
from aerial_gym.sim2real.logs.readers.mapping import find_mapping
from aerial_gym.sim2real.logs.recording import FlightLog, sample_rate
from aerial_gym.sim2real.logs.signals import continuous_quaternion, without_bad_quaternions
from aerial_gym.sim2real.predict.channels import comparison_band, find_channels
from aerial_gym.sim2real.predict.model_params import params_from_robot
from aerial_gym.sim2real.predict.predictor import Predictor
from aerial_gym.sim2real.predict.rollout import QUANTITIES, rows_per_step
from aerial_gym.sim2real.predict.rollout_track import RolloutTrack, rollout_along_flight
from aerial_gym.sim2real.predict.scene import check_scene
from aerial_gym.sim2real.predict.tolerances import Tolerances
from aerial_gym.sim2real.report.log_plot import AXES, SHOWN
from aerial_gym.sim2real.wording import text

MOST_GAPS = 100  # Most gaps of a log that count as events
BANDWIDTH_HZ = 10.0  # Bandwidth of the residuals [Hz], as in ``aerial-gym replay``


@dataclass(frozen=True, kw_only=True)
class PlotPanel:
    """Lines of one plot over time."""

    title: str  # With the unit
    time: Array  # [s]
    lines: Mapping[str, Array]  # By vehicle: measured, declared or corrected


@dataclass(frozen=True, kw_only=True)
class FlightRecord:
    """A measured flight in every ``rows_per_step``-th row of its log, and what two vehicles predict."""

    log: FlightLog | Flight
    robots: Mapping[str, RobotCfg]  # By vehicle: declared and corrected; empty without a robot file
    time: Array  # [s] from the first row, (K,)
    position: Array  # [m], world, (K, 3); 0 if the log has none
    attitude: Array  # (K, 4)
    rotor_state: Array | None  # Measured rotor speeds, else commands, (K, R)
    residuals: Mapping[str, tuple[PlotPanel, ...]] = field(default_factory=dict)  # By quantity
    tracks: Mapping[str, RolloutTrack] = field(default_factory=dict)  # By vehicle
    events: tuple[tuple[float, str], ...] = ()  # Time [s] and description
    notes: tuple[str, ...] = ()

    @property
    def has_position(self) -> bool:
        """Whether the log has a position; without one all vehicles turn in place."""
        return self.log.position is not None

    def row_of_time(self, time: float) -> int:
        """Return the last row of the page up to a time [s]."""
        return int(np.searchsorted(self.time, time + 1e-9, side="right").clip(1, self.time.size)) - 1

    def plots(self) -> dict[str, tuple[PlotPanel, ...]]:
        """Return the plots by quantity: residuals, rollout errors, then measured quantities."""
        errors = {
            name: {vehicle: one.errors[name] for vehicle, one in self.tracks.items() if name in one.errors}
            for name in QUANTITIES
        }
        panels = [
            PlotPanel(title=f"{name} error [{QUANTITIES[name]}]", time=self.time, lines=lines)
            for name, lines in errors.items()
            if lines
        ]
        rollouts = {"rollout error": tuple(panels)} if panels else {}
        return {**self.residuals, **rollouts, **dict(self._plots_of_log())}

    def _plots_of_log(self) -> Iterator[tuple[str, tuple[PlotPanel, ...]]]:
        step = rows_per_step(sample_rate(self.log))
        for name, title in SHOWN.items():
            if (values := getattr(self.log, name)) is not None:
                columns, (words, *unit) = values.reshape(len(values), -1).T, title.replace(", xyzw", "").split(" [")
                axes = range(1, len(columns) + 1) if name.startswith("rotor") else AXES if len(columns) > 1 else ("",)
                yield (
                    f"measured {words}",
                    tuple(
                        PlotPanel(
                            title=" [".join((f"{words} {axis}", *unit)),
                            time=self.time,
                            lines={"measured": column[::step]},
                        )
                        for axis, column in zip(axes, columns, strict=False)
                    ),
                )


def load_vehicles(robot: str | None, corrected: str | Path | None) -> dict[str, RobotCfg]:
    """Return the declared and the corrected robot; the latter is a name, a robot file or a ``close-loop`` folder."""
    if robot is None:
        if corrected is not None:
            raise ConfigError(f"--corrected {corrected}: is compared with the declared robot; give --robot as well")
        return {}
    vehicles = {"declared": robot_by_name(robot)}
    if corrected is not None:
        inside = Path(corrected) / "robot.yaml"
        vehicles["corrected"] = robot_by_name(inside if Path(corrected).is_dir() else corrected)
        rotors = [one.num_rotors for one in vehicles.values()]
        if len(set(rotors)) > 1:
            raise ConfigError(f"--corrected {corrected}: has {rotors[1]} rotors and the declared robot {rotors[0]}")
    for one in vehicles.values():
        check_effects(one)
    return vehicles


def load_logs(
    paths: Sequence[str | Path], robots: Mapping[str, RobotCfg], mapping: str | Path | None = None
) -> tuple[list[FlightLog | Flight], list[str]]:
    """Return the flights of logs, and reasons against those that the declared robot cannot be compared with.

    If that is all of them, the flights are returned as they were measured. Raise ``DataError`` if a log is unreadable
    or has no attitude.
    """
    layout, refused = None if mapping is None else find_mapping(mapping), list[DataError]()
    if robots:
        flights = load_flights(paths, robots["declared"], mapping=layout, bandwidth=BANDWIDTH_HZ, refused=refused)
        if flights:
            return [*flights], [f"Left out: {error}" for error in refused]
    logs = [log for path in paths for log in open_log(path, layout, partial=True).flights()]
    return [without_bad_quaternions(log) for log in logs], [f"No predictions: {error}" for error in refused]


def record_flight(log: FlightLog | Flight, robots: Mapping[str, RobotCfg], notes: Sequence[str] = ()) -> FlightRecord:
    """Return a flight with its residuals and events, without rollouts yet."""
    step = rows_per_step(sample_rate(log))
    attitude = log.attitude[::step]
    zeros = np.zeros((len(attitude), 3))
    states = log.rotor_states
    record = FlightRecord(
        log=log,
        robots=robots if isinstance(log, Flight) else {},
        time=log.time[::step] - log.time[0],
        position=zeros if log.position is None else log.position[::step],
        attitude=attitude if isinstance(log, Flight) else continuous_quaternion(attitude),
        rotor_state=None if states is None else states[::step],
        notes=(*notes, *map(text, log.notes)),
    )
    if not isinstance(log, Flight) or not robots:
        return record
    events = tuple(sorted(_find_events(log, robots["declared"])))
    try:
        return replace(record, residuals=_residual_plots(log, robots), events=events)
    except DataError as error:
        return replace(record, robots={}, events=events, notes=(f"No predictions: {error}", *record.notes))


def with_rollouts(record: FlightRecord, restart_s: float) -> FlightRecord:
    """Return the flight with rollouts of all vehicles, restarted from the measured state every ``restart_s`` [s]."""
    flight = record.log
    if not record.robots or not isinstance(flight, Flight) or reason_against_rollouts([flight]) is not None:
        return record
    tracks = {
        vehicle: rollout_along_flight(robot, params_from_robot(robot), flight, restart_s)
        for vehicle, robot in record.robots.items()
    }
    return replace(record, tracks=tracks)


def _residual_plots(flight: Flight, robots: Mapping[str, RobotCfg]) -> dict[str, tuple[PlotPanel, ...]]:
    """Return the residuals of all vehicles by kind of channel."""
    band, channels = comparison_band([flight], BANDWIDTH_HZ), find_channels([flight])
    residuals, time = dict[str, Array](), np.empty(0)
    for vehicle, robot in robots.items():
        check_scene(tuple(robot.effects), [flight])
        predictor = Predictor(robot, [flight], bandwidth=band, channels=channels, tolerances=Tolerances())
        (residuals[vehicle],), (time,) = predictor.residuals(params_from_robot(robot)), predictor.times
    plots = dict[str, tuple[PlotPanel, ...]]()
    for column, channel in enumerate(channels):
        words = channel.kind.replace("_", " ")
        lines = {vehicle: values[:, column] for vehicle, values in residuals.items()}
        panel = PlotPanel(title=f"{words} {channel.axis} [{channel.unit}]", time=time, lines=lines)
        plots[f"residual of {words}"] = (*plots.get(f"residual of {words}", ()), panel)
    return plots


def _find_events(flight: Flight, robot: RobotCfg) -> Iterator[tuple[float, str]]:
    """Yield ground contacts, the ends of these, the longest gaps of the log and the first failure."""
    for start, end in _spans(flight.on_ground):
        yield float(flight.time[start]), "on the ground"
        if end < flight.num_rows:
            yield float(flight.time[end]), "in the air"
    for start, end in sorted(_spans(flight.lost), key=lambda span: span[0] - span[1])[:MOST_GAPS]:
        yield float(flight.time[start]), f"gap of {(end - start) / flight.rate:.2g} s in the log"
    if (failure := FailureFinder(robot).find_first_failure(flight)) is not None:
        yield failure.time, text(failure.finding)


def _spans(rows: Flags | None) -> Iterator[tuple[int, int]]:
    """Yield the first row of each span of set flags, and the row after it."""
    edges = np.flatnonzero(np.diff(np.concatenate(([0], [] if rows is None else rows, [0]))))
    yield from zip(edges[::2].tolist(), edges[1::2].tolist(), strict=True)
