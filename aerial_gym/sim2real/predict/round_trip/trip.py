"""Round trip: recorded setpoints flown by the vehicle's own law in simulated vehicles, compared with the measured flights.

Letters: W windows, H horizons.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np
import torch

from aerial_gym.config.robot import RobotCfg
from aerial_gym.errors import DataError
from aerial_gym.physics import vehicle_from_config
from aerial_gym.sim2real.arrays import Array, Flags
from aerial_gym.sim2real.findings import Finding
from aerial_gym.sim2real.logs.flights import Flight, flight_names
from aerial_gym.sim2real.predict.rollout import (
    CLUSTER_S,
    FARTHEST,
    QUANTITIES,
    WINDOW_EVERY_S,
    RolloutWindows,
    state_errors,
)
from aerial_gym.sim2real.predict.round_trip.autopilot import LAWS, LEVELS, LogAutopilot, autopilot_of_flight
from aerial_gym.sim2real.predict.round_trip.closed_loop import WARM_UP_S, ClosedLoopWindows, flight_at_rate
from aerial_gym.sim2real.predict.rows.batches import expand_vehicle
from aerial_gym.sim2real.progress import Progress, silent
from aerial_gym.sim2real.statistics import Estimate, Rise, Rms, rise_with_interval, rms_with_interval

TRIP_HORIZONS_S = (0.5, 1.0, 2.0, 5.0)  # Times from the start of a window to each comparison [s]
TRIP_VEHICLES = ("declared", "corrected")  # Names of the vehicles that fly
MOST_TRIP_WINDOWS = 200  # Most windows of a level; with more, every n-th one is flown
UNITS_OF_TRIP = {**QUANTITIES, "body_rate": "rad/s", "mean_command": "-", "command_variation": "-"}
"""Compared quantities and their units. The last two are the effort since the start of a window: mean and rms variation of the
rotor commands, as shares of the recorded mean."""


@dataclass(frozen=True, kw_only=True)
class LevelOfTrip:
    """Errors of one level of setpoints in several vehicles; a missing quantity was not measured."""

    level: str  # A name of ``LEVELS``
    windows: RolloutWindows
    horizons: tuple[float, ...]  # [s]
    valid: Flags  # Whether setpoints and flight of each window reach each horizon, (W, H)
    errors: Mapping[str, Mapping[str, Array]]  # Simulated minus measured, by vehicle and quantity, (W, H)
    recorded: Mapping[str, Array]  # Recorded effort, (W, H)
    seed: int

    def rms(self, vehicle: str, quantity: str) -> dict[float, Rms]:
        """Return the error of a quantity by horizon [s], with its interval."""
        values, group, results = self.errors[vehicle][quantity], self.windows.cluster, dict[float, Rms]()
        for place, (horizon, own) in enumerate(zip(self.horizons, self.valid.T, strict=True)):
            (results[horizon],) = rms_with_interval(values[own, place, None], group[own], seed=self.seed)
        return results

    def rises(self, quantity: str) -> dict[float, Rise]:
        """Return the relative rise of the corrected vehicle's error over the declared one's by horizon [s]."""
        after, before = (self.errors[vehicle][quantity] for vehicle in ("corrected", "declared"))
        cluster, flight, results = self.windows.cluster, self.windows.flight, dict[float, Rise]()
        for place, (horizon, own) in enumerate(zip(self.horizons, self.valid.T, strict=True)):
            pair = after[own, place, None], before[own, place, None]
            (results[horizon],) = rise_with_interval(*pair, cluster[own], flight[own])
        return results

    def as_mapping(self) -> dict[str, object]:
        """Return the errors for JSON."""

        def entries(values: Mapping[float, Estimate]) -> dict[str, object]:
            return {f"{horizon:g}": value.as_mapping() for horizon, value in values.items()}

        quantities = {
            quantity: {
                "unit": UNITS_OF_TRIP[quantity],
                **{vehicle: entries(self.rms(vehicle, quantity)) for vehicle in self.errors},
                **({"change": entries(self.rises(quantity))} if "corrected" in self.errors else {}),
                **({"recorded": float(self.recorded[quantity][:, 0].mean())} if quantity in self.recorded else {}),
            }
            for quantity in self.errors["declared"]
        }
        counts = {f"{horizon:g}": int(own.sum()) for horizon, own in zip(self.horizons, self.valid.T, strict=True)}
        return {"windows": counts, "flights": len(np.unique(self.windows.flight)), **quantities}


@dataclass(frozen=True, kw_only=True)
class RoundTrip:
    """Comparison of simulated and measured flights under the recorded setpoints."""

    autopilot: LogAutopilot
    levels: tuple[LevelOfTrip, ...]
    findings: tuple[Finding, ...]

    def as_mapping(self) -> dict[str, object]:
        """Return the results for JSON."""
        laws = LAWS[self.autopilot.name]
        notes = [{"code": one.code, "subject": one.subject, "values": dict(one.values)} for one in self.findings]
        levels = {one.level: {"controller": laws[one.level], **one.as_mapping()} for one in self.levels}
        return {"levels": levels, "findings": notes}


def fly_round_trip(
    vehicles: Mapping[str, RobotCfg], flights: Sequence[Flight], *, controller: str | None = None, seed: int = 0,
    progress: Progress = silent,
) -> RoundTrip:  # fmt: skip
    """Return the round trip of flights in vehicles; the law is that of the vehicle ``declared`` in all of them.

    Args:
        vehicles: Robots by name: ``declared``, and ``corrected`` if there is one.
        flights: Flights of one firmware; parameters are those of the first.
        controller: Registered controller in place of that of the firmware.
        seed: Seed of the bootstrap.

    Raises:
        DataError: If no flight holds setpoints that the law follows.
        ConfigError: If the controller cannot follow recorded setpoints.
    """
    declared, autopilot = vehicles["declared"], autopilot_of_flight(flights[0], vehicles["declared"], controller)
    rows = [flight_at_rate(flight, 1.0 / autopilot.step) for flight in flights]
    results, laws = list[LevelOfTrip](), LAWS[autopilot.name]
    for place, level in enumerate(level for level in LEVELS if level in laws):
        progress(f"flying the recorded {level} setpoints", place / len(laws))
        if (flown := _fly_level(level, autopilot, declared, vehicles, rows, seed)) is not None:
            results.append(flown)
    if not results:
        names, known = flight_names(flights, ()), ", ".join(laws.values())
        raise DataError(f"{names}: no second in flight with all setpoints of {known}; log them, or give --controller")
    flown = {index for level in results for index in level.windows.flight.tolist()}
    lost = [flight for index, flight in enumerate(flights) if index not in flown]
    findings = [*autopilot.findings, *([Finding("setpoints_missing", flight_names(lost, ()))] if lost else [])]
    return RoundTrip(autopilot=autopilot, levels=tuple(results), findings=tuple(findings))


def _fly_level(
    level: str, autopilot: LogAutopilot, declared: RobotCfg, vehicles: Mapping[str, RobotCfg],
    flights: Sequence[Flight], seed: int,
) -> LevelOfTrip | None:  # fmt: skip
    """Return the errors of a level; None if no window has all its setpoints."""
    vehicle = vehicle_from_config(declared, num_envs=1, dtype=torch.float64)
    law = autopilot.law(level, declared, vehicle)
    asked = [autopilot.actions(level, flight, law, vehicle) for flight in flights]
    has = [np.zeros(f.num_rows, dtype=bool) if one is None else one[1] for f, one in zip(flights, asked, strict=True)]
    horizons, valid, windows = _find_trip_windows(flights, has)
    if not horizons:
        return None
    width = next(one[0].shape[1] for one in asked if one is not None)
    actions = [np.zeros((1, width)) if one is None else one[0] for one in asked]
    in_windows = expand_vehicle(vehicle, windows.row.size)
    law, curves = autopilot.law(level, declared, in_windows), None
    if all(flight.command_curve is not None for flight in flights):
        curves = torch.tensor([flights[index].command_curve for index in windows.flight], dtype=torch.float64)
    scale = partial(autopilot.scale_commands, vehicle=in_windows, curve=curves)
    errors, recorded = dict[str, dict[str, Array]](), dict[str, Array]()
    for name, robot in vehicles.items():
        batch = ClosedLoopWindows(robot, flights, windows.flight, windows.row)
        at = [batch.num_steps(horizon) for horizon in horizons]
        with torch.inference_mode():
            steps = list(batch.fly(law, actions, at, scale=scale))
        parts = [state_errors(one.state, one.truth) for one in steps]
        table = {quantity: np.stack([part[quantity] for part in parts], axis=1) for quantity in QUANTITIES}
        turns = [(one.state.ang_vel - one.truth.ang_vel).norm(dim=1) for one in steps]
        table["body_rate"] = _finite(torch.stack(turns, dim=1))
        own, flown = (torch.stack([getattr(s, key) for s in steps], dim=1) for key in ("effort", "recorded_effort"))
        for column, quantity in enumerate(("mean_command", "command_variation")):
            table[quantity] = _finite((own[..., column] - flown[..., column]) / flown[..., 0])
            recorded[quantity] = (flown[..., column] / flown[..., 0]).numpy()
        unknown = {"position": "position", "velocity": "lin_vel"}
        lacks = {key for key, logged in unknown.items() if any(getattr(f, logged) is None for f in flights)}
        errors[name] = {quantity: values for quantity, values in table.items() if quantity not in lacks}
    return LevelOfTrip(
        level=level, windows=windows, horizons=horizons, valid=valid, errors=errors, recorded=recorded, seed=seed
    )


def _finite(values: torch.Tensor) -> Array:
    """Return values of at most ``FARTHEST``, also those of a divergent simulation."""
    return values.nan_to_num(FARTHEST, FARTHEST, -FARTHEST).clamp(-FARTHEST, FARTHEST).numpy()


def _find_trip_windows(
    flights: Sequence[Flight], has: Sequence[Flags]
) -> tuple[tuple[float, ...], Flags, RolloutWindows]:
    """Return the horizons [s] that some window reaches, whether each window does, (W, H), and the windows.

    A window has setpoints from its warm-up to a horizon. No command is at a limit in the warm-up, where it would not show the
    integrals.
    """
    rate, parts, cluster = flights[0].rate, [], 0
    warm, lengths = round(WARM_UP_S * rate), [round(horizon * rate) for horizon in TRIP_HORIZONS_S]
    for index, (flight, known) in enumerate(zip(flights, has, strict=True)):
        excluded = flight.rows_without_comparison(0)
        lost = np.concatenate(([0], np.cumsum(~known if excluded is None else ~known | excluded)))
        limited = np.concatenate(([0], np.cumsum(_rows_at_limits(flight))))
        rows = np.arange(warm, flight.num_rows, round(WINDOW_EVERY_S * rate))
        rows = rows[limited[rows] == limited[rows - warm]]
        ends = rows[:, None] + lengths
        reached = (ends < flight.num_rows) & (lost[np.minimum(ends + 1, flight.num_rows)] == lost[rows - warm, None])
        groups = (rows / rate / CLUSTER_S).astype(int) + cluster
        table = np.column_stack((np.full(rows.size, index), rows, groups, reached))
        parts.append(table[reached[:, 0]])
        cluster += int(flight.time[-1] / CLUSTER_S) + 1
    table = np.concatenate(parts)
    table = table[:: max(1, -(-len(table) // MOST_TRIP_WINDOWS))]
    valid = table[:, 3:].astype(bool)
    some = valid.any(axis=0)
    horizons = tuple(horizon for horizon, any_window in zip(TRIP_HORIZONS_S, some, strict=True) if any_window)
    return horizons, valid[:, some], RolloutWindows(flight=table[:, 0], row=table[:, 1], cluster=table[:, 2])


def _rows_at_limits(flight: Flight) -> Flags:
    """Return the rows in which a recorded command is at its lowest or highest value, (T,)."""
    command, curve = flight.rotor_command, flight.command_curve
    if command is None:
        return np.zeros(flight.num_rows, dtype=bool)
    low, high = (0.0, np.inf) if curve is None else (curve[0], (curve[0] + curve[1]) * (1.0 - 1e-9))
    return ((command <= low) | (command >= high)).any(axis=1)
