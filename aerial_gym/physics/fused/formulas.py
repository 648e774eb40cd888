"""Warp functions of the equations of motion and of the effects, traced from the torch functions of ``physics``.

All functions are for one environment. ``plant`` is the kernel's struct of the vehicle, ``values`` the vector of parameters and
memory of all effects.
Letters: R rotors.

The model of one environment in a kernel, as rows that the torch functions of the physics take.

Letters: E environments, R rotors, P parameters and M remembered numbers of an effect.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from types import SimpleNamespace
from typing import TYPE_CHECKING, Any, cast

import torch
import warp as wp
from torch import Tensor

from aerial_gym.math.quaternion import quat_rotate
from aerial_gym.physics import effects, rigid_body
from aerial_gym.physics.fused.packing import effect_values_type, rotor_types_of_model
from aerial_gym.physics.fused.torch_trace import trace_to_warp
from aerial_gym.physics.integrators import MassState, coast, wrench_of_coast
from aerial_gym.physics.model import Model
from aerial_gym.physics.rotor_maps import RotorMap
from aerial_gym.physics.vehicle import Vehicle

if TYPE_CHECKING:
    from aerial_gym.physics.fused.packing import StructField


Acts = Callable[[effects.Effect], bool] | None  # Condition for an effect to act; None: all act


class VehicleRows(SimpleNamespace):
    """``Vehicle`` with the fields of the kernel's struct, and the fields that follow from them."""

    traits: frozenset[str]
    rotor_map: RotorMap

    def __getattr__(self, name: str) -> Tensor:
        """Return a field that has another name in the struct; raise ``AttributeError`` if a kernel does not have it."""
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

    effect: effects.Effect
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


