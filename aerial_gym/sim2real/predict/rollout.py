"""Open-loop rollouts: each window of a flight is one environment of the simulator, started at a measured state.

Commands drive the rotors through the model's dead time, battery and lag. Without commands the measured speeds are followed
with linear interpolation. A second variant prescribes the measured attitude, which isolates force errors.
Letters: W windows (environments), R rotors.
"""

from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
import torch
from scipy.ndimage import convolve1d
from torch import Tensor

from aerial_gym.config.robot import RobotCfg
from aerial_gym.errors import DataError
from aerial_gym.math.quaternion import quat_conjugate, quat_from_euler, quat_log, quat_multiply
from aerial_gym.physics import (
    EFFECTS,
    INTEGRATORS,
    BodyState,
    Vehicle,
    advance_remembering,
    build_model,
    vehicle_from_config,
)
from aerial_gym.physics.effects import AttitudeSensorEffect, CommandEffect, DelayEffect, LoadEffect, RotorSensorEffect
from aerial_gym.physics.memory import Memory, make_memory, replace_memory
from aerial_gym.physics.model import EffectParams
from aerial_gym.physics.rotor_lag import LinearRotorSpeeds
from aerial_gym.sim2real.arrays import Array, Flags, Indices
from aerial_gym.sim2real.logs.flights import Flight
from aerial_gym.sim2real.predict.model_params import ModelParams, expand_effects
from aerial_gym.sim2real.predict.replay.load import LoadLink, LoadReplay
from aerial_gym.sim2real.predict.replay.rotors import (
    RotorReplay,
    acts_on_commands,
    effects_with_memory,
    has_commands,
    make_flight_track,
    replace_by_arriving_commands,
    true_rotor_speed,
)
from aerial_gym.sim2real.predict.rows.batches import add_known_wind, expand_vehicle, vehicle_of_row
from aerial_gym.sim2real.predict.scene import other_vehicle_track, surface_heights
from aerial_gym.sim2real.predict.tolerances import Tolerances, vehicle_for_replay

STEP_S = 0.01  # Longest rollout step [s]; at 10 rad/s, Runge-Kutta of order 4 errs by 1e-7 rad per step
WINDOW_EVERY_S = 0.5  # Time between the starts of consecutive windows [s]

FIRST_WINDOW_S = max(e.longest for e in map(EFFECTS.get, EFFECTS) if isinstance(e, DelayEffect))
"""Start of the first window [s], the longest dead time, so that all arriving commands are in the log."""

MOST_WINDOWS = 600  # Most windows; with more the starts are spread over all flights
CLUSTER_S = 4.0  # Span [s] whose windows count as one sample in confidence intervals


@dataclass(frozen=True, kw_only=True)
class RolloutWindows:
    """Starts of rollouts."""

    flight: Indices  # Index of the flight, (W,)
    row: Indices  # Row of the log, (W,)
    cluster: Indices  # Cluster of each window, whose members overlap or follow each other, (W,)


def find_windows(flights: Sequence[Flight], horizon: float) -> RolloutWindows:
    """Return windows of ``horizon`` [s] without rows on the ground in every flight."""
    spans = [max(0.0, float(f.time[-1]) - horizon - STEP_S) for f in flights]
    every = max(WINDOW_EVERY_S, sum(spans) / MOST_WINDOWS)
    parts, cluster = [], 0
    for index, (flight, span) in enumerate(zip(flights, spans, strict=True)):
        starts = np.arange(FIRST_WINDOW_S, span, every)
        rows = np.round(starts * flight.rate).astype(int)
        excluded = flight.rows_without_comparison(0)
        if excluded is not None:
            stood = np.concatenate(([0], np.cumsum(excluded)))
            last = np.minimum(rows + round((horizon + STEP_S) * flight.rate) + 1, flight.num_rows)
            clear = stood[last] == stood[rows]
            starts, rows = starts[clear], rows[clear]
        groups = (starts / CLUSTER_S).astype(int)
        parts.append((np.full(rows.size, index), rows, groups + cluster))
        cluster += int(groups[-1]) + 1 if rows.size else 0
    flight_index, row, clusters = (np.concatenate(part) for part in zip(*parts, strict=True))
    return RolloutWindows(flight=flight_index, row=row, cluster=clusters)


