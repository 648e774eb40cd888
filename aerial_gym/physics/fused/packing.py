"""Memory layout of the numbers that the fused kernel reads, and their computation in torch.

A number that all environments share is in a struct, which a launch passes by value. A number that differs has a *row* of the
packed tensor (N, E), so neighbouring threads read neighbouring memory. Parameters and memory of all effects form one vector
of *values* over the substeps, with each effect at its *place*. All packing is torch arithmetic: a CUDA graph can capture it,
and gradients flow through it.
Letters: E environments, R rotors, N packed numbers, P parameters and M remembered numbers of an effect.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import torch
from torch import Tensor

from aerial_gym.math.warp_functions import vector_type
from aerial_gym.physics.fused.law import FusedLaw, LawField
from aerial_gym.physics.fused.types import RotorTypes, rotor_types
from aerial_gym.physics.model import Model
from aerial_gym.physics.rotor_lag import FASTEST
from aerial_gym.physics.rotors import SHORTEST
from aerial_gym.physics.vehicle import is_shared


@dataclass(frozen=True)
class StructField:
    """A field of a parameter struct, computed from tensors (E, ...)."""

    name: str
    sources: tuple[Tensor, ...]
    compute: Callable[..., Tensor]

    @property
    def is_common(self) -> bool:
        """Whether all environments have the same value."""
        return all(is_shared(source) for source in self.sources)

    def rows(self, entries: tuple[int, ...] | None = None) -> Tensor:
        """Return the numbers of every environment, (E, n), or some entries of them."""
        rows = self.compute(*self.sources).flatten(1)
        return rows if entries is None else torch.stack([rows[:, i] for i in entries], dim=1)

    def common_values(self) -> list[float]:
        """Return the numbers that all environments share, computed on the CPU."""
        return self.compute(*(source[:1].cpu() for source in self.sources)).flatten().tolist()


def _same(rows: Tensor) -> Tensor:
    return rows.unsqueeze(1) if rows.dim() == 1 else rows


def _vehicle_fields(model: Model, stage: float) -> list[StructField]:
    """Return the fields of the vehicle; ``stage`` [s] is the time between two evaluations of the rotor lag."""
    v = model.vehicle

    def decay(tau: Tensor) -> Tensor:
        return torch.exp(-stage / tau)

    def lag(tau: Tensor) -> Tensor:
        return tau.clamp_min(SHORTEST)

    def moment(position: Tensor, com: Tensor, axis: Tensor) -> Tensor:
        return torch.linalg.cross(position - com.unsqueeze(1), axis)

    fields = [
        StructField("mass_inverse", (v.mass,), lambda mass: 1.0 / mass.unsqueeze(1)),
        StructField("inertia", (v.inertia,), _same),
        StructField("inertia_inverse", (model.inertia_inverse,), _same),
        StructField("com", (v.com,), _same),
        StructField("thrust_map", (v.thrust_map,), _same),
        StructField("torque_map", (v.torque_map,), _same),
        StructField("rotor_axis", (v.rotor_axis,), _same),
        StructField("rotor_moment", (v.rotor_position, v.com, v.rotor_axis), moment),
        StructField("rotor_reaction", (v.rotor_spin, v.rotor_axis), lambda spin, axis: -spin.unsqueeze(-1) * axis),
    ]
    if v.plain:
        fields += [
            StructField("decay_up", (v.time_constant_up,), decay),
            StructField("decay_down", (v.time_constant_down,), decay),
        ]
    else:
        fields += [
            StructField("reverse_thrust_map", (v.reverse_thrust_map,), _same),
            StructField("reverse_torque_map", (v.reverse_torque_map,), _same),
            StructField("tau_up", (v.time_constant_up,), lag),
            StructField("tau_down", (v.time_constant_down,), lag),
            StructField("slew_up", (v.slew_rate,), lambda rate: rate.clamp_max(FASTEST)),
            StructField("slew_down", (v.slew_rate_down,), lambda rate: rate.clamp_max(FASTEST)),
            StructField("dead_band", (v.dead_band,), _same),
        ]
    if isinstance(model.ground_height, Tensor):
        fields.append(StructField("ground_height", (model.ground_height,), _same))
    if model.effects.step_effects or model.articulation is not None:
        fields += [
            StructField("rotor_lever", (v.rotor_position, v.com), lambda position, com: position - com.unsqueeze(1)),
            StructField("rotor_radius", (v.rotor_radius,), _same),
            StructField("battery", (v.battery,), _same),
            StructField("other_position", (model.other_position,), _same),
        ]
    return fields


def _law_fields(law: FusedLaw, followed: bool) -> list[StructField]:
    """Return the fields of the law whose tensors follow the vehicle of each environment, or all others."""

    def entry_picker(field: LawField) -> Callable[[Tensor], Tensor]:
        def pick(tensor: Tensor) -> Tensor:
            rows = _same(tensor).flatten(1)
            return torch.stack([rows[:, i] for i in field.entries], dim=1)

        return pick

    fields = (field for field in law.fields if (field.name in law.followed) == followed)
    return [StructField(field.name, (field.tensor,), entry_picker(field)) for field in fields]


@dataclass(frozen=True)
class Numbers:
    """All numbers of a model and a control law, by the struct that takes them."""

    vehicle: list[StructField]
    followed: list[StructField]  # Of the law, if their tensors follow the vehicle
    law: list[StructField]  # Of the law: all others
    effects: list[Tensor]  # Parameters (E, P) of the effects that act in a step, in the order of `forces`; packed


def collect_numbers(model: Model, law: FusedLaw, stage: float) -> Numbers:
    """Return all numbers; ``stage`` as for the fields of the vehicle."""
    effects = [params for _, params in model.effects.step_effects]
    return Numbers(_vehicle_fields(model, stage), _law_fields(law, True), _law_fields(law, False), effects)


SYMMETRIC = (0, 1, 2, 4, 5, 8)  # Independent entries of a symmetric 3 x 3 matrix


@dataclass(frozen=True)
class Packing:
    """The first row in the packed tensor (N, E) of each field that differs between environments."""

    vehicle: Mapping[str, int]
    entries: Mapping[str, tuple[int, ...]]  # Packed entries of partly packed fields of the vehicle
    twins: frozenset[str]  # Fields of the vehicle whose rows are those of an earlier field
    followed: Mapping[str, int]
    law: Mapping[str, int]
    vehicle_end: int  # First row after those of the vehicle
    law_start: int  # First row of `law`
    effects: int
    total: int  # N

    def fits(self, numbers: Numbers) -> bool:
        """Return whether the packed entries of each field still determine it."""
        return (
            self.entries.keys() <= find_independent_entries(numbers.vehicle).keys()
            and self.twins <= find_equal_fields(numbers.vehicle).keys()
        )


def make_packing(numbers: Numbers, *, all_packed: bool) -> Packing:
    """Return the rows of all numbers that differ between environments, or of all numbers with ``all_packed``."""
    first, few = 0, {} if all_packed else find_independent_entries(numbers.vehicle)
    twins = {} if all_packed else find_equal_fields(numbers.vehicle)

    def place(
        fields: list[StructField], few: Mapping[str, tuple[int, ...]], twins: Mapping[str, str]
    ) -> dict[str, int]:
        nonlocal first
        rows: dict[str, int] = {}
        for field in fields:
            if field.name in twins and not field.is_common:
                rows[field.name] = rows[twins[field.name]]
            elif all_packed or not field.is_common:
                rows[field.name] = first
                first += len(few.get(field.name, field.common_values()))
        return rows

    vehicle = place(numbers.vehicle, few, twins)
    vehicle_end = first
    followed = place(numbers.followed, {}, {})
    law_start = first
    law = place(numbers.law, {}, {})
    few = {name: entries for name, entries in few.items() if name in vehicle}
    written = frozenset(twins) & vehicle.keys()
    last = first + sum(params.shape[1] for params in numbers.effects)
    return Packing(vehicle, few, written, followed, law, vehicle_end, law_start, first, last)


def find_independent_entries(vehicle: list[StructField]) -> dict[str, tuple[int, ...]]:
    """Return the independent entries of fields: half of the inertia, and the squares of purely quadratic maps.

    Randomisation multiplies the map of a rotor by a factor, so zeros stay zero.
    """
    result = {"inertia": SYMMETRIC, "inertia_inverse": SYMMETRIC}
    for field in vehicle:
        if field.name in ("thrust_map", "torque_map") and is_pure_square(field):
            result[field.name] = tuple(range(2, len(field.common_values()), 3))
    return result


def find_equal_fields(vehicle: list[StructField]) -> dict[str, str]:
    """Return fields with the same sources and formula as an earlier field, each with the name of that field."""
    first: dict[tuple[object, ...], str] = {}
    result = {field.name: first.setdefault((field.compute, *map(id, field.sources)), field.name) for field in vehicle}
    return {name: other for name, other in result.items() if name != other}


def is_pure_square(field: StructField) -> bool:
    """Return whether a field of maps (E, R, 3) is purely quadratic in the speed."""
    rows = field.sources[0][..., :2]
    return not bool((rows[:1].cpu() if field.is_common else rows).any())


def pack_rows(packing: Packing, numbers: Numbers) -> list[Tensor]:
    """Return the packed numbers, each (E, n), in the order of their rows."""
    return [
        *vehicle_rows(packing, numbers),
        *rows_of_vehicle_followers(packing, numbers),
        *law_rows(packing, numbers),
        *numbers.effects,
    ]


def vehicle_rows(packing: Packing, numbers: Numbers) -> list[Tensor]:
    """Return the packed numbers of the vehicle."""
    packed = (field for field in numbers.vehicle if field.name in packing.vehicle and field.name not in packing.twins)
    return [field.rows(packing.entries.get(field.name)) for field in packed]


def rows_of_vehicle_followers(packing: Packing, numbers: Numbers) -> list[Tensor]:
    """Return the packed numbers of the law that follow the vehicle."""
    return [field.rows() for field in numbers.followed if field.name in packing.followed]


def law_rows(packing: Packing, numbers: Numbers) -> list[Tensor]:
    """Return the other packed numbers of the law."""
    return [field.rows() for field in numbers.law if field.name in packing.law]


def parameter_rows(packing: Packing, numbers: Numbers, *, followed: bool = False) -> tuple[Tensor, ...]:
    """Return the packed numbers of the vehicle, (E, n), and the parameters of the effects, (E, m), unless empty.

    With ``followed``, those of the law that follow the vehicle come after the vehicle's.
    """
    drawn = vehicle_rows(packing, numbers) + (rows_of_vehicle_followers(packing, numbers) if followed else [])
    return tuple(torch.cat(rows, dim=1) for rows in (drawn, numbers.effects) if rows)


def make_structs(packing: Packing, numbers: Numbers, law: FusedLaw, types: RotorTypes) -> list[Any]:
    """Return the structs of vehicle and law with their shared numbers; packed fields are zero."""
    return [
        _struct(types.vehicle, numbers.vehicle, packing.vehicle),
        _struct(law.struct, [*numbers.followed, *numbers.law], {**packing.followed, **packing.law}),
    ]


def _struct(struct_type: Any, fields: list[StructField], packed: Mapping[str, int]) -> Any:
    struct = struct_type()
    for field in fields:
        if field.name not in packed:
            value, numbers = getattr(struct, field.name), field.common_values()
            setattr(struct, field.name, numbers[0] if isinstance(value, (int, float)) else type(value)(*numbers))
    return struct


def rotor_types_of_model(model: Model) -> RotorTypes:
    """Return the types for the rotors of a model."""
    return rotor_types(model.vehicle.num_rotors, not model.vehicle.plain)


def num_parameters_and_memory(model: Model) -> tuple[int, int]:
    """Return the numbers of parameters and of remembered numbers of all effects."""
    places = model.effects.places(model.vehicle.num_rotors)
    return (places[-1].params.stop, places[-1].memory.stop) if places else (0, 0)


def effect_values_type(model: Model) -> Any:
    """Return the type of the vector of values of all effects."""
    return vector_type(max(sum(num_parameters_and_memory(model)), 1))
