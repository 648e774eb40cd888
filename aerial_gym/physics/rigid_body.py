"""Newton-Euler equations of a multirotor about its centre of mass, and the specific force at its origin.

Pure functions of tensors. Frames: body is x forward, y left, z up; world is z up.
Letters: E environments, R rotors. Subscripts: o body origin, c centre of mass.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from math import nan

import torch
from torch import Tensor

from aerial_gym.errors import CapabilityError
from aerial_gym.math.quaternion import quat_rotate, quat_rotate_inverse, quat_to_matrix
from aerial_gym.math.rows import cross_product_matrix, dot, times
from aerial_gym.physics.effect_cache import EffectCache
from aerial_gym.physics.effects import (
    Condition,
    Effect,
    FluidEffect,
    LinearWrenchEffect,
    LoadEffect,
    RotorEffect,
    SuspensionMotion,
    WindEffect,
    WrenchEffect,
)
from aerial_gym.physics.effects.kinds import linear_wrench
from aerial_gym.physics.model import Model
from aerial_gym.physics.rotors import rotor_thrust, rotor_torque, rotor_wrench
from aerial_gym.physics.state import BodyState
from aerial_gym.physics.vehicle import Vehicle, is_same_row, is_shared, share_row


def multiply_rows(matrix: Tensor, vector: Tensor) -> Tensor:
    """Return ``A v`` row by row: (E, 3, 3) times (E, 3) gives (E, 3)."""
    if is_shared(matrix):
        return times(vector, matrix[0].T)
    return dot(matrix, vector.unsqueeze(-2))


def air_velocity(model: Model, position: Tensor, attitude: Tensor, com_vel: Tensor) -> Tensor:
    """Return the velocity of the centre of mass through the air [m/s], body, (E, 3): ``R^T (v_c - wind)``."""
    for effect, params in model.effects[WindEffect]:
        com_vel = com_vel - effect.wind(position, params)
    return quat_rotate_inverse(attitude, com_vel)


def body_wrench(
    model: Model, position: Tensor, attitude: Tensor, com_vel: Tensor, ang_vel: Tensor, rotor_speed: Tensor,
    rotor_acc: Tensor,
) -> tuple[Tensor, Tensor]:  # fmt: skip
    """Return the force without gravity [N] and the torque about the centre of mass [N m], body, each (E, 3).

    Args:
        position: Centre of mass [m], world, (E, 3).
        attitude: Body to world, xyzw, (E, 4).
        com_vel: Velocity of the centre of mass [m/s], world, (E, 3).
        ang_vel: Angular velocity [rad/s], body, (E, 3).
        rotor_speed: Rotor speeds [rad/s], (E, R).
        rotor_acc: Angular accelerations of the rotors [rad/s²], (E, R).
    """
    vehicle = model.vehicle
    if not any(model.effects[kind] for kind in (RotorEffect, WrenchEffect, FluidEffect)):
        thrust, drag = rotor_thrust(vehicle, rotor_speed), rotor_torque(vehicle, rotor_speed)
        return rotor_wrench(vehicle, thrust, drag)
    return _condition_wrench(
        model, condition_of_motion(model, position, attitude, com_vel, ang_vel, rotor_speed, rotor_acc)
    )


MOVES_OF_VEHICLE = ("com", "rotor_position", "rotor_axis")  # Fields that determine the motion in a condition
_THRUST_MAPS = ("thrust_map", "reverse_thrust_map")  # Further ones that determine a condition


def condition_in(model: Model, state: BodyState, rotor_acc: Tensor) -> Condition:
    """Return the condition of effects in a state, with rotor accelerations ``rotor_acc`` [rad/s²], (E, R).

    It depends on vehicle, wind and surroundings only, so models that differ in other effects share it. ``adapt_condition``
    adapts it to vehicles with equal ``MOVES_OF_VEHICLE``.
    """
    com, turn = model.vehicle.com, state.attitude
    position = state.position + quat_rotate(turn, com)
    com_vel = state.lin_vel + quat_rotate(turn, torch.linalg.cross(state.ang_vel, com))
    return condition_of_motion(model, position, turn, com_vel, state.ang_vel, state.rotor_speed, rotor_acc)


def condition_at_origin(model: Model, state: BodyState, rotor_acc: Tensor) -> Condition:
    """Return the condition of effects at hubs (``WrenchEffect.at_hubs``) with the body origin as centre of mass.

    The motion of the hubs is unchanged, so forces are too; torques are about the origin. Models that differ in their centre of
    mass share it, except for a wind that depends on position.
    """
    com, turn = model.vehicle.com, state.attitude
    result = condition_of_motion(
        model, state.position + quat_rotate(turn, com), turn, state.lin_vel, state.ang_vel, state.rotor_speed, rotor_acc
    )
    origin = share_row(torch.zeros_like(com[0]), com.shape[0])
    return replace(result, position=state.position, vehicle=replace(model.vehicle, com=origin))


def adapt_condition(vehicle: Vehicle, known: Condition) -> Condition:
    """Adapt a known condition to a vehicle with equal ``MOVES_OF_VEHICLE``."""
    maps = [(getattr(vehicle, name), getattr(known.vehicle, name)) for name in _THRUST_MAPS]
    same = all(is_shared(old) and is_same_row(new, old) for new, old in maps)
    return known.of_vehicle(vehicle, known.rotor_thrust if same else rotor_thrust(vehicle, known.rotor_speed))


def condition_of_motion(
    model: Model, position: Tensor, attitude: Tensor, com_vel: Tensor, ang_vel: Tensor, rotor_speed: Tensor,
    rotor_acc: Tensor,
) -> Condition:  # fmt: skip
    """Return the condition of effects; arguments as for ``body_wrench``."""
    return Condition(
        position=position,
        attitude=attitude,
        air_velocity=air_velocity(model, position, attitude, com_vel),
        ang_vel=ang_vel,
        rotor_speed=rotor_speed,
        rotor_thrust=rotor_thrust(model.vehicle, rotor_speed),
        rotor_acc=rotor_acc,
        ground_height=model.ground_height,
        ceiling_height=nan if model.ceiling_height is None else model.ceiling_height,
        other_position=model.other_position,
        vehicle=model.vehicle,
    )


@dataclass(frozen=True, kw_only=True)
class ForceBreakdown:
    """Contributions to force and torque on the body, without gravity."""

    thrust: Tensor  # Thrusts of the rotors without effects [N], (E, R)
    thrusts: list[tuple[str, Tensor]]  # Additional thrust by each effect on the rotors [N], (E, R)
    wrenches: list[tuple[str, Tensor]]  # Force [N] and torque [N m] of each effect on the whole, body, (E, 6)

    linear: list[tuple[str, Tensor, Tensor]] = field(default_factory=list)
    """Regressor (E, 6, P) and parameters (E, P) of each linear effect, with ``apart``."""

    @cached_property
    def whole_thrust(self) -> Tensor:
        """Return the thrusts including effects [N], (E, R)."""
        return sum((more for _, more in self.thrusts), self.thrust)


def force_breakdown(
    model: Model, condition: Condition, answers: EffectCache[Condition] | None = None, *, apart: bool = False,
    hubs: Condition | None = None,
) -> ForceBreakdown:  # fmt: skip
    """Return the contributions to the wrench in a condition, without fluid and load, which depend on their sum.

    Args:
        answers: Cached results of effects in this state.
        apart: Whether to return ``Acting.linear``.
        hubs: Condition of effects at hubs (``condition_at_origin``), whose torques are then about the body origin.
    """
    hubs = condition if hubs is None else hubs

    def evaluate(law: Callable[..., Tensor], source: Condition, *params: Tensor) -> Tensor:
        return law(source, *params) if answers is None else answers.ask(law, source, *params)

    more = [(effect.name, evaluate(effect.thrust, hubs, params)) for effect, params in model.effects[RotorEffect]]
    result = ForceBreakdown(thrust=hubs.rotor_thrust, thrusts=more, wrenches=[])
    condition, hubs = condition.with_thrust(result.whole_thrust), hubs.with_thrust(result.whole_thrust)
    for effect, params in model.effects[WrenchEffect]:
        seen = hubs if effect.at_hubs else condition
        if apart and isinstance(effect, LinearWrenchEffect):
            result.linear.append((effect.name, evaluate(effect.regressor, seen), params))
        else:
            result.wrenches.append((effect.name, evaluate(effect.wrench, seen, params)))
    return result


def add_fluid_contributions(model: Model, condition: Condition, acting: ForceBreakdown) -> ForceBreakdown:
    """Add the contributions of fluids with added mass, which depend on the sum of all others."""
    if not model.effects[FluidEffect]:
        return acting
    change = torch.cat(_total_wrench(model, condition, acting), dim=-1) - torch.cat(
        _sum_wrenches(model, condition, acting), dim=-1
    )
    return replace(acting, wrenches=[*acting.wrenches, ("fluids", change)])


def _condition_wrench(
    model: Model, condition: Condition, answers: EffectCache[Condition] | None = None
) -> tuple[Tensor, Tensor]:
    """Return the force without gravity [N] and the torque about the centre of mass [N m], body, each (E, 3)."""
    return _total_wrench(model, condition, force_breakdown(model, condition, answers))


def _total_wrench(model: Model, condition: Condition, acting: ForceBreakdown) -> tuple[Tensor, Tensor]:
    """Return total force [N] and torque [N m] with added mass, body, each (E, 3)."""
    force, torque = _sum_wrenches(model, condition, acting)
    for effect, params in model.effects[FluidEffect]:
        condition = condition.with_thrust(acting.whole_thrust)
        wrench = effect.wrench_with_fluid(torch.cat((force, torque), dim=-1), condition, model.gravity, params)
        force, torque = wrench[:, :3], wrench[:, 3:]
    return force, torque


def _sum_wrenches(model: Model, condition: Condition, acting: ForceBreakdown) -> tuple[Tensor, Tensor]:
    """Return the sum of forces [N] and torques [N m], body, each (E, 3)."""
    drag = rotor_torque(model.vehicle, condition.rotor_speed)
    force, torque = rotor_wrench(model.vehicle, acting.whole_thrust, drag)
    of_linear = (linear_wrench(regressor, params) for _, regressor, params in acting.linear)
    for wrench in (*(wrench for _, wrench in acting.wrenches), *of_linear):
        force, torque = force + wrench[:, :3], torque + wrench[:, 3:]
    return force, torque


def angular_acceleration(model: Model, ang_vel: Tensor, torque: Tensor) -> Tensor:
    """Return ``J^-1 (tau - w x J w)`` [rad/s²], body, (E, 3): Euler's equation about the centre of mass."""
    momentum = multiply_rows(model.vehicle.inertia, ang_vel)
    return multiply_rows(model.inertia_inverse, torque - torch.linalg.cross(ang_vel, momentum))


