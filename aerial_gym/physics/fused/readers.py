"""How the numbers of an environment are read by the fused kernel: from a shared struct, or from their packed rows.

Letters: E environments, R rotors, N packed numbers.
"""

from collections.abc import Mapping
from functools import cache
from typing import Any

import warp as wp

from aerial_gym.physics.fused.law import FusedLaw, NoGains
from aerial_gym.physics.fused.packing import COMMAND_COLUMNS
from aerial_gym.physics.fused.types import RotorTypes, vector_of


@cache
def make_reader(kind: Any, height: int, width: int) -> wp.Function:
    """Return a function that reads a vector (width 0) or matrix of one environment from the packed tensor."""

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
    """Return a symmetric matrix of one environment from its ``SYMMETRIC`` entries."""
    xx, xy, xz = source[first, env], source[first + 1, env], source[first + 2, env]
    yy, yz, zz = source[first + 3, env], source[first + 4, env], source[first + 5, env]
    return wp.mat33(xx, xy, xz, xy, yy, yz, xz, yz, zz)


@cache
def make_column_reader(kind: Any, height: int, first_column: int, width: int) -> wp.Function:
    """Return a function that reads a matrix of one environment of which some columns are packed and the others are zero."""

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
    """Return a function that completes the shared vehicle with what is per environment."""
    at, num_rotors = packed.get, types.vector._length_
    vehicle_type = types.vehicle
    vec3, mat33 = make_reader(wp.vec3, 3, 0), read_symmetric if "inertia" in entries else make_reader(wp.mat33, 3, 3)
    vector, rows = make_reader(types.vector, num_rotors, 0), make_reader(types.rows, num_rotors, 3)
    squares = make_column_reader(types.rows, num_rotors, 2, 1)
    thrust_maps, torque_maps = (squares if name in entries else rows for name in ("thrust_map", "torque_map"))
    battery = make_reader(vector_of(6), 6, 0)

    @wp.func
    def read(shared: vehicle_type, source: wp.array2d[float], env: int) -> vehicle_type:
        vehicle = shared
        if wp.static("mass_inverse" in packed):
            vehicle.mass_inverse = source[wp.static(at("mass_inverse", 0)), env]
        if wp.static("inertia" in packed):
            vehicle.inertia = mat33(source, wp.static(at("inertia", 0)), env)
            vehicle.inertia_inverse = mat33(source, wp.static(at("inertia_inverse", 0)), env)
        if wp.static("com" in packed):
            vehicle.com = vec3(source, wp.static(at("com", 0)), env)
        if wp.static("thrust_map" in packed):
            vehicle.thrust_map = thrust_maps(source, wp.static(at("thrust_map", 0)), env)
        if wp.static("torque_map" in packed):
            vehicle.torque_map = torque_maps(source, wp.static(at("torque_map", 0)), env)
        if wp.static("rotor_axis" in packed):
            vehicle.rotor_axis = rows(source, wp.static(at("rotor_axis", 0)), env)
        if wp.static("rotor_moment" in packed):
            vehicle.rotor_moment = rows(source, wp.static(at("rotor_moment", 0)), env)
        if wp.static("rotor_lever" in packed):
            vehicle.rotor_lever = rows(source, wp.static(at("rotor_lever", 0)), env)
        if wp.static("rotor_radius" in packed):
            vehicle.rotor_radius = vector(source, wp.static(at("rotor_radius", 0)), env)
        if wp.static("rotor_reaction" in packed):
            vehicle.rotor_reaction = rows(source, wp.static(at("rotor_reaction", 0)), env)
        if wp.static("reverse_thrust_map" in packed):
            vehicle.reverse_thrust_map = rows(source, wp.static(at("reverse_thrust_map", 0)), env)
        if wp.static("reverse_torque_map" in packed):
            vehicle.reverse_torque_map = rows(source, wp.static(at("reverse_torque_map", 0)), env)
        if wp.static("tau_up" in packed):
            vehicle.tau_up = vector(source, wp.static(at("tau_up", 0)), env)
        if wp.static("tau_down" in packed):
            vehicle.tau_down = vector(source, wp.static(at("tau_down", 0)), env)
        if wp.static("slew_up" in packed):
            vehicle.slew_up = vector(source, wp.static(at("slew_up", 0)), env)
        if wp.static("slew_down" in packed):
            vehicle.slew_down = vector(source, wp.static(at("slew_down", 0)), env)
        if wp.static("dead_band" in packed):
            vehicle.dead_band = vector(source, wp.static(at("dead_band", 0)), env)
        if wp.static("decay_up" in packed):
            vehicle.decay_up = vector(source, wp.static(at("decay_up", 0)), env)
        if wp.static("decay_down" in packed):
            vehicle.decay_down = vector(source, wp.static(at("decay_down", 0)), env)
        if wp.static("battery" in packed):
            vehicle.battery = battery(source, wp.static(at("battery", 0)), env)
        if wp.static("ground_height" in packed):
            vehicle.ground_height = source[wp.static(at("ground_height", 0)), env]
        if wp.static("other_position" in packed):
            vehicle.other_position = vec3(source, wp.static(at("other_position", 0)), env)
        return vehicle

    return read


def make_command_reader(
    types: RotorTypes, packed: Mapping[str, int], entries: Mapping[str, tuple[int, ...]]
) -> wp.Function:
    """Return a function that completes the shared command parameters with what is per environment."""
    at, num_rotors = packed.get, types.vector._length_
    command_type = types.command
    vector, rows = make_reader(types.vector, num_rotors, 0), make_reader(types.rows, num_rotors, 3)
    matrix, speed_map = make_reader(types.allocation, num_rotors, 6), rows
    if "allocation" in entries:
        matrix = make_column_reader(types.allocation, num_rotors, *_ends(COMMAND_COLUMNS["allocation"]))
    if "speed_map" in entries:
        speed_map = make_column_reader(types.rows, num_rotors, *_ends(COMMAND_COLUMNS["speed_map"]))

    @wp.func
    def read(shared: command_type, source: wp.array2d[float], env: int) -> command_type:
        command = shared
        if wp.static("low" in packed):
            command.low = vector(source, wp.static(at("low", 0)), env)
        if wp.static("high" in packed):
            command.high = vector(source, wp.static(at("high", 0)), env)
        if wp.static("thrust_map" in packed):
            command.thrust_map = rows(source, wp.static(at("thrust_map", 0)), env)
        if wp.static("reverse_thrust_map" in packed):
            command.reverse_thrust_map = rows(source, wp.static(at("reverse_thrust_map", 0)), env)
        if wp.static("speed_map" in packed):
            command.speed_map = speed_map(source, wp.static(at("speed_map", 0)), env)
        if wp.static("allocation" in packed):
            command.allocation = matrix(source, wp.static(at("allocation", 0)), env)
        return command

    return read


def _ends(columns: range) -> tuple[int, int]:
    return columns.start, len(columns)


def make_gains_reader(law: FusedLaw, first: int | None) -> wp.Function:
    """Return a function to the gains of an environment; ``first`` is their row, None where all have the same."""
    gains_type, load = law.gains_type or NoGains, law.load_gains

    @wp.func
    def shared_gains(shared: gains_type, source: wp.array2d[float], env: int) -> gains_type:
        return shared

    if first is None:
        return shared_gains

    @wp.func
    def own_gains(shared: gains_type, source: wp.array2d[float], env: int) -> gains_type:
        return load(source, wp.static(first), env)

    return own_gains
