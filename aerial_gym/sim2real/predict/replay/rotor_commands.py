"""Commanded rotor speeds with dead time and the effect of the measured battery voltage.

The voltage is not filtered: the rotor lag leaves the share ``a / (2 - a)`` of its noise variance, ``a = 1 - exp(-dt /
tau)``; a low-pass would remove the sag under load. Letters: T rows, R rotors.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import torch
from torch import Tensor

from aerial_gym.errors import DataError
from aerial_gym.physics import EFFECTS, Model, build_model
from aerial_gym.physics.effects import CommandEffect, DelayEffect
from aerial_gym.physics.rotor_lag import stop_in_dead_band
from aerial_gym.sim2real.logs.flights import Flight
from aerial_gym.sim2real.predict.model_params import ModelParams
from aerial_gym.sim2real.predict.tolerances import VehicleDeviation


def target_speeds_with_delay(flight: Flight, model: Model, *, shift: float = 0.0) -> tuple[Tensor, Tensor, float]:
    """Return the target speeds at the start and in the rest of each row [rad/s], (T, R), and the first part's share.

    A command holds until the next row; ``shift`` interpolates it towards the next, as a share of a row. Before the first
    one arrives, its value is assumed. Raise ``DataError`` if the log lacks a quantity that an effect needs.
    """
    command = flight.rotor_command
    assert command is not None
    moved = torch.from_numpy(command + shift * np.diff(command, axis=0, append=command[-1:]))
    late = flight.rate * sum(float(effect.delay(params)) for effect, params in model.effects[DelayEffect])
    whole = int(late)
    place = torch.arange(flight.num_rows) - whole
    earlier, later = (_target_speed(flight, model, moved[(place - more).clamp_min(0)]) for more in (1, 0))
    return earlier, later, late - whole


def has_commands(flights: Sequence[Flight]) -> bool:
    """Return whether all flights have commands; otherwise the measured rotor speeds drive the rotors."""
    return all(flight.rotor_command is not None for flight in flights)


def replace_by_arriving_commands(off: VehicleDeviation, flights: Sequence[Flight], params: ModelParams) -> list[Flight]:
    """Return the flights with commands as they arrive at the rotors, so that windows include those in transit."""
    acting = [(EFFECTS.get(name), values) for name, values in params.effects.items() if acts_on_commands(name)]
    model = build_model(off.vehicle, [(effect, torch.tensor(values).reshape(1, -1)) for effect, values in acting])
    arriving = (target_speeds_with_delay(flight, model, shift=off.command_shift) for flight in flights)
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
        memory = effect.replay_memory(voltage)
        command = effect.command(command, model.vehicle, torch.cat((params.expand(len(memory), -1), memory), dim=-1))
    return command
