# pyright: reportInvalidTypeForm=false, reportReturnType=false
"""Warp functions of the thrust and torque of one rotor: the twins of ``rotors.rotor_thrust`` and ``rotors.rotor_torque``."""

from functools import cache
from typing import Any

import warp as wp


@cache
def make_maps(vehicle: Any) -> tuple[wp.Function, wp.Function]:
    """Return the functions of thrust [N] and torque [N m]: (vehicle, rotor, state).

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
    def reversible_thrust(plant: vehicle, i: int, n: float) -> float:
        value = thrust(plant, i, n)
        if n < 0.0:
            backwards = plant.reverse_thrust_map
            value = -(backwards[i, 0] - n * (backwards[i, 1] - n * backwards[i, 2]))
        return value

    @wp.func
    def reversible_torque(plant: vehicle, i: int, n: float) -> float:
        value = torque(plant, i, n)
        if n < 0.0:
            backwards = plant.reverse_torque_map
            value = -(backwards[i, 0] - n * (backwards[i, 1] - n * backwards[i, 2]))
        return value

    return reversible_thrust, reversible_torque