def row_effects(model: Model, values: Tensor, acts: Acts = None) -> effects.EffectsByKind:
    """Return the effects of a step with traced parameters and memory; memory that moves with the body is left out."""
    return effects.EffectsByKind(
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


Constants = Mapping[str, Tensor]  # Known numbers of the vehicle (`row_model.constant_entries_of_vehicle`)

_MOTION = {"position": wp.vec3, "attitude": wp.quat, "lin_vel": wp.vec3, "ang_vel": wp.vec3}
"""Motion of the centre of mass, and its types."""


def make_accelerations(model: Model, constants: Constants) -> wp.Function:
    """Return the function of linear [m/s², world] and angular acceleration [rad/s², body], and the load's rate of change.

    Arguments: plant, values, gravity, motion, rotor speeds and accelerations, load.
    """
    types = rotor_types_of_model(model)

    def accelerations(
        plant: SimpleNamespace, values: Tensor, gravity: Tensor, position: Tensor, attitude: Tensor, lin_vel: Tensor,
        ang_vel: Tensor, rotor_speed: Tensor, rotor_acc: Tensor, load: Tensor,
    ) -> tuple[Tensor, Tensor, Tensor]:  # fmt: skip
        own = row_model(model, plant, values, gravity)
        motion = position, attitude, lin_vel, ang_vel, rotor_speed, rotor_acc
        force, torque = rigid_body.body_wrench(own, *motion)
        acc = rigid_body.com_acceleration(own, attitude, force)
        ang_acc = rigid_body.angular_acceleration(own, ang_vel, torque)
        acc, ang_acc, swing = rigid_body.with_load(own, attitude, ang_vel, load, acc, ang_acc)
        rate = torch.cat((load[:, 3:], swing), dim=1) if swing.shape[1] else torch.zeros_like(load)
        return acc, ang_acc, rate

    arguments = {"plant": types.vehicle, "values": effect_values_type(model), "gravity": float, **_MOTION}
    arguments |= {"rotor_speed": types.vector, "rotor_acc": types.vector, "load": wp.spatial_vector}
    returns = wp.vec3, wp.vec3, wp.spatial_vector
    return trace_to_warp("accelerations", arguments, accelerations, returns, constants=constants, shared=["gravity"])


def make_loads(model: Model, constants: Constants, acts: Acts = None) -> wp.Function:
    """Return the function of thrusts [N] and drag torques [N m] of the rotors, and of the wrench of the effects, body.

    Arguments: plant, values, motion, rotor speeds and accelerations.

    Args:
        acts: Condition for an effect to act; all act if not given.
    """
    types = rotor_types_of_model(model)

    def loads(
        plant: SimpleNamespace, values: Tensor, rotor_speed: Tensor, rotor_acc: Tensor, **motion: Tensor
    ) -> tuple[Tensor, Tensor, Tensor]:
        condition, acting = _breakdown(row_model(model, plant, values, acts=acts), motion, rotor_speed, rotor_acc)
        return acting.whole_thrust, condition.rotor_drag_torque, _sum_wrenches(acting)

    arguments = {"plant": types.vehicle, "values": effect_values_type(model), **_MOTION}
    arguments |= {"rotor_speed": types.vector, "rotor_acc": types.vector}
    returns = types.vector, types.vector, wp.spatial_vector
    return trace_to_warp("loads", arguments, loads, returns, constants=constants)


def make_hub_loads(model: Model, constants: Constants, rotors: Sequence[int], origin: Tensor) -> wp.Function:
    """Return the function of thrusts [N] and the wrench of effects at the hubs of some rotors about the origin of their link.

    Arguments: plant, values, static thrusts of all rotors, motion of the link, speeds and accelerations of all rotors.

    Args:
        rotors: Indices of the rotors of the link.
        origin: Origin of the link from that of the body in the reference pose [m], (3,).
    """
    types = rotor_types_of_model(model)

    def some(rows: Tensor) -> Tensor:
        return torch.stack([rows[:, rotor] for rotor in rotors], dim=1)

    def hub_loads(
        plant: SimpleNamespace, values: Tensor, thrusts: Tensor, rotor_speed: Tensor, rotor_acc: Tensor,
        **motion: Tensor,
    ) -> tuple[Tensor, Tensor]:  # fmt: skip
        fields = {name: some(rows) for name, rows in vars(plant).items() if name.startswith(_ROTOR_FIELDS)}
        fields |= {"rotor_lever": some(plant.rotor_lever) + (plant.com - origin).unsqueeze(1), "com": 0.0 * plant.com}
        link = SimpleNamespace(**(vars(plant) | fields))
        own = row_model(model, link, values, acts=lambda effect: effect.at_hubs)
        _, acting = _breakdown(own, motion, some(rotor_speed), some(rotor_acc))
        columns = dict(enumerate(thrusts.unbind(1))) | dict(zip(rotors, acting.whole_thrust.unbind(1), strict=True))
        return torch.stack(list(columns.values()), dim=1), _sum_wrenches(acting)

    arguments = {"plant": types.vehicle, "values": effect_values_type(model), "thrusts": types.vector, **_MOTION}
    arguments |= {"rotor_speed": types.vector, "rotor_acc": types.vector}
    returns = types.vector, wp.spatial_vector
    return trace_to_warp("hub_loads", arguments, hub_loads, returns, constants=constants)


_ROTOR_FIELDS = ("rotor_", "thrust_map", "torque_map", "reverse_")  # Beginnings of fields with a rotor dimension


def _breakdown(
    model: Model, motion: Mapping[str, Tensor], rotor_speed: Tensor, rotor_acc: Tensor
) -> tuple[effects.Condition, rigid_body.ForceBreakdown]:
    condition = rigid_body.condition_of_motion(model, *motion.values(), rotor_speed, rotor_acc)
    return condition, rigid_body.force_breakdown(model, condition)


def _sum_wrenches(acting: rigid_body.ForceBreakdown) -> Tensor:
    none = torch.zeros_like(acting.thrust[:, :1]).expand(-1, 6)
    return sum((more for _, more in acting.wrenches), none)


def make_wind(model: Model, acts: Acts = None) -> wp.Function:
    """Return the function (position [m], world, values) -> velocity of the air [m/s], world."""

    def wind(position: Tensor, values: Tensor) -> Tensor:
        velocity = torch.zeros_like(position)
        for effect, own in row_effects(model, values, acts)[effects.WindEffect]:
            velocity = velocity + effect.wind(position, own)
        return velocity

    return trace_to_warp(
        "wind", {"position": wp.vec3, "values": effect_values_type(model)}, wind, [wp.vec3], constants={}
    )


def make_force_free_motion(model: Model, constants: Constants) -> tuple[wp.Function, wp.Function]:
    """Return ``integrators.coast`` without a load, and the accelerations [m/s², world, rad/s², body] of that motion.

    Arguments: plant, values, motion; of the first also the time [s].
    """
    arguments = {"plant": rotor_types_of_model(model).vehicle, "values": effect_values_type(model), **_MOTION}

    def state(own: Model, motion: tuple[Tensor, ...]) -> MassState:
        position, attitude, lin_vel, ang_vel = motion
        none = position[:, :0]
        return MassState(
            position=position, attitude=attitude, lin_vel=lin_vel, ang_vel=ang_vel, rotor_speed=none, load=none
        )

    def coast_freely(plant: SimpleNamespace, values: Tensor, dt: Any, **motion: Tensor) -> tuple[Tensor, ...]:
        own = row_model(model, plant, values)
        after = coast(own, state(own, tuple(motion.values())), dt)
        return after.position, after.attitude, after.lin_vel, after.ang_vel

    def free(plant: SimpleNamespace, values: Tensor, **motion: Tensor) -> tuple[Tensor, Tensor]:
        own = row_model(model, plant, values)
        force, torque = wrench_of_coast(own, state(own, tuple(motion.values())))
        acc = quat_rotate(motion["attitude"], force / own.vehicle.mass.unsqueeze(-1))
        return acc, rigid_body.multiply_rows(own.inertia_inverse, torque)

    moved = trace_to_warp(
        "coast", {**arguments, "dt": float}, coast_freely, list(_MOTION.values()), constants=constants, shared=["dt"]
    )
    return moved, trace_to_warp("free_accelerations", arguments, free, [wp.vec3, wp.vec3], constants=constants)


def make_memory_update(model: Model) -> wp.Function:
    """Return all ``Effect.remember`` as one function (plant, moment, values) -> values with the new memory."""
    types, kind = rotor_types_of_model(model), effect_values_type(model)

    def remember(plant: SimpleNamespace, now: SimpleNamespace, values: Tensor) -> Tensor:
        moment = effects.SubstepStart(**vars(now), vehicle=vehicle_rows(model, plant))
        places = places_of_effect_values(model)
        memory = [own.effect.remember(moment.of_effect(own.effect), own.rows(values)) for own in places]
        return torch.cat((values[:, : places[-1].params.stop], *memory), dim=1)

    arguments = {"plant": types.vehicle, "now": types.moment, "values": kind}
    return trace_to_warp("remember", arguments, remember, [kind], constants={}, shared=["now.dt"])


def make_command_effects(model: Model) -> wp.Function:
    """Return all ``CommandEffect.command`` as one function (plant, values, command) -> command."""
    types = rotor_types_of_model(model)

    def lead(plant: SimpleNamespace, values: Tensor, command: Tensor) -> Tensor:
        vehicle = vehicle_rows(model, plant)
        for effect, own in row_effects(model, values)[effects.CommandEffect]:
            command = effect.command(command, vehicle, own)
        return command

    arguments = {"plant": types.vehicle, "values": effect_values_type(model), "command": types.vector}
    return trace_to_warp("lead", arguments, lead, [types.vector], constants={})


def make_delay(model: Model) -> wp.Function:
    """Return the function from values to the delay of commands [s]."""

    def delay(values: Tensor) -> Tensor:
        ((effect, own),) = row_effects(model, values)[effects.DelayEffect]
        return effect.delay(own)

    return trace_to_warp("delay", {"values": effect_values_type(model)}, delay, [float], constants={})


def make_pull(effect: effects.LoadEffect, suspension: Any, load: Any, vector: Any, params: Any) -> wp.Function:
    """Return ``effect.pull`` as a function (suspension, load, parameters) -> force and n''.

    Args:
        effect: The load.
        suspension: The ``wp.struct`` with the fields of ``SuspensionMotion``.
        load: Type of direction and rate of the link.
        vector: Type of the results.
        params: Type of the parameters.
    """

    def pull(at: SimpleNamespace, load: Tensor, params: Tensor) -> tuple[Tensor, Tensor]:
        return effect.pull(effects.SuspensionMotion(**vars(at)), load, params)

    arguments = {"at": suspension, "load": load, "params": params}
    return trace_to_warp("pull", arguments, pull, [vector, vector], constants={}, shared=["at.gravity"])
