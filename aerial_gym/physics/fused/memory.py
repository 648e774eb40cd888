"""Start of a substep for one environment in Warp: memory of the effects, and rotor commands after delay and battery.

Twin of ``physics.memory``. Letters: E environments, R rotors, M numbers of all effects, S remembered commands.
"""

from typing import Any

import warp as wp

from aerial_gym.math.draws import RandomArrays, episode_stream, substream
from aerial_gym.math.random import Purpose
from aerial_gym.physics.effects import DelayEffect
from aerial_gym.physics.fused.formulas import make_command_effects, make_delay, make_memory_update
from aerial_gym.physics.fused.packing import effect_values_type, rotor_types_of_model
from aerial_gym.physics.fused.types import LawArrays, RotorTypes
from aerial_gym.physics.model import Model


@wp.struct
class MemoryArrays:
    """Memory of all effects in all environments."""

    numbers: wp.array2d[float]  # (M, E)
    past: wp.array2d[float]  # (S R, E) commands [rad/s], a ring
    since: wp.array[int]  # (E,) substeps since the reset
    random: RandomArrays
    shared: RandomArrays  # of all vehicles of an environment; read if ``shares``
    shares: wp.bool  # whether environments have several vehicles
    slots: int  # S


@wp.struct
class NoMemory:
    """In place of ``MemoryArrays`` without memory: short arguments make a launch cheaper."""

    slots: int  # 0


@wp.struct
class LawAlone:
    """Memory of the law, if no effect has memory."""

    law: LawArrays


@wp.struct
class LawAndEffects:
    """Memory of law and effects."""

    law: LawArrays
    effects: MemoryArrays


def memory_type(*, effects: bool, law: bool) -> Any:
    """Return the struct of memory of a kernel, for effects and law with or without memory."""
    if law:
        return LawAndEffects if effects else LawAlone
    return MemoryArrays if effects else NoMemory


def make_substep_start(model: Model) -> wp.Function:
    """Return the function from values and command to those of a substep; with a delay, to two commands."""
    types, values, num_rotors = rotor_types_of_model(model), effect_values_type(model), model.vehicle.num_rotors
    moment, vehicle_type, vector = types.moment, types.vehicle, types.vector
    remember, lead, any_delay = make_memory_update(model), make_command_effects(model), bool(model.effects[DelayEffect])
    delayed = _make_delayed(model, lead) if any_delay else None

    @wp.func
    def begin(
        vehicle: vehicle_type, all_values: values, command: vector, speed: vector, arrays: MemoryArrays, env: int,
        since: int, dt: float,
    ):  # fmt: skip
        now = moment()
        now.rotor_speed = speed
        now.since = since
        now.random = substream(episode_stream(arrays.random, env, wp.static(int(Purpose.EFFECTS))), since)
        now.shared = now.random
        if arrays.shares:
            now.shared = substream(episode_stream(arrays.shared, env, wp.static(int(Purpose.EFFECTS))), since)
        now.dt = dt
        remembered = remember(vehicle, now, all_values)
        if wp.static(any_delay):
            for i in range(wp.static(num_rotors)):
                arrays.past[(since % arrays.slots) * wp.static(num_rotors) + i, env] = command[i]
            followed = delayed(vehicle, now, remembered, arrays, env)
        else:
            followed = lead(vehicle, remembered, command)
        return remembered, followed

    return begin


def _make_delayed(model: Model, lead: wp.Function) -> wp.Function:
    """Return the function to the delayed commands of the substep."""
    types, values, num_rotors = rotor_types_of_model(model), effect_values_type(model), model.vehicle.num_rotors
    delay_of, arrive = make_delay(model), _make_delayed_commands(types, num_rotors, lead, values)
    moment, vehicle_type, succession = types.moment, types.vehicle, types.succession

    @wp.func
    def delay_command(
        vehicle: vehicle_type, now: moment, all_values: values, arrays: MemoryArrays, env: int
    ) -> succession:
        substeps = wp.clamp(delay_of(all_values) / now.dt, 0.0, float(arrays.slots - 2))
        whole = wp.floor(substeps)
        both = succession()
        both.earlier = arrive(vehicle, now, all_values, arrays, env, int(whole) + 1)
        both.later = arrive(vehicle, now, all_values, arrays, env, int(whole))
        both.change = (substeps - whole) * now.dt
        return both

    return delay_command


def _make_delayed_commands(types: RotorTypes, num_rotors: int, lead: wp.Function, values: Any) -> wp.Function:
    moment, vehicle_type, vector = types.moment, types.vehicle, types.vector

    @wp.func
    def arrive(
        vehicle: vehicle_type, now: moment, all_values: values, arrays: MemoryArrays, env: int, age: int
    ) -> vector:
        if age > now.since:  # nothing has been commanded yet
            return now.rotor_speed
        command = vector()
        for i in range(wp.static(num_rotors)):
            command[i] = arrays.past[((now.since - age) % arrays.slots) * wp.static(num_rotors) + i, env]
        return lead(vehicle, all_values, command)

    return arrive
