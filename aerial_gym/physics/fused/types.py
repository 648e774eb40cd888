"""Warp types that depend on the number of rotors, created once for each number, and readers of an environment's numbers.

The fused kernel reads from a shared struct, or from packed rows.
Letters: E environments, R rotors, N packed numbers.
"""

import linecache
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from itertools import count
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
        shared: wp.uint32  # that of all vehicles of the environment
        dt: float  # [s]

    vehicle_type = _struct("VehicleParameters", vehicle)
    return RotorTypes(vector, rows, vehicle_type, KernelCommandSwitch, KernelMoment)


def _struct(name: str, fields: dict[str, Any]) -> Any:
    return wp.struct(type(name, (), {"__annotations__": fields, "__module__": __name__}))


@cache
def make_reader(kind: Any, height: int, width: int) -> wp.Function:
    """Return the function that reads a vector (width 0) or matrix of one environment from the packed tensor."""

    @wp.func
    def read_vector(source: wp.array2d[float], first: int, env: int) -> kind:
        value = kind()
        for i in range(wp.static(height)):
            value[i] = source[first + i, env]
        return value

    @wp.func
    def read_matrix(source: wp.array2d[float], first: int, env: int) -> kind:
        value = kind()
        for i in range(wp.static(height)):
            for j in range(wp.static(width)):
                value[i, j] = source[first + i * wp.static(width) + j, env]
        return value

    return read_matrix if width else read_vector


@wp.func
def read_symmetric(source: wp.array2d[float], first: int, env: int) -> wp.mat33:
    """Read a symmetric matrix of one environment from its ``SYMMETRIC`` entries."""
    xx, xy, xz = source[first, env], source[first + 1, env], source[first + 2, env]
    yy, yz, zz = source[first + 3, env], source[first + 4, env], source[first + 5, env]
    return wp.mat33(xx, xy, xz, xy, yy, yz, xz, yz, zz)


@cache
def make_column_reader(kind: Any, height: int, first_column: int, width: int) -> wp.Function:
    """Return the function that reads a matrix of one environment with some packed columns and zeros elsewhere."""

    @wp.func
    def read_columns(source: wp.array2d[float], first: int, env: int) -> kind:
        value = kind()
        for i in range(wp.static(height)):
            for j in range(wp.static(width)):
                value[i, wp.static(first_column) + j] = source[first + i * wp.static(width) + j, env]
        return value

    return read_columns


def make_vehicle_reader(
    types: RotorTypes, packed: Mapping[str, int], entries: Mapping[str, tuple[int, ...]]
) -> wp.Function:
    """Return the function that completes the shared vehicle with an environment's own numbers."""
    num_rotors = types.vector._length_
    few: dict[str, wp.Function] = {}
    if "inertia" in entries:
        few |= dict.fromkeys(("inertia", "inertia_inverse"), read_symmetric)
    for name in {"thrust_map", "torque_map"} & entries.keys():
        few[name] = make_column_reader(types.rows, num_rotors, 2, 1)
    return make_completion(types.vehicle, packed, few)


def make_completion(struct: Any, packed: Mapping[str, int], few: Mapping[str, wp.Function]) -> wp.Function:
    """Return ``wp.func`` (shared struct, packed tensor, environment) -> the struct with its packed fields in place.

    Args:
        packed: First row of each packed field.
        few: Readers of fields with only some packed entries.
    """
    kinds = {name: kind for name, kind in struct.cls.__annotations__.items() if name in packed}
    names: dict[str, Any] = {f"read_{n}": few[n] if n in few else _make_reader(kind) for n, kind in kinds.items()}
    lines = [f"    value.{name} = read_{name}(source, {packed[name]}, env)" for name in kinds]
    head = "def complete(shared: struct, source: wp.array2d[float], env: int) -> struct:\n    value = shared\n"
    return compile_source("complete", head + "\n".join([*lines, "    return value"]), {**names, "struct": struct})


def _make_reader(kind: Any) -> wp.Function:
    if kind is float:
        return read_number
    height, *width = kind._shape_
    return make_reader(kind, height, *(width or (0,)))


@wp.func
def read_number(source: wp.array2d[float], first: int, env: int) -> float:
    """Read one number of one environment."""
    return source[first, env]


def compile_source(name: str, code: str, names: Mapping[str, Any]) -> wp.Function:
    """Compile a source that may call ``names``, and return its ``wp.func``."""
    file = f"<{__name__} {next(_number)}>"
    linecache.cache[file] = (len(code), None, code.splitlines(keepends=True), file)  # Warp reads the source here
    namespace = {"wp": wp, "__name__": __name__, **names}
    exec(compile(code, file, "exec"), namespace)
    return wp.func(namespace[name])


_number = count()