def windows_of_longest_horizon(
    flights: Sequence[Flight], horizons: Sequence[float]
) -> tuple[tuple[float, ...], RolloutWindows]:
    """Return the feasible horizons [s] and the windows of the longest one; raise ``DataError`` if no flight is long enough."""
    for longest in sorted(horizons, reverse=True):
        windows = find_windows(flights, longest)
        if windows.row.size:
            return tuple(h for h in horizons if h <= longest), windows
    raise DataError(f"no flight is airborne for {FIRST_WINDOW_S + min(horizons):g} s at a time, which a rollout needs")


HORIZONS_S = (0.1, 0.5, 1.0, 2.0)  # Times after the start at which rollout and flight are compared [s]
MEMORY_STEP_S = 0.005  # Longest substep with effects that have memory [s]; its final memory value acts throughout

QUANTITIES: dict[str, str] = {"position": "m", "velocity": "m/s", "attitude": "rad"}
"""Compared quantities and their units."""


FARTHEST = 1e6  # Largest counted error [m], [m/s], also for a divergent rollout


@dataclass(frozen=True, kw_only=True)
class RolloutErrors:
    """Errors of rollouts at each horizon, at most ``FARTHEST``, one row per window."""

    windows: RolloutWindows
    horizons: tuple[float, ...]  # [s]
    position: Array | None  # [m], (W, horizons); None if the log has no position
    velocity: Array | None  # [m/s], (W, horizons)
    attitude: Array | None  # Rotation angle [rad], (W, horizons); None with prescribed attitude
    driven_by: str  # Input of the rotors: commands or measured rotor speeds


@torch.inference_mode()
def rollout_errors_of_models(
    robot: RobotCfg, flights: Sequence[Flight], models: Sequence[ModelParams], variants: Mapping[str, bool], *,
    links: Sequence[Sequence[LoadLink] | None], horizons: Sequence[float] = HORIZONS_S,
    tolerances: Tolerances | None = None,
) -> list[dict[str, RolloutErrors]]:  # fmt: skip
    """Return the rollout errors of models in several variants, simulated as one batch where possible.

    ``variants``: whether each prescribes the measured attitude and angular velocity. ``links``: state of each model's load
    along each flight; None: at rest at the log's start. ``horizons`` [s] longer than every flight are omitted.
    """
    if len(models) > 1 and not _can_share_batch(models, flights):
        results = list[dict[str, RolloutErrors]]()
        for one, own in zip(models, links, strict=True):
            results += rollout_errors_of_models(
                robot, flights, [one], variants, links=[own], horizons=horizons, tolerances=tolerances
            )
        return results
    kept, windows = windows_of_longest_horizon(flights, horizons)
    commanded = has_commands(flights)
    declared = vehicle_from_config(robot, num_envs=1, dtype=torch.float64)
    off = vehicle_for_replay(declared, tolerances or Tolerances(), models[0].deviation)
    flown = [replace_by_arriving_commands(off, flights, one) if commanded else flights for one in models]
    shape = (len(models), len(variants))
    errors = {name: np.full((*shape, windows.row.size, len(kept)), np.nan) for name in QUANTITIES}
    load = None if links[0] is None else initial_link_states(links[0], flights, windows)
    rate = np.array([flights[index].rate for index in windows.flight])
    for members in (np.flatnonzero(rate == one) for one in np.unique(rate)):
        model, variant, window = (np.ravel(i) for i in np.indices((*shape, members.size)))
        every = members[window]
        run = WindowBatch(
            off.vehicle,
            _effects_per_window(robot, models, model),
            [flight for of_model in flown for flight in of_model],
            windows.flight[every] + len(flights) * model,
            windows.row[every],
            load=None if load is None else load[every],
            settled=off.joint_start,
        )
        at = {run.num_steps(horizon): place for place, horizon in enumerate(kept)}
        given = np.array(list(variants.values()))[variant]
        for step, state, truth in run.simulate_steps(run.state_of_flight(0), at, given_attitude=given):
            for name, values in state_errors(state, truth).items():
                errors[name][:, :, members, at[step]] = values.reshape(*shape, -1)
    placed, moving = (all(getattr(f, name) is not None for f in flights) for name in ("position", "lin_vel"))
    driven_by = "commands" if commanded else "measured rotor speeds"
    return [
        {
            variant: RolloutErrors(
                windows=windows,
                horizons=kept,
                position=errors["position"][of_model, place] if placed else None,
                velocity=errors["velocity"][of_model, place] if moving else None,
                attitude=None if given_attitude else errors["attitude"][of_model, place],
                driven_by=driven_by,
            )
            for place, (variant, given_attitude) in enumerate(variants.items())
        }
        for of_model in range(len(models))
    ]


