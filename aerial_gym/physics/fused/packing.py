"""Where each number of an environment stands for the fused kernel, how it is written there from torch, and how it is read.

A number that all environments share stands in a struct, which a launch passes by value. One that differs stands in the packed
tensor (N, E): its *row* is the same for all environments, so that neighbouring threads read neighbouring memory. What effects
have, parameters first and memory behind them, stays in one vector of *values* over the substeps, each effect at its *place*.
All writing is torch arithmetic: it can be captured, and gradients flow through it.
Letters: E environments, R rotors, N packed numbers, P parameters and M remembered numbers of an effect.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cache, reduce
from typing import Any

import torch
import warp as wp
from torch import Tensor

from aerial_gym.physics.effects import STEP_KINDS, CommandEffect, Effect, LoadEffect, RotorEffect, WrenchEffect
from aerial_gym.physics.fused.law import FusedLaw, NoGains
from aerial_gym.physics.fused.types import RotorTypes, rotor_types, vector_of
from aerial_gym.physics.model import Model
from aerial_gym.physics.rotor_lag import FASTEST, SHORTEST
from aerial_gym.physics.vehicle import is_shared


@dataclass(frozen=True)
class Field:
    """One field of a parameter struct and how it follows from tensors (E, ...)."""

    name: str
    sources: tuple[Tensor, ...]
    compute: Callable[..., Tensor]

    @property
    def shared(self) -> bool:
        """Whether all environments have the same value."""
        return all(is_shared(source) for source in self.sources)

    def rows(self) -> Tensor:
        """Return the numbers of every environment, (E, n)."""
        return self.compute(*self.sources).flatten(1)

    def row(self) -> list[float]:
        """Return the numbers that all environments share."""
        return self.compute(*(source[:1] for source in self.sources)).flatten().tolist()


def _same(rows: Tensor) -> Tensor:
    return rows.unsqueeze(1) if rows.dim() == 1 else rows


def _vehicle_fields(model: Model, stage: float) -> list[Field]:
    """Return the fields of ``VehicleParameters``; ``stage`` [s] is the span over which a rotor is followed at once."""
    v = model.vehicle

    def decay(tau: Tensor) -> Tensor:
        return torch.exp(-stage / tau)

    def moment(position: Tensor, com: Tensor, axis: Tensor) -> Tensor:
        return torch.linalg.cross(position - com.unsqueeze(1), axis)

    fields = [
        Field("mass_inverse", (v.mass,), lambda mass: 1.0 / mass.unsqueeze(1)),
        Field("inertia", (v.inertia,), _same),
        Field("inertia_inverse", (model.inertia_inverse,), _same),
        Field("com", (v.com,), _same),
        Field("thrust_map", (v.thrust_map,), _same),
        Field("torque_map", (v.torque_map,), _same),
        Field("rotor_axis", (v.rotor_axis,), _same),
        Field("rotor_moment", (v.rotor_position, v.com, v.rotor_axis), moment),
        Field("rotor_reaction", (v.rotor_spin, v.rotor_axis), lambda spin, axis: -spin.unsqueeze(-1) * axis),
    ]
    if v.plain:
        fields += [Field("decay_up", (v.time_constant_up,), decay), Field("decay_down", (v.time_constant_down,), decay)]
    else:
        fields += [
            Field("reverse_thrust_map", (v.reverse_thrust_map,), _same),
            Field("reverse_torque_map", (v.reverse_torque_map,), _same),
            Field("tau_up", (v.time_constant_up,), lambda tau: tau.clamp_min(SHORTEST)),
            Field("tau_down", (v.time_constant_down,), lambda tau: tau.clamp_min(SHORTEST)),
            Field("slew_up", (v.slew_rate,), lambda rate: rate.clamp_max(FASTEST)),
            Field("slew_down", (v.slew_rate_down,), lambda rate: rate.clamp_max(FASTEST)),
            Field("dead_band", (v.dead_band,), _same),
        ]
    if model.effects[CommandEffect]:
        fields.append(Field("battery", (v.battery,), _same))
    if model.effects[WrenchEffect]:
        fields.append(Field("other_position", (model.other_position,), _same))
    if model.effects[RotorEffect] or model.effects[WrenchEffect]:
        fields += [
            Field("rotor_lever", (v.rotor_position, v.com), lambda position, com: position - com.unsqueeze(1)),
            Field("rotor_radius", (v.rotor_radius,), _same),
        ]
    return fields


def _command_fields(law: FusedLaw, plain: bool) -> list[Field]:
    """Return the fields of ``CommandParameters``."""

    def speed_map(thrust_map: Tensor) -> Tensor:
        """Complete the square of ``c0 + c1 w + c2 w² = T``."""
        c0, c1, c2 = thrust_map.unbind(-1)
        vertex = c1 / (2.0 * c2)
        return torch.stack((vertex * vertex - c0 / c2, 1.0 / c2, vertex), dim=-1)

    fields = [Field("low", (law.low,), _same), Field("high", (law.high,), _same)]
    if law.thrust_map is not None and plain:
        fields.append(Field("speed_map", (law.thrust_map,), speed_map))
    if law.thrust_map is not None and not plain:
        backwards = law.thrust_map if law.reverse_thrust_map is None else law.reverse_thrust_map
        fields += [Field("thrust_map", (law.thrust_map,), _same), Field("reverse_thrust_map", (backwards,), _same)]
    if law.allocation is not None:
        fields.append(Field("allocation", (law.allocation,), _same))
    return fields


@dataclass(frozen=True)
class Numbers:
    """All numbers of a model and a control law, by the struct that takes them."""

    vehicle: list[Field]
    command: list[Field]
    gains: list[Field]
    """All of them differ between environments, or none."""

    effects: list[Tensor]
    """Parameters (E, P) of the effects that act in a step, in the order of ``EffectsByKind.forces``; always packed."""


def numbers_of(model: Model, law: FusedLaw, stage: float) -> Numbers:
    """Return all numbers; ``stage`` [s] is the span over which a rotor is followed at once."""
    gains = [Field(name, (rows,), _same) for name, rows in law.gains.items()]
    effects = [params for _, params in model.effects.forces]
    return Numbers(_vehicle_fields(model, stage), _command_fields(law, model.vehicle.plain), gains, effects)


@dataclass(frozen=True)
class Packing:
    """The first row in the packed tensor (N, E) of each field that differs between environments."""

    vehicle: Mapping[str, int]
    command: Mapping[str, int]
    gains: int | None
    """Of the first gain; None where all environments have the same."""

    effects: int
    total: int
    """N."""


def arrange(numbers: Numbers, *, all_packed: bool) -> Packing:
    """Return a row for every number that differs between environments; with ``all_packed`` for every number."""
    first = 0

    def place(fields: list[Field]) -> dict[str, int]:
        nonlocal first
        rows = {}
        for field in fields:
            if all_packed or not field.shared:
                rows[field.name] = first
                first += len(field.row())
        return rows

    vehicle, command, gains = place(numbers.vehicle), place(numbers.command), None
    if numbers.gains and (all_packed or not all(field.shared for field in numbers.gains)):
        gains = first
        first += sum(len(field.row()) for field in numbers.gains)
    return Packing(vehicle, command, gains, first, first + sum(params.shape[1] for params in numbers.effects))


def packed_rows(packing: Packing, numbers: Numbers) -> list[Tensor]:
    """Return the packed numbers, each (E, n), in the order of their rows."""
    packed = [field.rows() for field in numbers.vehicle if field.name in packing.vehicle]
    packed += [field.rows() for field in numbers.command if field.name in packing.command]
    if packing.gains is not None:
        packed += [field.rows() for field in numbers.gains]
    return packed + numbers.effects


def shared_structs(packing: Packing, numbers: Numbers, law: FusedLaw, types: RotorTypes) -> list[Any]:
    """Return the structs of vehicle, command and gains with the shared numbers in them; fields that are packed stay zero."""
    gains = numbers.gains if packing.gains is None else []
    return [
        _struct(types.vehicle, numbers.vehicle, packing.vehicle),
        _struct(types.command, numbers.command, packing.command),
        _struct(law.gains_type or NoGains, gains, {}),
    ]


def _struct(struct_type: Any, fields: list[Field], packed: Mapping[str, int]) -> Any:
    struct = struct_type()
    for field in fields:
        if field.name not in packed:
            *outer, name = field.name.split(".")
            part = reduce(getattr, outer, struct)
            value, numbers = getattr(part, name), field.row()
            setattr(part, name, numbers[0] if isinstance(value, (int, float)) else type(value)(*numbers))
    return struct


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


def types_of(model: Model) -> RotorTypes:
    """Return the types for the rotors of a model."""
    return rotor_types(model.vehicle.num_rotors, not model.vehicle.plain)


def make_vehicle_reader(types: RotorTypes, packed: Mapping[str, int]) -> wp.Function:
    """Return a function that completes the shared vehicle with what is per environment."""
    at, num_rotors = packed.get, types.vector._length_
    vehicle_type = types.vehicle
    vec3, mat33 = make_reader(wp.vec3, 3, 0), make_reader(wp.mat33, 3, 3)
    vector, rows = make_reader(types.vector, num_rotors, 0), make_reader(types.rows, num_rotors, 3)
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
            vehicle.thrust_map = rows(source, wp.static(at("thrust_map", 0)), env)
        if wp.static("torque_map" in packed):
            vehicle.torque_map = rows(source, wp.static(at("torque_map", 0)), env)
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
        if wp.static("other_position" in packed):
            vehicle.other_position = vec3(source, wp.static(at("other_position", 0)), env)
        return vehicle

    return read


def make_command_reader(types: RotorTypes, packed: Mapping[str, int]) -> wp.Function:
    """Return a function that completes the shared command parameters with what is per environment."""
    at, num_rotors = packed.get, types.vector._length_
    command_type = types.command
    vector, rows = make_reader(types.vector, num_rotors, 0), make_reader(types.rows, num_rotors, 3)
    matrix = make_reader(types.allocation, num_rotors, 6)

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
            command.speed_map = rows(source, wp.static(at("speed_map", 0)), env)
        if wp.static("allocation" in packed):
            command.allocation = matrix(source, wp.static(at("allocation", 0)), env)
        return command

    return read


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


@dataclass(frozen=True)
class Pick:
    """Access to the values of one effect."""

    get: wp.Function
    """``wp.func`` (values of all effects) -> parameters of this one, and its memory behind them: vector of P + M."""

    put: wp.Function
    """``wp.func`` (values of all, vector of P + M) -> values of all with this memory."""


def num_values(model: Model) -> tuple[int, int]:
    """Return how many parameters and remembered numbers there are."""
    places = model.effects.places(model.vehicle.num_rotors)
    return (places[-1].params.stop, places[-1].memory.stop) if places else (0, 0)


def values_type(model: Model) -> Any:
    """Return the type of the vector."""
    return vector_of(max(sum(num_values(model)), 1))


def pickers(model: Model) -> dict[type[Effect], list[Pick]]:
    """Return access to each effect of each kind. A load keeps its memory with the motion, and is given parameters alone."""
    values, (num_params, _) = values_type(model), num_values(model)
    found: dict[type[Effect], list[Pick]] = {kind: [] for kind in STEP_KINDS}
    for place in model.effects.places(model.vehicle.num_rotors):
        kind, params, memory = place.effect.kind, place.params, place.memory
        shown = 0 if kind is LoadEffect else memory.stop - memory.start
        pick = _pick(values, params.start, params.stop - params.start, num_params + memory.start, shown)
        found[kind].append(pick)
    return found


def _pick(values: Any, first: int, width: int, first_memory: int, memory: int) -> Pick:
    own = vector_of(width + memory)

    @wp.func
    def get(all_values: values) -> own:
        picked = own()
        for i in range(wp.static(width)):
            picked[i] = all_values[wp.static(first) + i]
        for i in range(wp.static(memory)):
            picked[wp.static(width) + i] = all_values[wp.static(first_memory) + i]
        return picked

    @wp.func
    def put(all_values: values, own_values: own) -> values:
        after = all_values
        for i in range(wp.static(memory)):
            after[wp.static(first_memory) + i] = own_values[wp.static(width) + i]
        return after

    return Pick(get, put)
