"""Warp types that depend on the number of rotors, created once for each number.

Letters: R rotors.
"""

from dataclasses import dataclass
from functools import cache
from typing import Any

import warp as wp

from aerial_gym.math.warp_functions import vector_type


@dataclass(frozen=True)
class RotorTypes:
    """Warp types whose size is the number of rotors R of a vehicle: vector, matrix and structs."""

    vector: Any  # One number per rotor
    rows: Any  # Three numbers per rotor, (R, 3)
    vehicle: Any  # `wp.struct` of the vehicle in the equations of motion
    succession: Any  # `wp.struct` of two commands in one step: `rotor_lag.Succession` for one environment
    moment: Any  # `wp.struct` of the start of a substep: `effects.SubstepStart` for one environment


@wp.struct
class LawArrays:
    """Memory of the control law in all environments: ``law_memory.LawMemory``."""

    numbers: wp.array2d[float]  # (M, E)
    past: wp.array2d[float]  # (P, E)
    since: wp.array[int]  # (E,)


def rotor_types(num_rotors: int, general: bool = False) -> RotorTypes:
    """Return the types for a number of rotors; ``general`` unless all rotors are plain (``Vehicle.plain``)."""
    return _rotor_types(num_rotors, general)  # one cache key for positional and keyword arguments


@cache
def _rotor_types(num_rotors: int, general: bool) -> RotorTypes:
    vector = vector_type(num_rotors)
    rows = wp.types.matrix(shape=(num_rotors, 3), dtype=wp.float32)
    six = vector_type(6)

    vehicle = {
        "mass_inverse": float,  # [1/kg]
        "inertia": wp.mat33,  # [kg m²] about the centre of mass
        "inertia_inverse": wp.mat33,  # [1/(kg m²)]
        "com": wp.vec3,  # [m] from the body origin
        "thrust_map": rows,  # c0, c1, c2 [N, N s, N s²]
        "torque_map": rows,  # q0, q1, q2 [N m, N m s, N m s²]
        "rotor_axis": rows,  # direction of thrust
        "rotor_moment": rows,  # torque per thrust about the centre of mass [m], (r - c) x a
        "rotor_lever": rows,  # hub from the centre of mass [m], r - c
        "rotor_radius": vector,  # [m]
        "rotor_reaction": rows,  # torque per drag torque, -s a
    }
    if general:
        vehicle |= {
            "reverse_thrust_map": rows,
            "reverse_torque_map": rows,
            "tau_up": vector,  # [s] of a state that grows in size
            "tau_down": vector,
            "slew_up": vector,  # [rad/s²] or [N/s]
            "slew_down": vector,
            "dead_band": vector,  # [rad/s] or [N]
        }
    else:
        vehicle |= {
            "decay_up": vector,  # exp(-span / tau) of a rising speed over one stage of the stepper
            "decay_down": vector,
        }
    vehicle |= {
        "battery": six,  # nominal, full, empty voltage [V], resistance [Ohm], capacity [A s], efficiency
        "ground_height": float,  # [m], world, if it differs between environments
        "other_position": wp.vec3,  # another vehicle [m], world
    }

    @wp.struct
    class KernelCommandSwitch:
        earlier: vector  # [rad/s] or [N]
        later: vector
        change: float  # from the start of the step to the later ones [s]

    @wp.struct
    class KernelMoment:
        rotor_speed: vector  # [rad/s]
        since: int  # substeps since the reset
        random: wp.uint32
        dt: float  # [s]

    vehicle_type = _struct("VehicleParameters", vehicle)
    return RotorTypes(vector, rows, vehicle_type, KernelCommandSwitch, KernelMoment)


def _struct(name: str, fields: dict[str, Any]) -> Any:
    return wp.struct(type(name, (), {"__annotations__": fields, "__module__": __name__}))
