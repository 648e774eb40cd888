"""Closed-loop windows: each window of a flight is one environment, flown by a control law that follows the recorded setpoints.

Before a window the law runs along the measured flight for ``WARM_UP_S``, which settles its filters. The mean difference between
recorded and own commands in that time is added to its commands in the window: it stands for integrals that no log holds, such
as the trim of an off-centre mass. Letters: W windows (environments), R rotors, A entries of an action.
"""

from collections.abc import Callable, Collection, Iterator, Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
import torch
from scipy.spatial.transform import Rotation
from torch import Tensor

from aerial_gym.config.robot import RobotCfg
from aerial_gym.physics import INTEGRATORS, BodyState, advance_remembering, vehicle_from_config
from aerial_gym.physics.effects import CommandEffect, DelayEffect
from aerial_gym.physics.law_memory import LawMemory, fresh_law_memory, rotor_command_and_memory
from aerial_gym.sim2real.arrays import Array, Indices
from aerial_gym.sim2real.logs.flights import Flight
from aerial_gym.sim2real.logs.recording import row_arrays
from aerial_gym.sim2real.predict.model_params import expand_effects, params_from_robot
from aerial_gym.sim2real.predict.replay.rotors import acts_on_commands, has_commands, replace_by_arriving_commands
from aerial_gym.sim2real.predict.rollout import WindowBatch
from aerial_gym.sim2real.predict.tolerances import Tolerances, vehicle_for_replay

WARM_UP_S = 0.5  # Run of the law along the measured flight before a window [s]; PX4's slowest filter settles in 0.1 s


def flight_at_rate(flight: Flight, rate: float) -> Flight:
    """Return a flight with rows at another rate [Hz]: commands and flags held, all else interpolated, and no gyro bias.

    Firmwares control corrected rates, while some logs hold raw ones.
    """
    time = np.arange(int(flight.time[-1] * rate + 1e-6) + 1) / rate
    held = np.minimum((time * flight.rate + 1e-6).astype(int), flight.num_rows - 1)
    values = dict[str, Array]()
    for name, rows in row_arrays(flight).items():
        if name == "rotor_command" or rows.dtype.kind == "b":
            values[name] = rows[held]
            continue
        table = np.stack([np.interp(time, flight.time, column) for column in rows.reshape(len(rows), -1).T], axis=1)
        values[name] = table.reshape(time.size, *rows.shape[1:])
    values["ang_vel"] -= _gyro_bias(flight)
    values["attitude"] /= np.linalg.norm(values["attitude"], axis=1, keepdims=True)
    return replace(flight, rate=rate, **values)


def _gyro_bias(flight: Flight) -> Array:
    """Return the mean difference of gyro and turns of the attitude [rad/s], (3,); 0 without an independent attitude."""
    excluded = flight.rows_without_comparison(1)
    kept = np.ones(flight.num_rows - 1, dtype=bool) if excluded is None else ~excluded[1:]
    if flight.attitude_integrated or not kept.any():
        return np.zeros(3)
    turns = (Rotation.from_quat(flight.attitude[:-1]).inv() * Rotation.from_quat(flight.attitude[1:])).as_rotvec()
    means = 0.5 * (flight.ang_vel[1:] + flight.ang_vel[:-1])
    return (means - flight.rate * turns)[kept].mean(axis=0)


class StepOfWindows(NamedTuple):
    """Simulated and measured vehicle after a step, and the means since the start of the window."""

    step: int
    state: BodyState
    truth: BodyState
    effort: Tensor  # Mean of the rotor commands and their rms variation [rad/s], (W, 2)
    recorded_effort: Tensor  # Of the recorded commands, likewise


