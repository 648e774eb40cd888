"""Flights of logs in groups that one predictor can compare, with every choice made by the flight alone.

Read one by one, a log decides its own clock offset, command scale and repairs. Band, channels and tolerances are those of
each flight, and only flights that agree in them, and in the quantities that they hold, form a group.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from aerial_gym.config.robot import RobotCfg
from aerial_gym.errors import DataError
from aerial_gym.sim2real.findings import Finding
from aerial_gym.sim2real.logs.flights import Flight, load_flights
from aerial_gym.sim2real.logs.readers.mapping import LogMapping
from aerial_gym.sim2real.logs.recording import row_arrays, take_rows
from aerial_gym.sim2real.predict.channels import Channel, comparison_band, find_channels
from aerial_gym.sim2real.predict.predictor import Predictor
from aerial_gym.sim2real.predict.replay.load import num_initial_steps
from aerial_gym.sim2real.predict.rows.batches import group_flights
from aerial_gym.sim2real.predict.rows.dataset import row_stride
from aerial_gym.sim2real.predict.scene import check_scene
from aerial_gym.sim2real.predict.tolerances import (
    Tolerances,
    tolerances_after_gains,
    tolerances_after_move,
    tolerances_after_scaling,
)

LONGEST_PART_S = 300.0  # Longest part of a flight that is compared at once [s], so that memory stays bounded


@dataclass(frozen=True, kw_only=True)
class LogContent:
    """Usable flights of one log, and findings on the others."""

    flights: tuple[Flight, ...]
    left_out: tuple[Finding, ...]


@dataclass(frozen=True, kw_only=True)
class ComparisonSettings:
    """What flights must share to be compared by one predictor; each value depends on one flight alone."""

    bandwidth: float
    channels: tuple[Channel, ...]
    tolerances: Tolerances
    quantities: tuple[object, ...]  # What the flight holds: batched formulas skip what no flight of a batch has


def read_log(path: str | Path, robot: RobotCfg, mapping: LogMapping | None, bandwidth: float) -> LogContent:
    """Return the flights of a log; raise ``DataError`` with the first reason if none is usable."""
    refused = list[DataError]()
    flights = load_flights([path], robot, mapping=mapping, bandwidth=bandwidth, refused=refused)
    for flight in flights:
        check_scene(tuple(robot.effects), [flight])
    if not flights:
        raise refused[0]
    left_out = tuple(Finding("flight_left_out", "", {"error": str(error)}) for error in refused)
    return LogContent(flights=tuple(flights), left_out=left_out)


def flight_parts(flight: Flight) -> list[Flight]:
    """Return a flight in equal parts of at most ``LONGEST_PART_S``."""
    count = int(np.ceil((flight.time[-1] - flight.time[0]) / LONGEST_PART_S))
    if count < 2:
        return [flight]
    splits = np.array_split(np.arange(flight.num_rows), count)
    parts = [take_rows(flight, slice(int(rows[0]), int(rows[-1]) + 1)) for rows in splits]
    return [replace(part, time=part.time - part.time[0]) for part in parts]


def comparison_settings(flight: Flight, bandwidth: float, tolerances: Tolerances) -> ComparisonSettings:
    """Return the settings of a flight; raise ``DataError`` if nothing can be compared."""
    band = comparison_band([flight], bandwidth)
    own = replace(tolerances, acc_bias=float(np.hypot(tolerances.acc_bias, tolerances.acc_of_flight)))
    own = tolerances_after_gains(tolerances_after_move(own, flight.notes), [flight.notes])
    held = (
        *(name for name in sorted(row_arrays(flight)) if name not in ("lost", "on_ground")),
        *(flight.ceiling_height is None, flight.wind is None, flight.accelerometer, flight.gyro, flight.torques),
        *(flight.attitude_integrated, flight.num_rotors, num_initial_steps(flight)),
    )
    return ComparisonSettings(
        bandwidth=band,
        channels=find_channels([flight], band),
        tolerances=tolerances_after_scaling(own, [flight]),
        quantities=held,
    )


def predictors_of_group(
    robot: RobotCfg, flights: Sequence[Flight], settings: ComparisonSettings
) -> Iterator[Predictor]:
    """Yield predictors of consecutive flights with the same settings, each small enough for the processor's cache."""
    rows = [flight.num_rows // row_stride(flight, settings.bandwidth) for flight in flights]
    shared = {"bandwidth": settings.bandwidth, "channels": settings.channels, "tolerances": settings.tolerances}
    return (Predictor(robot, flights[part], **shared) for part in group_flights(rows))