def com_acceleration(model: Model, attitude: Tensor, force: Tensor) -> Tensor:
    """Return ``R f / m + g`` [m/s²], world, (E, 3): Newton's equation of the centre of mass."""
    ax, ay, az = quat_rotate(attitude, force / model.vehicle.mass.unsqueeze(-1)).unbind(-1)
    return torch.stack((ax, ay, az - model.gravity), dim=-1)


def with_load(
    model: Model, attitude: Tensor, ang_vel: Tensor, load: Tensor, acc: Tensor, ang_acc: Tensor
) -> tuple[Tensor, Tensor, Tensor]:
    """Return the accelerations of a vehicle with its load, and n'' of the load [1/s²], each (E, 3).

    Args:
        model: Vehicle and effects; without a load the accelerations are returned with an empty n'' (E, 0).
        attitude: Body to world, xyzw, (E, 4).
        ang_vel: Angular velocity [rad/s], body, (E, 3).
        load: Direction n of the link and its rate n' [1/s], world, (E, 6).
        acc: Acceleration of the centre of mass without the load [m/s²], world, (E, 3).
        ang_acc: Angular acceleration without it [rad/s²], body, (E, 3).
    """
    if not model.effects[LoadEffect]:
        return acc, ang_acc, load[:, :0]
    force, torque, swing = pull_of_load(model, attitude, ang_vel, load, acc, ang_acc)
    acc = acc + force_without_fluid(model, attitude, force) / model.vehicle.mass.unsqueeze(-1)
    return acc, ang_acc + multiply_rows(model.inertia_inverse, torque), swing


