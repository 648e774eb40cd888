"""How the rotors of one environment follow their commands, and the maps of their states, composed for plain or general rotors.

Plain rotors have speeds without sign that follow with a lag alone: their decays over a stage are worked out beforehand.
Letters: R rotors.
"""

from functools import cache
from typing import Any

import warp as wp

from aerial_gym.physics.fused.functions import lag_acceleration, lag_speed, limited_rate, make_limited_lag
from aerial_gym.physics.fused.types import rotor_types


@cache
def make_maps(vehicle: Any) -> tuple[wp.Function, wp.Function]:
    """Return ``rotors.rotor_thrust`` and ``rotors.rotor_torque`` of one rotor, (vehicle, rotor, state) -> [N], [N m].

    Args:
        vehicle: The ``wp.struct`` of the vehicle.
    """

    @wp.func
    def thrust(plant: vehicle, i: int, n: float) -> float:
        return plant.thrust_map[i, 0] + n * (plant.thrust_map[i, 1] + n * plant.thrust_map[i, 2])

    @wp.func
    def torque(plant: vehicle, i: int, n: float) -> float:
        return plant.torque_map[i, 0] + n * (plant.torque_map[i, 1] + n * plant.torque_map[i, 2])

    if "reverse_thrust_map" not in vehicle.vars:
        return thrust, torque

    @wp.func
    def signed_thrust(plant: vehicle, i: int, n: float) -> float:
        value = thrust(plant, i, n)
        if n < 0.0:
            backwards = plant.reverse_thrust_map
            value = -(backwards[i, 0] - n * (backwards[i, 1] - n * backwards[i, 2]))
        return value

    @wp.func
    def signed_torque(plant: vehicle, i: int, n: float) -> float:
        value = torque(plant, i, n)
        if n < 0.0:
            backwards = plant.reverse_torque_map
            value = -(backwards[i, 0] - n * (backwards[i, 1] - n * backwards[i, 2]))
        return value

    return signed_thrust, signed_torque


@cache
def make_follow(num_rotors: int, general: bool, late: bool = False, *, stages: int = 1) -> wp.Function:
    """Return a function to the states after one or two stages of a stepper, (vehicle, states, commands, span [s]) -> states.

    Two stages at once are rounded once: a state near its command stands still where what is left of the way in a stage is less
    than half a unit in its last place, so that stages one by one end twice as far from the command. With ``late`` two
    commands follow each other in a step.
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
    def limited(plant: vehicle_type, i: int, n: float, command: float, span: float) -> float:
        return limited_lag(n, command, plant.tau_up[i], plant.tau_down[i], plant.slew_up[i], plant.slew_down[i], span)

    @wp.func
    def limited_part(plant: vehicle_type, i: int, n: float, command: float, share: float, span: float) -> float:
        return limited(plant, i, n, command, share * span)

    one, part = (limited, limited_part) if general else (plain, plain_part)

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
    """Return ``rotor_lag.stage_rates``, (vehicle, states at start, middle and end, commands, step [s]) -> three rates."""
    types = rotor_types(num_rotors, general)
    vehicle_type, vector, succession = types.vehicle, types.vector, types.succession

    @wp.func
    def plain(plant: vehicle_type, i: int, n: float, command: float, jump: float, dt: float) -> float:
        return lag_acceleration(n, command, plant.decay_up[i], plant.decay_down[i], jump, dt)

    @wp.func
    def limited(plant: vehicle_type, i: int, n: float, command: float, jump: float, dt: float) -> float:
        return limited_rate(n, command, plant.tau_up[i], plant.tau_down[i], plant.slew_up[i], plant.slew_down[i])

    one = limited if general else plain

    @wp.func
    def rates(vehicle: vehicle_type, state: vector, command: vector, first: vector, dt: float) -> vector:
        rate = vector()
        for i in range(wp.static(num_rotors)):
            rate[i] = one(vehicle, i, state[i], command[i], command[i] - first[i], dt)
        return rate

    @wp.func
    def held(vehicle: vehicle_type, start: vector, middle: vector, end: vector, command: vector, dt: float):
        return (
            rates(vehicle, start, command, start, dt),
            rates(vehicle, middle, command, start, dt),
            rates(vehicle, end, command, start, dt),
        )

    @wp.func
    def at(vehicle: vehicle_type, state: vector, command: succession, time: float, jump: vector, dt: float) -> vector:
        rate = vector()
        for i in range(wp.static(num_rotors)):
            now = wp.where(command.change > time, command.earlier[i], command.later[i])
            rate[i] = one(vehicle, i, state[i], now, jump[i], dt)
        return rate

    @wp.func
    def both(vehicle: vehicle_type, start: vector, middle: vector, end: vector, command: succession, dt: float):
        jump = end - start
        n1 = at(vehicle, start, command, 0.0, jump, dt)
        n2 = at(vehicle, middle, command, 0.5 * dt, jump, dt)
        n4 = at(vehicle, end, command, dt, jump, dt)
        missing = jump / dt - (n1 + 4.0 * n2 + n4) / 6.0
        return n1 + missing, n2 + missing, n4 + missing

    return both if late else held


@cache
def make_dead_band(num_rotors: int) -> wp.Function:
    """Return ``rotor_lag.stop_in_dead_band`` for general rotors, (vehicle, commands) -> commands."""
    types = rotor_types(num_rotors, general=True)
    vehicle_type, vector = types.vehicle, types.vector

    @wp.func
    def stop_in_dead_band(vehicle: vehicle_type, command: vector) -> vector:
        after = vector()
        for i in range(wp.static(num_rotors)):
            after[i] = wp.where(wp.abs(command[i]) < vehicle.dead_band[i], 0.0, command[i])
        return after

    return stop_in_dead_band
