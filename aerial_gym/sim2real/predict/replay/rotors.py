"""Replay along flights, for all flights at once: rotor speeds from logged commands, and the memory of effects.

The voltage is not filtered: the rotor lag leaves the share ``a / (2 - a)`` of its noise variance, ``a = 1 - exp(-dt / tau)``;
a low-pass would remove the sag under load.

Letters: F flights, T rows of a flight, N rows of all flights, R rotors, M memory values.
"""

from collections import OrderedDict
from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np
import torch
from torch import Tensor

from aerial_gym.errors import DataError
from aerial_gym.physics import EFFECTS, Model, build_model
from aerial_gym.physics.effect_cache import EffectCache
from aerial_gym.physics.effects import CommandEffect, DelayEffect, Effect, RotorSensorEffect
from aerial_gym.physics.effects.base import RotorSpeedsOfFlight
from aerial_gym.physics.effects.by_kind import EffectsByKind
from aerial_gym.physics.rotor_lag import stop_in_dead_band
from aerial_gym.physics.vehicle import Vehicle
from aerial_gym.sim2real.arrays import Array
from aerial_gym.sim2real.logs.flights import Flight
from aerial_gym.sim2real.predict.model_params import ModelParams
from aerial_gym.sim2real.predict.replay.rotor_lag import simulate_rotor_lag
from aerial_gym.sim2real.predict.rows.batches import vehicle_of_row
from aerial_gym.sim2real.predict.tolerances import VehicleForReplay


def target_speeds_with_delay(
    flight: Flight,
    model: Model,
    sensors: Sequence[tuple[RotorSensorEffect, Tensor]] = (),
    *,
    shift: float = 0.0,
    gain: float = 1.0,
) -> tuple[Tensor, Tensor, float]:
    """Return the target speeds at the start and in the rest of each row [rad/s], (T, R), and the first part's share.

    A command holds until the next row; ``shift`` interpolates it towards the next, as a share of a row. Before the first
    one arrives, its value is assumed. ``gain``: factor on the commands. ``sensors``: effects on the rotor sensors, whose
    error commands share if measured speeds scale them. Raise ``DataError`` if the log lacks a quantity that an effect needs.
    """
    assert flight.rotor_command is not None
    command = gain * flight.rotor_command
    if sensors and flight.has_commands_scaled_by_speeds:
        command = command * float(true_rotor_speed(torch.from_numpy(command), sensors).mean()) / command.mean()
    moved = torch.from_numpy(command + shift * np.diff(command, axis=0, append=command[-1:]))
    late = flight.rate * sum(float(effect.delay(params)) for effect, params in model.effects[DelayEffect])
    whole = int(late)
    place = torch.arange(flight.num_rows) - whole
    earlier, later = (_target_speed(flight, model, moved[(place - more).clamp_min(0)]) for more in (1, 0))
    return earlier, later, late - whole


def has_commands(flights: Sequence[Flight]) -> bool:
    """Return whether all flights have commands; otherwise the measured rotor speeds drive the rotors."""
    return all(flight.rotor_command is not None for flight in flights)


def replace_by_arriving_commands(off: VehicleForReplay, flights: Sequence[Flight], params: ModelParams) -> list[Flight]:
    """Return the flights with commands as they arrive at the rotors, so that windows include those in transit."""
    effects = [(EFFECTS.get(name), torch.tensor(values).reshape(1, -1)) for name, values in params.effects.items()]
    acting = [one for one in effects if acts_on_commands(one[0].name) or isinstance(one[0], RotorSensorEffect)]
    model = build_model(off.vehicle, acting)
    sensors = model.effects[RotorSensorEffect]
    arriving = (
        target_speeds_with_delay(flight, model, sensors, shift=off.command_shift, gain=off.command_gain)
        for flight in flights
    )
    means = [(share * earlier + (1.0 - share) * later).numpy() for earlier, later, share in arriving]
    return [replace(flight, rotor_command=mean) for flight, mean in zip(flights, means, strict=True)]


def acts_on_commands(name: str) -> bool:
    """Return whether an effect changes the target speeds of commands."""
    return isinstance(EFFECTS.get(name), CommandEffect | DelayEffect)


def _target_speed(flight: Flight, model: Model, command: Tensor) -> Tensor:
    """Return the target speeds of commands (T, R) at the voltage of their rows."""
    command = stop_in_dead_band(model.vehicle, command)
    for effect, params in model.effects[CommandEffect]:
        if "battery" in effect.logged and flight.battery is None:
            raise DataError(
                f"effect {effect.name}: {flight.name}: without battery voltage; log it in volts (column vbat), or leave the "
                "effect out of the robot file"
            )
        voltage = torch.full(command.shape[:1], torch.nan) if flight.battery is None else torch.tensor(flight.battery)
        memory = effect.memory_from_voltage(voltage)
        command = effect.command(command, model.vehicle, torch.cat((params.expand(len(memory), -1), memory), dim=-1))
    return command


REMEMBERED = 8  # Number of stored results; a fit repeats few different lags