def force_without_fluid(model: Model, attitude: Tensor, force: Tensor) -> Tensor:
    """Return the force [N], world, (E, 3), that gives the hull without fluid the acceleration under ``force`` with fluid."""
    if not model.effects[FluidEffect]:
        return force
    mass = model.vehicle.mass.unsqueeze(-1)
    share = mass / (mass + _added_mass(model))
    return quat_rotate(attitude, share * quat_rotate_inverse(attitude, force))


def _added_mass(model: Model) -> Tensor:
    """Return the added mass along each body axis [kg], (E, 3)."""
    added = torch.zeros_like(model.vehicle.com)
    for effect, params in model.effects[FluidEffect]:
        added = added + effect.added_mass(params)
    return added


def pull_of_load(
    model: Model, attitude: Tensor, ang_vel: Tensor, load: Tensor, acc: Tensor, ang_acc: Tensor
) -> tuple[Tensor, Tensor, Tensor]:
    """Return force and torque of a load on its vehicle; arguments as for ``with_load``, of a model with a load.

    Returns:
        Force [N], world, its torque about the centre of mass [N m], body, and n'' of the load [1/s²], each (E, 3).

    Source:
        Derived: a force F at the origin o, at r = -c from the centre of mass, gives ``a_o = a + (1/m - [r] J^-1 [r]) F``.
    """
    turning = lever_acceleration(ang_vel, ang_acc, -model.vehicle.com)
    origin = torch.zeros_like(model.vehicle.com)
    suspension = load_suspension(model, attitude, acc + quat_rotate(attitude, turning), origin)
    return suspension_pull(model, attitude, suspension, load, origin)


