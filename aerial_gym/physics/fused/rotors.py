"""Warp functions of the rotors of one environment: lag, slew limit and dead band, for plain or general rotors.

Plain rotors have unsigned speeds with a first-order lag only. Their decay over a stage is computed beforehand.
Letters: R rotors.
"""

from functools import cache
from typing import Any

import warp as wp

from aerial_gym.physics.fused.torch_trace import trace_to_warp
from aerial_gym.physics.fused.types import rotor_types
from aerial_gym.physics.rotor_lag import slew_limited_lag, slew_limited_rate


@wp.func
def lag_acceleration(speed: float, command: float, decay_up: float, decay_down: float, jump: float, dt: float) -> float:
    """Return the Warp version of ``rotors.lag_acceleration`` for one rotor, from its decay over half a step."""
    decay = wp.where(command > speed, decay_up, decay_down)
    if decay > 0.0:
        return -2.0 * wp.log(decay) / dt * (command - speed)
    return jump / dt


@wp.func
def lag_speed(speed: float, command: float, decay_up: float, decay_down: float) -> float:
    """Return the rotor speed [rad/s] after a span with the decay ``exp(-span / tau)`` of the distance to the command."""
    return command + (speed - command) * wp.where(command > speed, decay_up, decay_down)


_LIMITS = ("state", "command", "tau_up", "tau_down", "slew_up", "slew_down")


@cache
def make_limited_lag(real: Any) -> wp.Function:
    """Return ``rotor_lag.slew_limited_lag`` of one rotor in a given precision."""
    arguments = dict.fromkeys((*_LIMITS, "dt"), real)
    return trace_to_warp("slew_limited_lag", arguments, slew_limited_lag, [real], constants={})


@cache
def _make_limited_rate() -> wp.Function:
    """Return ``rotor_lag.slew_limited_rate`` of one rotor."""
    arguments = dict.fromkeys((*_LIMITS, "jump", "dt"), float)
    return trace_to_warp("slew_limited_rate", arguments, slew_limited_rate, [float], constants={})


@cache
def make_follow(num_rotors: int, general: bool, late: bool = False, *, stages: int = 1) -> wp.Function:
    """Return the function of the states after one or two stages, (vehicle, states, commands, span [s]) -> states.

    Two stages in one call are rounded once. A state near its command stops once its change in a stage is below half a unit in
    the last place, so separate stages end twice as far from the command. With ``late``, the command changes within a step.
    """
    types, limited_lag = rotor_types(num_rotors, general), make_limited_lag(wp.float32)
    vehicle_type, vector, succession = types.vehicle, types.vector, types.succession

    @wp.func
    def plain(plant: vehicle_type, i: int, n: float, command: float, span: float) -> float:
        up = plant.decay_up[i]
        down = plant.decay_down[i]
        if wp.static(stages == 2):
            up = up * up
            down = down * down
        return lag_speed(n, command, up, down)

    @wp.func
    def plain_part(plant: vehicle_type, i: int, n: float, command: float, share: float, span: float) -> float:
        decay = wp.where(command > n, plant.decay_up[i], plant.decay_down[i])
        return n + (command - n) * (1.0 - wp.pow(decay, share * wp.static(float(stages))))

    @wp.func
    def general_law(plant: vehicle_type, i: int, n: float, command: float, span: float) -> float:
        return limited_lag(n, command, plant.tau_up[i], plant.tau_down[i], plant.slew_up[i], plant.slew_down[i], span)

    @wp.func
    def general_part(plant: vehicle_type, i: int, n: float, command: float, share: float, span: float) -> float:
        return general_law(plant, i, n, command, share * span)

    one, part = (general_law, general_part) if general else (plain, plain_part)

    @wp.func
    def follow(vehicle: vehicle_type, state: vector, command: vector, span: float) -> vector:
        after = vector()
        for i in range(wp.static(num_rotors)):
            after[i] = one(vehicle, i, state[i], command[i], span)
        return after

    @wp.func
    def follow_both(vehicle: vehicle_type, state: vector, command: succession, span: float) -> vector:
        after = vector()
        early = wp.min(command.change / span, 1.0)
        for i in range(wp.static(num_rotors)):
            middle = part(vehicle, i, state[i], command.earlier[i], early, span)
            after[i] = part(vehicle, i, middle, command.later[i], 1.0 - early, span)
        return after

    return follow_both if late else follow


@cache
def make_stage_rates(num_rotors: int, general: bool, late: bool = False) -> wp.Function:
    """Return the Warp version of ``rotor_lag.stage_rates``, (vehicle, three states, commands, step [s]) -> three rates."""
    types, limited_rate = rotor_types(num_rotors, general), _make_limited_rate()
    vehicle_type, vector, succession = types.vehicle, types.vector, types.succession

    @wp.func
    def plain(plant: vehicle_type, i: int, n: float, command: float, jump: float, dt: float) -> float:
        return lag_acceleration(n, command, plant.decay_up[i], plant.decay_down[i], jump, dt)

    @wp.func
    def general_law(plant: vehicle_type, i: int, n: float, command: float, jump: float, dt: float) -> float:
        return limited_rate(
            n, command, plant.tau_up[i], plant.tau_down[i], plant.slew_up[i], plant.slew_down[i], jump, dt
        )

    one = general_law if general else plain

    @wp.func
    def rates(vehicle: vehicle_type, state: vector, command: vector, first: vector, dt: float) -> vector:
        rate = vector()
        for i in range(wp.static(num_rotors)):
            rate[i] = one(vehicle, i, state[i], command[i], command[i] - first[i], dt)
        return rate

    @wp.func
    def single_rates(vehicle: vehicle_type, start: vector, middle: vector, end: vector, command: vector, dt: float):
        return (
            rates(vehicle, start, command, start, dt),
            rates(vehicle, middle, command, start, dt),
            rates(vehicle, end, command, start, dt),
        )

    @wp.func
    def switch_rate(
        vehicle: vehicle_type, state: vector, command: succession, time: float, jump: vector, dt: float
    ) -> vector:
        rate = vector()
        for i in range(wp.static(num_rotors)):
            now = wp.where(command.change > time, command.earlier[i], command.later[i])
            rate[i] = one(vehicle, i, state[i], now, jump[i], dt)
        return rate

    @wp.func
    def both(vehicle: vehicle_type, start: vector, middle: vector, end: vector, command: succession, dt: float):
        jump = end - start
        n1 = switch_rate(vehicle, start, command, 0.0, jump, dt)
        n2 = switch_rate(vehicle, middle, command, 0.5 * dt, jump, dt)
        n4 = switch_rate(vehicle, end, command, dt, jump, dt)
        missing = jump / dt - (n1 + 4.0 * n2 + n4) / 6.0
        return n1 + missing, n2 + missing, n4 + missing

    return both if late else single_rates


@cache
def make_dead_band(num_rotors: int) -> wp.Function:
    """Return the Warp version of ``rotor_lag.stop_in_dead_band``, (vehicle, commands) -> commands."""
    types = rotor_types(num_rotors, general=True)
    vehicle_type, vector = types.vehicle, types.vector

    @wp.func
    def stop_in_dead_band(vehicle: vehicle_type, command: vector) -> vector:
        after = vector()
        for i in range(wp.static(num_rotors)):
            after[i] = wp.where(wp.abs(command[i]) < vehicle.dead_band[i], 0.0, command[i])
        return after

    return stop_in_dead_band
