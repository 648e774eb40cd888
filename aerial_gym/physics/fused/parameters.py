"""Parameters of vehicle, effects and control law, from torch rows to what a kernel reads.

What all environments share goes into structs that a launch passes by value; the rest stands in one tensor (N, E), a row for
each number, so that neighbouring threads read neighbouring memory. All of it is torch arithmetic: it can be captured, and
gradients flow through it.
Letters: E environments, R rotors, N numbers per environment.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import torch
from torch import Tensor

from aerial_gym.physics.effects import CommandEffect, RotorEffect, WrenchEffect
from aerial_gym.physics.fused.law import FusedLaw
from aerial_gym.physics.model import Model
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


def vehicle_fields(model: Model, stage: float) -> list[Field]:
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
        Field("decay_up", (v.time_constant_up,), decay),
        Field("decay_down", (v.time_constant_down,), decay),
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


def command_fields(law: FusedLaw) -> list[Field]:
    """Return the fields of ``CommandParameters``."""

    def speed_map(thrust_map: Tensor) -> Tensor:
        """Complete the square of ``c0 + c1 w + c2 w² = T``."""
        c0, c1, c2 = thrust_map.unbind(-1)
        vertex = c1 / (2.0 * c2)
        return torch.stack((vertex * vertex - c0 / c2, 1.0 / c2, vertex), dim=-1)

    fields = [Field("low", (law.low,), _same), Field("high", (law.high,), _same)]
    if law.thrust_map is not None:
        fields.append(Field("speed_map", (law.thrust_map,), speed_map))
    if law.allocation is not None:
        fields.append(Field("allocation", (law.allocation,), _same))
    return fields


def gain_fields(law: FusedLaw) -> list[Field]:
    """Return the fields of the law's own struct: all of them per environment, or none."""
    return [Field(name, (rows,), _same) for name, rows in law.gains.items()]


def effect_rows(model: Model) -> list[Tensor]:
    """Return the parameters (E, P) of the effects that act in a step, in the order of ``EffectsByKind.forces``."""
    return [params for _, params in model.effects.forces]


@dataclass(frozen=True)
class Columns:
    """Where each field that is per environment starts in the tensor (N, E)."""

    vehicle: Mapping[str, int]
    command: Mapping[str, int]
    gains: int | None
    effects: int
    num_effect_params: int
    total: int


def arrange(
    vehicle: list[Field], command: list[Field], gains: list[Field], effects: list[Tensor], *, all_per_env: bool
) -> Columns:
    """Return a place for every number that is per environment; with ``all_per_env`` for every number."""
    first = 0

    def place(fields: list[Field]) -> dict[str, int]:
        nonlocal first
        places = {}
        for field in fields:
            if all_per_env or not field.shared:
                places[field.name] = first
                first += len(field.row())
        return places

    vehicle_places, command_places = place(vehicle), place(command)
    gains_first = None
    if gains and (all_per_env or not all(field.shared for field in gains)):
        gains_first = first
        first += sum(len(field.row()) for field in gains)
    width = sum(rows.shape[1] for rows in effects)
    return Columns(vehicle_places, command_places, gains_first, first, width, first + width)


def per_env_rows(
    columns: Columns, vehicle: list[Field], command: list[Field], gains: list[Field], effects: list[Tensor]
) -> list[Tensor]:
    """Return the numbers that are per environment, each (E, n), in the order of ``arrange``."""
    rows = [field.rows() for field in vehicle if field.name in columns.vehicle]
    rows += [field.rows() for field in command if field.name in columns.command]
    if columns.gains is not None:
        rows += [field.rows() for field in gains]
    return rows + effects


def shared_struct(struct_type: Any, fields: list[Field], places: Mapping[str, int]) -> Any:
    """Return a struct with the shared numbers in it; fields that are per environment stay zero."""
    struct = struct_type()
    for field in fields:
        if field.name not in places:
            value = getattr(struct, field.name)
            numbers = field.row()
            setattr(struct, field.name, numbers[0] if isinstance(value, (int, float)) else type(value)(*numbers))
    return struct