class RotorReplay:
    """Open-loop simulation of lag, dead time and battery from the first measured speed and the commands."""

    def __init__(self, flights: Sequence[Flight]) -> None:
        self._flights = flights
        self._members = [index for index, flight in enumerate(flights) if flight.rotor_command is not None]
        rows = [flights[index].num_rows for index in self._members]
        self._ends = torch.from_numpy(np.cumsum([0, *rows], dtype=np.int32))
        self._step = torch.tensor([1.0 / flights[index].rate for index in self._members], dtype=torch.float64)
        self._results: OrderedDict[tuple[object, ...], list[Array | None]] = OrderedDict()

    def speeds(
        self, model: Model, shift: float, sensors: Sequence[tuple[RotorSensorEffect, Tensor]] = (), gain: float = 1.0
    ) -> list[Array | None]:
        """Return the speeds of each flight as a sensor reads them [rad/s], (T, R); None for a flight without commands.

        ``shift``: interpolation of each command towards the next, as a share of a row. ``sensors``: effects on the sensors
        with parameters (1, P). ``gain``: factor on the commands. Raise ``DataError`` if a log lacks a quantity that an
        effect needs.
        """
        vehicle, effects = model.vehicle, (*model.effects[DelayEffect], *model.effects[CommandEffect], *sensors)
        numbers = [vehicle.time_constant_up, vehicle.time_constant_down, vehicle.battery]
        numbers += [params for _, params in effects]
        alike = torch.cat(numbers, dim=1)[0].numpy().tobytes()  # bytes, as an undeclared battery is NaN
        key = (tuple(effect.name for effect, _ in effects), shift, gain, alike)
        if key not in self._results:
            self._results[key] = self._simulate_speeds(model, shift, sensors, gain)
            while len(self._results) > REMEMBERED:
                self._results.popitem(last=False)
        self._results.move_to_end(key)
        return self._results[key]

    def _simulate_speeds(
        self, model: Model, shift: float, sensors: Sequence[tuple[RotorSensorEffect, Tensor]], gain: float
    ) -> list[Array | None]:
        result: list[Array | None] = [None] * len(self._flights)
        if not self._members:
            return result
        flights = [self._flights[index] for index in self._members]
        arriving = [target_speeds_with_delay(flight, model, sensors, shift=shift, gain=gain) for flight in flights]
        earlier, later, shares = zip(*arriving, strict=True)
        vehicle, limited = model.vehicle, model.vehicle.traits & {"slew", "reversible"}
        table = simulate_rotor_lag(
            torch.stack([self._initial_speeds(index, sensors, gain) for index in self._members]),
            torch.cat(earlier),
            torch.cat(later),
            torch.tensor(shares, dtype=torch.float64),
            ends=self._ends,
            step=self._step,
            tau_up=vehicle.time_constant_up[0],
            tau_down=vehicle.time_constant_down[0],
            slew_rates=(vehicle.slew_rate[0], vehicle.slew_rate_down[0]) if limited else None,
        )
        for effect, params in sensors:
            table = effect.measure(table, params)
        for place, index in enumerate(self._members):
            result[index] = table[self._ends[place] : self._ends[place + 1]].numpy()
        return result

    def _initial_speeds(self, index: int, sensors: Sequence[tuple[RotorSensorEffect, Tensor]], gain: float) -> Tensor:
        """Return the true initial speeds, (R,): measured, corrected for sensor errors, else the first commands."""
        flight = self._flights[index]
        if flight.rotor_speed is None:
            assert flight.rotor_command is not None
            return torch.from_numpy(gain * flight.rotor_command[0])
        return true_rotor_speed(torch.from_numpy(flight.rotor_speed[:1].copy()), sensors)[0]


def true_rotor_speed(measured: Tensor, sensors: Sequence[tuple[RotorSensorEffect, Tensor]]) -> Tensor:
    """Return measured rotor speeds corrected for sensor errors with parameters (1, P) or of each row."""
    for effect, params in reversed(sensors):
        measured = effect.true_speed(measured, params)
    return measured


def effects_with_memory(effects: EffectsByKind) -> Iterator[tuple[Effect, Tensor]]:
    """Yield effects, with parameters, whose memory ``Effect.replay`` computes: not of commands, loads or random wind."""
    for effect, params in effects.step_effects:
        if effect.replayed and effect.remembers:
            yield effect, params


def make_flight_track(
    flight: Flight, vehicle: Vehicle, rotor_speed: Tensor, step: float, *, settled: float = 1.0
) -> RotorSpeedsOfFlight:
    """Return the track that drives memory along a flight; arguments as the fields of ``Track``."""
    stands = flight.on_ground is not None and bool(flight.on_ground[0])
    voltage = None if flight.battery is None else torch.from_numpy(flight.battery)
    given = {"vehicle": vehicle, "rotor_speed": rotor_speed, "step": step, "voltage": voltage}
    return RotorSpeedsOfFlight(**given, begins_on_ground=stands, settled=settled)


def replay_memory(
    model: Model,
    flights: Sequence[Flight],
    speeds: Sequence[Array | None] | None,
    answers: EffectCache[RotorSpeedsOfFlight],
    *,
    settled: float,
) -> dict[str, list[Tensor]]:
    """Return the memory of effects on rotors and body in every log row of each flight, (T, M), by effect.

    ``speeds``: rotor speeds from the commands [rad/s], (T, R), for flights without measured ones. ``answers``: stored
    results. ``settled``: initial angle of soft arms as a share of their rest angle, if a log begins in the air.
    """
    effects = list(effects_with_memory(model.effects))
    if not effects:
        return {}
    vehicle, tracks = vehicle_of_row(model.vehicle, 0), list[RotorSpeedsOfFlight]()
    sensors = [(effect, params[:1]) for effect, params in model.effects[RotorSensorEffect]]
    for flight, led in zip(flights, speeds or [None] * len(flights), strict=True):
        speed = led if flight.rotor_speed is None else flight.rotor_speed
        assert speed is not None
        true = true_rotor_speed(torch.from_numpy(speed), () if flight.rotor_speed is None else sensors)
        tracks.append(make_flight_track(flight, vehicle, true, 1.0 / flight.rate, settled=settled))
    return {
        effect.name: [answers.ask(effect.replay, track, params[:1], place=k) for k, track in enumerate(tracks)]
        for effect, params in effects
    }
