"""The model of one environment in a kernel, as rows that the torch functions of the physics take.

Letters: E environments, R rotors, P parameters and M remembered numbers of an effect.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from types import SimpleNamespace
from typing import TYPE_CHECKING, cast

import torch
from torch import Tensor

from aerial_gym.physics.effects import Effect, EffectsByKind
from aerial_gym.physics.model import Model
from aerial_gym.physics.rotor_maps import RotorMap
from aerial_gym.physics.vehicle import Vehicle

if TYPE_CHECKING:
    from aerial_gym.physics.fused.packing import StructField

Acts = Callable[[Effect], bool] | None  # Condition for an effect to act; None: all act


class VehicleRows(SimpleNamespace):
    """``Vehicle`` with the fields of the kernel's struct, and the fields that follow from them."""

    traits: frozenset[str]
    rotor_map: RotorMap

    def __getattr__(self, name: str) -> Tensor:
        """Return a field that has another name in the struct.

        Raises:
            AttributeError: If a kernel does not have it.
        """
        fields = vars(self)
        other = {"slew_rate": "slew_up", "slew_rate_down": "slew_down"}.get(name, name.replace("time_constant", "tau"))
        if other not in fields:
            raise AttributeError(f"a kernel does not have vehicle.{name}. It has {', '.join(sorted(fields))}")
        return fields[other]

    @property
    def mass(self) -> Tensor:
        """Mass [kg], (E,)."""
        return 1.0 / self.mass_inverse

    @property
    def rotor_spin(self) -> Tensor:
        """+1 or -1: sense of rotation about the axis, (E, R)."""
        return -(self.rotor_reaction * self.rotor_axis).sum(-1)

    @property
    def rotor_position(self) -> Tensor:
        """Hubs from the body origin [m], body, (E, R, 3)."""
        return self.rotor_lever + self.com.unsqueeze(1)

    @property
    def num_rotors(self) -> int:
        """Number of rotors R."""
        return self.rotor_axis.shape[1]


def vehicle_rows(model: Model, plant: SimpleNamespace) -> Vehicle:
    """Return the vehicle of traced rows of the kernel's struct."""
    vehicle = model.vehicle
    return cast(Vehicle, VehicleRows(**vars(plant), traits=vehicle.traits, rotor_map=vehicle.rotor_map))


@dataclass(frozen=True)
class EffectValues:
    """Parameters and memory of one effect among those of all effects."""

    effect: Effect
    params: slice
    memory: slice

    def rows(self, values: Tensor) -> Tensor:
        """Return parameters and memory, (E, P + M)."""
        return torch.cat((values[:, self.params], values[:, self.memory]), dim=1)


def places_of_effect_values(model: Model) -> list[EffectValues]:
    """Return the places of the effects of a step among the values of all: first all parameters, then all memory."""
    places = model.effects.places(model.vehicle.num_rotors)
    first = places[-1].params.stop if places else 0
    return [EffectValues(p.effect, p.params, slice(first + p.memory.start, first + p.memory.stop)) for p in places]


def row_effects(model: Model, values: Tensor, acts: Acts = None) -> EffectsByKind:
    """Return the effects of a step with traced parameters and memory; memory that moves with the body is left out."""
    return EffectsByKind(
        (own.effect, values[:, own.params] if own.effect.moves_with_body else own.rows(values))
        for own in places_of_effect_values(model)
        if acts is None or acts(own.effect)
    )


def row_model(
    model: Model, plant: SimpleNamespace, values: Tensor, gravity: Tensor | float = 0.0, acts: Acts = None
) -> Model:
    """Return the model of traced rows: the kernel's struct of the vehicle, and the values of all effects."""
    own_ground = isinstance(model.ground_height, Tensor)
    rows = SimpleNamespace(
        vehicle=vehicle_rows(model, plant),
        inertia_inverse=plant.inertia_inverse,
        effects=row_effects(model, values, acts),
        gravity=gravity,
        ground_height=plant.ground_height.unsqueeze(-1) if own_ground else model.ground_height,
        ceiling_height=model.ceiling_height,
        other_position=plant.other_position,
    )
    return cast(Model, rows)


def constant_entries_of_vehicle(fields: "Sequence[StructField]") -> dict[str, Tensor]:
    """Return the entries of the vehicle's fields that are 0, 1 or -1 in all environments; others are not a number.

    Robots that differ in other numbers share a kernel.
    """
    result = {}
    for field in fields:
        if field.is_common and not field.name.startswith("decay"):
            row = torch.tensor(field.common_values())
            result[f"plant.{field.name}"] = torch.where((row == 0.0) | (row.abs() == 1.0), row, torch.nan)
    return result