def lever_acceleration(ang_vel: Tensor, ang_acc: Tensor, lever: Tensor) -> Tensor:
    """Return ``alpha x r + w x (w x r)`` [m/s²], (E, 3): acceleration of a point r [m] beside another one of a rigid body."""
    return torch.linalg.cross(ang_acc, lever) + torch.linalg.cross(ang_vel, torch.linalg.cross(ang_vel, lever))


def load_suspension(model: Model, attitude: Tensor, acceleration: Tensor, place: Tensor) -> SuspensionMotion:
    """Return the suspension of a load at a ``place`` [m], body, whose ``acceleration`` without it [m/s²], world, is given."""
    cross = cross_product_matrix(place - model.vehicle.com)
    mobility = -cross @ model.inertia_inverse @ cross
    mobility = mobility + torch.diag_embed(1.0 / (model.vehicle.mass.unsqueeze(-1) + _added_mass(model)))
    rotation = quat_to_matrix(attitude)
    return SuspensionMotion(
        acceleration=acceleration, mobility=rotation @ mobility @ rotation.mT, gravity=model.gravity
    )


def suspension_pull(
    model: Model, attitude: Tensor, suspension: SuspensionMotion, load: Tensor, place: Tensor
) -> tuple[Tensor, Tensor, Tensor]:
    """Return force, torque and n'' of a load on a suspension at a ``place`` [m], body, (E, 3), as ``pull_of_load``."""
    ((effect, params),) = model.effects[LoadEffect]
    force, swing = effect.pull(suspension, load, params)
    return force, torch.linalg.cross(place - model.vehicle.com, quat_rotate_inverse(attitude, force)), swing


def append_memory_to_params(model: Model, remembered: Mapping[str, Tensor]) -> Model:
    """Return the model with the effects' memory appended to their parameters."""

    def append_memory(effect: Effect, params: Tensor) -> Tensor:
        return torch.cat((params, remembered[effect.name]), dim=-1) if effect.name in remembered else params

    return replace(model, effects=model.effects.with_params(append_memory))


@dataclass(frozen=True, kw_only=True)
class Accelerations:
    """Ideal measurements of inertial sensors at the body origin."""

    specific_force: Tensor  # Specific force at the body origin [m/s²], body, (E, 3): +g on z at hover
    ang_acc: Tensor  # Angular acceleration [rad/s²], body, (E, 3)


def accelerations(
    model: Model, state: BodyState, rotor_acc: Tensor | None = None, *, load: Tensor | None = None,
    remembered: Mapping[str, Tensor] | None = None, condition: Condition | None = None,
    answers: EffectCache[Condition] | None = None,
) -> Accelerations:  # fmt: skip
    """Return the readings of ideal inertial sensors at the body origin in a state; each row may be a moment of a flight log.

    ``rotor_acc`` are the angular accelerations of the rotors [rad/s²], (E, R), 0 by default. ``load`` is direction and rate of
    a load's link, world, (E, 6). ``remembered`` is the memory of effects on wind, rotors or the body, by name, (E, M).
    ``condition`` is that of ``condition_in`` for this state, if known from a model with the same vehicle and wind. ``answers``
    are cached results of effects in this state.

    ``f_o = F / m - alpha x c - w x (w x c)`` with c from the origin to the centre of mass.

    Raises:
        CapabilityError: If an effect has memory that is not given.

    Source:
        Derived: acceleration of two points of a rigid body, ``a_c = a_o + alpha x c + w x (w x c)``.
    """
    if remembered:
        model = append_memory_to_params(model, remembered)
    told = {*(remembered or ()), *(effect.name for effect, _ in model.effects[LoadEffect] if load is not None)}
    for effect, _ in model.effects.step_effects:
        if effect.accelerates and effect.remembers and effect.name not in told:
            raise CapabilityError(
                f"effect {effect.name}: has memory, so one state does not determine its force. Fly it with a backend instead"
            )
    com, ang_vel = model.vehicle.com, state.ang_vel
    if condition is None:
        spin_up = torch.zeros_like(state.rotor_speed) if rotor_acc is None else rotor_acc
        condition = condition_in(model, state, spin_up)
    force, torque = _condition_wrench(model, condition, answers)
    ang_acc = angular_acceleration(model, ang_vel, torque)
    felt = force / model.vehicle.mass.unsqueeze(-1)
    if load is not None:
        alone = com_acceleration(model, state.attitude, force)
        acc, ang_acc, _ = with_load(model, state.attitude, ang_vel, load, alone, ang_acc)
        felt = felt + quat_rotate_inverse(state.attitude, acc - alone)
    lever = lever_acceleration(ang_vel, ang_acc, com)
    return Accelerations(specific_force=felt - lever, ang_acc=ang_acc)