class ClosedLoopWindows(WindowBatch):
    """Windows of flights with rows at the control rate, flown by a law in one vehicle."""

    def __init__(self, robot: RobotCfg, flights: Sequence[Flight], flight: Indices, row: Indices) -> None:
        """Prepare windows from their flights and first rows, (W,); commands of the flights are as recorded."""
        params = params_from_robot(robot)
        off = vehicle_for_replay(vehicle_from_config(robot, num_envs=1, dtype=torch.float64), Tolerances(), None)
        arriving = replace_by_arriving_commands(off, flights, params) if has_commands(flights) else flights
        super().__init__(off.vehicle, expand_effects(params, row.size), arriving, flight, row)
        self._stride, self._substeps, self._recorded = 1, 1, flights
        on_commands = {name: numbers for name, numbers in params.effects.items() if acts_on_commands(name)}
        effects = expand_effects(replace(params, effects=on_commands, learned=None), row.size)
        self._curves = [(one, numbers) for one, numbers in effects if isinstance(one, CommandEffect)]
        self._late = sum(float(one.delay(numbers)[0]) for one, numbers in effects if isinstance(one, DelayEffect))

    def fly(
        self, law: Any, actions: Sequence[Array], at: Collection[int], *, scale: Callable[[Tensor], Tensor]
    ) -> Iterator[StepOfWindows]:
        """Yield the flown steps ``at``.

        ``actions``: of each flight in its rows, (T, A). ``scale``: from the law's commands to those of
        the log, (W, R).
        """
        self._actions = actions
        memory, trim, warm = None, 0.0, round(WARM_UP_S * self._rate)
        for step in range(-warm, 0):
            command, memory = self._command(law, self.state_of_flight(step), step, memory, scale)
            trim = trim + (self._rows_of_recording(step) - command) / warm
        state, effects, stepper = (
            self.state_of_flight(0),
            self._initial_effect_memory(1.0 / self._rate),
            INTEGRATORS["rk4"],
        )
        sums, sent = torch.zeros(2, 2, *state.rotor_speed.shape, dtype=torch.float64), list[Tensor]()
        for step in range(max(at)):
            command, memory = self._command(law, state, step, memory, scale)
            command = (command + trim).clamp_min(0.0)
            sent.append(self._effective_command(command, step))
            given = command if self._commanded else state.rotor_speed
            sums += torch.stack([torch.stack((one, one**2)) for one in (given, self._rows_of_recording(step))])
            there = self._rows_of_quantity("other_position", self._row + step)
            model = replace(self._model, other_position=there)
            led = self._command_on_arrival(sent, step)
            state, effects = advance_remembering(model, stepper, None, state, led, 1.0 / self._rate, 1, effects)
            if step + 1 in at:
                mean, square = (sums / (step + 1)).unbind(1)
                spread = (square - mean**2).clamp_min(0.0).mean(-1).sqrt()
                own, recorded = torch.stack((mean.mean(-1), spread), dim=-1)
                yield StepOfWindows(step + 1, state, self.state_of_flight(step + 1), own, recorded)

    def _command(
        self, law: Any, state: BodyState, step: int, memory: LawMemory | None, scale: Callable[[Tensor], Tensor]
    ) -> tuple[Tensor, LawMemory | None]:
        """Return the law's commands [rad/s], (W, R), by the scale of the log, and its new memory."""
        memory = memory or fresh_law_memory(law.needs, self._row.size, state.position)
        action = self._rows_of_quantity("action", self._row + step)
        command, memory = rotor_command_and_memory(law, state, action, memory)
        return scale(command), memory

    def _rows_of_recording(self, step: int) -> Tensor:
        """Return the recorded commands in a row [rad/s], (W, R); measured speeds without commands."""
        return self._rows_of_quantity("recorded" if self._commanded else "rotor_speed", self._row + step)

    def _effective_command(self, command: Tensor, step: int) -> Tensor:
        """Return the speeds that commands request at the measured voltage [rad/s], (W, R)."""
        for effect, params in self._curves:
            voltage = self._rows_of_quantity("battery", self._row + step)[:, 0]
            values = torch.cat((params, effect.memory_from_voltage(voltage)), dim=-1)
            command = effect.command(command, self._model.vehicle, values)
        return command

    def _command_on_arrival(self, sent: Sequence[Tensor], step: int) -> Tensor:
        """Return the commands that arrive in a step [rad/s], (W, R): recorded ones until the first own one arrives."""
        late = self._late * self._rate
        whole = int(late)
        if step < whole + (late > whole):
            return self._rows_of_quantity("rotor_command" if self._commanded else "rotor_speed", self._row + step)
        share = late - whole
        return sent[step - whole] * (1.0 - share) + (sent[step - whole - 1] * share if share else 0.0)

    def _table_of_flights(self, name: str) -> tuple[Tensor, Indices, Indices]:
        """Return actions, recorded commands and voltages with first and last row of each window's flight, as for others."""
        of_flight = {"action": lambda index: self._actions[index], "battery": self._voltage_of_flight}
        of_flight["recorded"] = lambda index: self._recorded[index].rotor_command
        if name not in of_flight:
            return super()._table_of_flights(name)
        flown = np.unique(self._flight)
        parts = [of_flight[name](int(index)) for index in flown]
        first = np.cumsum([0, *(len(part) for part in parts)])
        place = np.searchsorted(flown, self._flight)
        return torch.from_numpy(np.concatenate(parts)), first[place], first[place + 1] - 1

    def _voltage_of_flight(self, index: int) -> Array:
        voltage = self._recorded[index].battery
        return np.full((1, 1), np.nan) if voltage is None else voltage[:, None]
