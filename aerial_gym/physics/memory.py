"""Memory of effects: kept between substeps, updated at the start of each.

Letters: E environments, R rotors, P parameters and M remembered numbers of an effect, S remembered commands.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from math import ceil

import torch
from torch import Tensor

from aerial_gym.math.random import Purpose, Randomness, state_of_count
from aerial_gym.physics.effects import CommandEffect, DelayEffect, LoadEffect, SubstepStart
from aerial_gym.physics.model import Model
from aerial_gym.physics.rotor_lag import CommandSwitch, LinearRotorSpeeds, RotorCommand


@dataclass(frozen=True, kw_only=True)
class Memory:
    """Memory of all effects of a model."""

    initial: Tensor  # Numbers right after a reset, (sum of M,)
    numbers: Tensor  # Memory of the effects in the order of `EffectsByKind.step_effects`, (E, sum of M)
    past: Tensor  # Commands of the control law [rad/s], newest first, (E, S, R); S is 0 without a delay
    since: Tensor  # Substeps since the reset, int32, (E,)
    random: Randomness  # Of the draws, which depend on `since` as well

    def tensors(self) -> dict[str, Tensor]:
        """Return the tensors that change from substep to substep, by name."""
        return {"numbers": self.numbers, "past": self.past, "since": self.since}


def num_past_commands(model: Model, dt: float) -> int:
    """Return the number S of remembered commands for substeps of ``dt`` [s]."""
    return ceil(model.longest_delay / dt - 1e-9) + 2 if model.effects[DelayEffect] else 0


def make_memory(model: Model, dt: float, *, random: Randomness | None = None) -> Memory:
    """Return the memory right after a reset; ``random`` is that of the batch, of seed 0 if not given."""
    mass, vehicle = model.vehicle.mass, model.vehicle
    fresh = [number for effect, _ in model.effects.step_effects for number in effect.fresh_memory(vehicle.num_rotors)]
    initial = mass.new_tensor(fresh)
    return Memory(
        initial=initial,
        numbers=initial.expand(vehicle.num_envs, -1).clone(),
        past=mass.new_zeros(vehicle.num_envs, num_past_commands(model, dt), vehicle.num_rotors),
        since=torch.zeros(vehicle.num_envs, dtype=torch.int32, device=mass.device),
        random=random or Randomness(vehicle.num_envs, device=mass.device),
    )


def reset_effect_memory(memory: Memory, mask: Tensor) -> Memory:
    """Return the memory with the environments in ``mask``, bool (E,), reset; others stay bit for bit.

    Older commands are not cleared, because ``since`` excludes them.
    """
    numbers = torch.where(mask.unsqueeze(-1), memory.initial, memory.numbers)
    return replace(memory, numbers=numbers, since=memory.since.masked_fill(mask, 0))


def begin_substep(
    model: Model, memory: Memory, rotor_speed: Tensor, command: Tensor | LinearRotorSpeeds, dt: float
) -> tuple[Model, RotorCommand, Memory]:
    """Return the model with its memory, the commands that the rotors follow, and the memory of a substep.

    Args:
        memory: Memory after the previous substep.
        rotor_speed: Rotor speeds [rad/s], (E, R).
        command: Commanded rotor speeds in this substep [rad/s], (E, R); or a ramp of known speeds, on which no effect on
            commands acts.
    """
    own, all_vehicles = memory.random, memory.random.shared
    random = state_of_count(own.stream(Purpose.EFFECTS), memory.since)
    shared = None
    if all_vehicles is not own:
        shared = state_of_count(all_vehicles.stream(Purpose.EFFECTS), memory.since)
    span = torch.tensor(dt, dtype=torch.float64)  # on the CPU: an argument of any device's operations
    moment = SubstepStart(
        rotor_speed=rotor_speed, since=memory.since, random=random, dt=span, vehicle=model.vehicle, shared=shared
    )
    places = model.effects.places(rotor_speed.shape[1])
    numbers = [
        place.effect.remember(
            moment.of_effect(place.effect), torch.cat((params, memory.numbers[:, place.memory]), dim=-1)
        )
        for place, (_, params) in zip(places, model.effects.step_effects, strict=True)
    ]
    model = replace(model, effects=model.effects.with_memory(numbers))
    memory = replace(memory, numbers=torch.cat(numbers, dim=-1))
    if isinstance(command, LinearRotorSpeeds):
        return model, command, memory
    if not model.effects[DelayEffect]:
        return model, _effective_command(model, command), memory
    memory = replace(memory, past=torch.cat((command.unsqueeze(1), memory.past[:, :-1]), dim=1))
    return model, _delay_command(model, memory, rotor_speed, dt), memory


def _effective_command(model: Model, command: Tensor) -> Tensor:
    """Return the rotor speeds (E, R) that commands lead to."""
    for effect, values in model.effects[CommandEffect]:
        command = effect.command(command, model.vehicle, values)
    return command


def _delay_command(model: Model, memory: Memory, rotor_speed: Tensor, dt: float) -> CommandSwitch:
    """Return the delayed commands of the substep; the rotor states before the first command arrives."""
    effect, params = model.effects[DelayEffect][0]
    substeps = (effect.delay(params) / dt).clamp(0.0, float(memory.past.shape[1] - 2))
    whole = substeps.detach().floor()
    arriving = []
    for age in (whole.long() + 1, whole.long()):
        rows = age[:, None, None].clamp_max(memory.past.shape[1] - 1).expand(-1, 1, rotor_speed.shape[1])
        led_to = _effective_command(model, memory.past.gather(1, rows).squeeze(1))
        arriving.append(torch.where((age <= memory.since).unsqueeze(-1), led_to, rotor_speed))
    earlier, later = arriving
    return CommandSwitch(earlier=earlier, later=later, change=dt * (substeps - whole).unsqueeze(-1))


def link_state_of_load(model: Model, memory: Memory) -> Tensor:
    """Return direction and rate of the load's link, (E, 6), or (E, 0) without a load."""
    width = sum(len(effect.memory) for effect, _ in model.effects[LoadEffect])
    return memory.numbers[:, memory.numbers.shape[1] - width :]


def replace_memory(model: Model, memory: Memory, remembered: Mapping[str, Tensor]) -> Memory:
    """Return the memory with the numbers (E, M) of some effects replaced, by name."""
    places = model.effects.places(model.vehicle.num_rotors)
    parts = [remembered.get(place.effect.name, memory.numbers[:, place.memory]) for place in places]
    return replace(memory, numbers=torch.cat(parts, dim=-1))


def end_substep(memory: Memory, load: Tensor) -> Memory:
    """Return the memory after a substep with the new motion of the load, (E, 6) or (E, 0)."""
    numbers = torch.cat((memory.numbers[:, : memory.numbers.shape[1] - load.shape[1]], load), dim=-1)
    return replace(memory, numbers=numbers, since=memory.since + 1)
