"""Rollouts along a whole flight: consecutive windows, each restarted from the measured state.

Letters: K rows of the track, W windows, R rotors.
"""

from dataclasses import dataclass
from itertools import chain

import numpy as np
import torch

from aerial_gym.config.robot import RobotCfg
from aerial_gym.physics import vehicle_from_config
from aerial_gym.sim2real.arrays import Array, Flags, Indices
from aerial_gym.sim2real.logs.flights import Flight
from aerial_gym.sim2real.predict.model_params import ModelParams, expand_effects
from aerial_gym.sim2real.predict.replay.rotors import has_commands, replace_by_arriving_commands
from aerial_gym.sim2real.predict.rollout import (
    FIRST_WINDOW_S,
    QUANTITIES,
    WindowBatch,
    rows_per_step,
    state_errors,
)
from aerial_gym.sim2real.predict.tolerances import Tolerances, vehicle_for_replay


@dataclass(frozen=True, kw_only=True)
class RolloutTrack:
    """Predicted states of one vehicle in every ``rows_per_step``-th row of a flight; NaN where no rollout runs."""

    position: Array  # [m], world, (K, 3)
    attitude: Array  # Body to world, xyzw, (K, 4)
    rotor_speed: Array  # [rad/s], (K, R)
    errors: dict[str, Array]  # Distance from the measured state by name of ``QUANTITIES``, (K,)
    start: Indices  # Row of the track at which each row's window starts, -1 without one, (K,)


def find_consecutive_windows(excluded: Flags, length: int) -> Indices:
    """Return the window start of each row, -1 in excluded rows, (K,); windows have at most ``length`` rows without a gap."""
    row = np.arange(excluded.size)
    first = np.maximum.accumulate(np.where(excluded, row + 1, 0))
    return np.where(excluded, -1, first + (row - first) // length * length)


@torch.inference_mode()
def rollout_along_flight(robot: RobotCfg, params: ModelParams, flight: Flight, restart_s: float) -> RolloutTrack:
    """Return the rollouts of a model along a flight, restarted from the measured state every ``restart_s`` [s].

    A flight whose rotor data determine no torques prescribes its attitude. A load hangs at rest at the log's start.
    """
    step = rows_per_step(flight.rate)
    starts = find_consecutive_windows(
        _rows_without_rollout(flight, step), max(1, round(restart_s * flight.rate / step))
    )
    first, size = np.unique(starts[starts >= 0], return_counts=True)
    widths = {"position": 3, "attitude": 4, "rotor_speed": robot.num_rotors}
    states = {name: np.full((starts.size, width), np.nan) for name, width in widths.items()}
    known = {"position": flight.position is not None, "velocity": True, "attitude": flight.torques}
    errors = {name: np.full(starts.size, np.nan) for name in QUANTITIES if known[name]}
    if first.size:
        run = _window_batch(robot, params, flight, step * first)
        begin = run.state_of_flight(0)
        given = None if flight.torques else np.ones(first.size, dtype=bool)
        later = run.simulate_steps(begin, range(1, int(size.max())), given_attitude=given) if size.max() > 1 else ()
        for number, state, truth in chain(((0, begin, begin),), later):
            inside = number < size
            rows = first[inside] + number
            for name, values in states.items():
                values[rows] = getattr(state, name).numpy()[inside]
            far = state_errors(state, truth)
            for name, values in errors.items():
                values[rows] = far[name][inside]
    return RolloutTrack(**states, errors=errors, start=starts)


def _rows_without_rollout(flight: Flight, step: int) -> Flags:
    """Return the rows of the track on the ground, lost, or before all arriving commands are in the log, (K,)."""
    excluded = flight.rows_without_comparison(0)
    excluded = np.zeros(flight.num_rows, dtype=bool) if excluded is None else excluded.copy()
    excluded[: int(np.ceil(FIRST_WINDOW_S * flight.rate))] = True
    return np.logical_or.reduceat(excluded, np.arange(0, flight.num_rows, step))


def _window_batch(robot: RobotCfg, params: ModelParams, flight: Flight, row: Indices) -> WindowBatch:
    off = vehicle_for_replay(vehicle_from_config(robot, num_envs=1, dtype=torch.float64), Tolerances(), None)
    flights = replace_by_arriving_commands(off, [flight], params) if has_commands([flight]) else [flight]
    effects, flown = expand_effects(params, row.size), np.zeros(row.size, dtype=int)
    return WindowBatch(off.vehicle, effects, flights, flown, row, settled=off.joint_start)