def _can_share_batch(models: Sequence[ModelParams], flights: Sequence[Flight]) -> bool:
    """Return whether models fit one batch: no deviations, networks, memory or loads; absent effects are neutral."""
    effects = [EFFECTS.get(name) for one in models for name in one.effects if not acts_on_commands(name)]
    return (
        all(one.deviation is None and one.learned is None for one in models)
        and all(flight.rotor_speed is not None for flight in flights)
        and not any(effect.remembers or effect.single for effect in effects)
    )


def _effects_per_window(robot: RobotCfg, models: Sequence[ModelParams], model: Indices) -> list[EffectParams]:
    """Return the models' effects with parameters per window, (W, P); neutral where its ``model`` (W,) has none."""
    if len(models) == 1:
        return expand_effects(models[0], model.size)
    results = list[EffectParams]()
    for name in dict.fromkeys(name for one in models for name in one.effects):
        effect = EFFECTS.get(name)
        params = np.array([one.effects.get(name, effect.neutral(robot)) for one in models])
        results.append((effect, torch.from_numpy(params[model])))
    return results


def initial_link_states(links: Sequence[LoadLink], flights: Sequence[Flight], windows: RolloutWindows) -> Array:
    """Return direction and rate of the link at the start of each window, (W, 6)."""
    load = np.empty((windows.row.size, 6))
    for index, (link, flight) in enumerate(zip(links, flights, strict=True)):
        own = windows.flight == index
        load[own] = link.interpolate_state(windows.row[own] / flight.rate)
    return load


def rows_per_step(rate: float) -> int:
    """Return the number of log rows in one rollout step for a log's rate [Hz]."""
    return max(1, int(STEP_S * rate + 1e-9))


class WindowBatch:
    """Batch of windows of flights with one rate."""

    def __init__(
        self, vehicle: Vehicle, effects: Sequence[EffectParams], flights: Sequence[Flight], flight: Indices,
        row: Indices, *, load: Array | None = None, settled: float = 1.0,
    ) -> None:  # fmt: skip
        """Prepare windows from a vehicle of one environment and effects with parameters (W, P).

        ``flights`` have commands as they arrive at the rotors; ``flight`` and ``row``: flight index and first row of each
        window, (W,). ``load``: initial link states, (W, 6); None: at rest at the log's start. ``settled``: initial angle of
        soft arms as a share of their rest angle, if a log begins in the air.
        """
        self._flights, self._flight, self._row, self._load, self._settled = flights, flight, row, load, settled
        self._tables: dict[str, tuple[Tensor, Indices, Indices]] = {}
        self._led_along: list[Array | None] | None = None  # rotor speeds from commands along all flights
        self._rate, self._commanded = flights[flight[0]].rate, has_commands(flights)
        self._stride = rows_per_step(self._rate)
        self._rotors = vehicle.num_rotors
        effects = [one for one in effects if self._commanded or one[0].acts_on != "actuation"]
        scene = surface_heights([flights[index] for index in flight], [1] * row.size)
        model = build_model(expand_vehicle(vehicle, row.size), effects, **scene)
        flown = replace(model, effects=model.effects.exclude(DelayEffect, CommandEffect))  # in the commands already
        self._model, self._sensors = add_known_wind(flown, flights, flight), flown.effects[RotorSensorEffect]
        longest = MEMORY_STEP_S if flown.effects.names_with_memory else STEP_S
        self._substeps = max(1, round(self._stride / (longest * self._rate)))

    def num_steps(self, seconds: float) -> int:
        """Return the number of steps in a time span [s]."""
        return round(seconds * self._rate / self._stride)

    def simulate_steps(
        self, state: BodyState, at: Collection[int], *, given_attitude: Flags | None = None
    ) -> Iterator[tuple[int, BodyState, BodyState]]:
        """Yield step number, simulated and measured state after the steps ``at``; (W,): windows with ``given_attitude``."""
        some = given_attitude is not None and given_attitude.any()
        given = torch.from_numpy(given_attitude)[:, None] if some else None
        span = self._stride / self._rate
        memory, stepper = self._initial_effect_memory(span / self._substeps), INTEGRATORS["rk4"]
        for step in range(max(at)):
            there = self._rows_of_quantity("other_position", self._row + step * self._stride + self._stride // 2)
            model, led = replace(self._model, other_position=there), self._rotor_input(step, state)
            state, memory = advance_remembering(
                model, stepper, None, state, led, span / self._substeps, self._substeps, memory
            )
            if given is not None or step + 1 in at:
                truth = self.state_of_flight(step + 1)
                if step + 1 in at:
                    yield step + 1, state, truth
                if given is not None:
                    attitude = torch.where(given, truth.attitude, state.attitude)
                    state = replace(state, attitude=attitude, ang_vel=torch.where(given, truth.ang_vel, state.ang_vel))

    def state_of_flight(self, step: int) -> BodyState:
        """Return the measured state ``step`` steps after each start."""
        rows = self._row + step * self._stride
        state = {name: self._rows_of_quantity(name, rows) for name in ("position", "attitude", "lin_vel", "ang_vel")}
        for effect, params in self._model.effects[AttitudeSensorEffect]:
            back = quat_conjugate(quat_from_euler(effect.turn(params)))
            state["attitude"] = quat_multiply(state["attitude"], back)
        return BodyState(**state, rotor_speed=self._rotor_speed_rows(rows))

    def _rotor_speed_rows(self, rows: Indices) -> Tensor:
        """Return the true rotor speeds at a row of each window's flight [rad/s], (W, R): measured, else from commands."""
        if any(self._flights[index].rotor_speed is not None for index in np.unique(self._flight)):
            return true_rotor_speed(self._rows_of_quantity("rotor_speed", rows), self._sensors)
        speed = torch.empty(rows.size, self._rotors, dtype=torch.float64)
        for index in np.unique(self._flight):
            chosen = np.flatnonzero(self._flight == index)
            along = self._rotor_speed_along_flight(int(index))
            speed[chosen] = along[np.minimum(rows[chosen], len(along) - 1)]
        return speed

    def _initial_effect_memory(self, dt: float) -> Memory | None:
        """Return the initial memory of effects; None if no effect has any."""
        if not self._model.effects.names_with_memory:
            return None
        memory = replace_memory(self._model, make_memory(self._model, dt), self._memory_from_replay())
        if not self._model.effects[LoadEffect]:
            return memory
        name = self._model.effects[LoadEffect][0][0].name
        if self._load is not None:
            return replace_memory(self._model, memory, {name: torch.from_numpy(self._load)})
        flown = np.unique(self._flight)
        times = [self._row[self._flight == index] / self._rate for index in flown]
        load = torch.empty(self._row.size, 6, dtype=torch.float64)
        order = torch.from_numpy(np.argsort(self._flight, kind="stable"))
        load[order] = LoadReplay([self._flights[index] for index in flown], times).link_states(self._model)
        return replace_memory(self._model, memory, {name: load})

    def _memory_from_replay(self) -> dict[str, Tensor]:
        """Return the initial memory of effects on rotors and body, (W, M), by effect, replayed from the log's start."""
        results: dict[str, Tensor] = {}
        for effect, params in effects_with_memory(self._model.effects):
            numbers = torch.empty(self._row.size, len(effect.fresh_memory(self._rotors)), dtype=torch.float64)
            vehicle, one, step = vehicle_of_row(self._model.vehicle, 0), params[:1], 1.0 / self._rate
            for index in np.unique(self._flight):
                chosen, speed = np.flatnonzero(self._flight == index), self._rotor_speed_along_flight(int(index))
                track = make_flight_track(self._flights[index], vehicle, speed, step, settled=self._settled)
                along = effect.replay(track, one)
                numbers[chosen] = along[self._row[chosen]]
            results[effect.name] = numbers
        return results

    def _rotor_speed_along_flight(self, index: int) -> Tensor:
        """Return the true rotor speeds along a flight [rad/s], (T, R): measured, else from commands."""
        speed = self._flights[index].rotor_speed
        if speed is None:
            if self._led_along is None:
                lagging = replace(self._model, vehicle=vehicle_of_row(self._model.vehicle, 0))
                self._led_along = RotorReplay(self._flights).speeds(lagging, 0.0)
            led = self._led_along[index]
            assert led is not None
            return torch.from_numpy(led)
        return true_rotor_speed(torch.from_numpy(speed), [(effect, params[:1]) for effect, params in self._sensors])

    def _rotor_input(self, step: int, state: BodyState) -> Tensor | LinearRotorSpeeds:
        """Return the rotor input of a step: the mean command, or a linear ramp to the measured speed at its end."""
        first = self._row + step * self._stride
        if self._commanded:
            return self._rows_of_quantity("rotor_command", first[:, None] + np.arange(self._stride)).mean(dim=1)
        end = true_rotor_speed(self._rows_of_quantity("rotor_speed", first + self._stride), self._sensors)
        return LinearRotorSpeeds(rate=(end - state.rotor_speed) * (self._rate / self._stride))

    def _rows_of_quantity(self, name: str, rows: Indices) -> Tensor:
        """Return a quantity at rows (W,) or (W, any) of each window's flight; beyond its end the last value."""
        if name not in self._tables:
            self._tables[name] = self._table_of_flights(name)
        table, first, last = self._tables[name]
        shape = (-1, *[1] * (rows.ndim - 1))
        return table[torch.from_numpy(np.minimum(first.reshape(shape) + rows, last.reshape(shape)))]

    def _table_of_flights(self, name: str) -> tuple[Tensor, Indices, Indices]:
        """Return a quantity along all flights, shared arrays once, and first and last row of each window's flight, (W,)."""
        spans, parts, length = dict[int, tuple[int, int]](), list[Array](), 0
        for index in np.unique(self._flight):
            key = id(getattr(self._flights[index], name))
            if key not in spans:
                parts.append(self._quantity_along_flight(name, self._flights[index]))
                spans[key] = length, length + len(parts[-1]) - 1
                length += len(parts[-1])
        ends = np.array([spans.get(id(getattr(flight, name)), (0, 0)) for flight in self._flights])[self._flight]
        return torch.from_numpy(np.concatenate(parts)), ends[:, 0], ends[:, 1]

    def _quantity_along_flight(self, name: str, flight: Flight) -> Array:
        """Return a quantity along a flight, (T, any), or one row of zeros."""
        if name == "other_position":
            return other_vehicle_track(flight)
        values = getattr(flight, name)
        if values is None:
            width = {"attitude": 4, "rotor_speed": self._rotors, "rotor_command": self._rotors}.get(name, 3)
            values = np.zeros((1, width))
        return mean_over_neighbour_rows(values, self._stride) if name == "rotor_speed" else values


def mean_over_neighbour_rows(values: Array, rows: int) -> Array:
    """Return the centred moving mean over ``rows`` rows, (T, any); for an even number the end weights are halved."""
    weights = np.ones(rows + 1 - rows % 2)
    weights[[0, -1]] = 1.0 if rows % 2 else 0.5
    return convolve1d(values, weights / rows, axis=0, mode="nearest")


def state_errors(state: BodyState, truth: BodyState) -> dict[str, Array]:
    """Return the distances of simulated from measured states by quantity, (W,)."""
    turn = quat_log(quat_multiply(quat_conjugate(truth.attitude), state.attitude))
    far = {"position": state.position - truth.position, "velocity": state.lin_vel - truth.lin_vel, "attitude": turn}
    most = {"position": FARTHEST, "velocity": FARTHEST, "attitude": np.pi}
    return {name: np.fmin(results.norm(dim=1).numpy(), most[name]) for name, results in far.items()}  # NaN is the most
