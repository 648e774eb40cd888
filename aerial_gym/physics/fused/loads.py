"""Loads on one environment from its rotors and the chosen effects, composed as Warp functions.

Letters: R rotors, P parameters of the effects.
"""

from collections.abc import Callable
from typing import Any

import warp as wp
from torch import Tensor

from aerial_gym.math.warp_functions import rotate_inverse, world_up
from aerial_gym.physics.effects import Effect, FluidEffect, RotorEffect, WindEffect, WrenchEffect
from aerial_gym.physics.fused.packing import value_access, values_type
from aerial_gym.physics.fused.types import Hub, rotor_types
from aerial_gym.physics.model import Model
from aerial_gym.physics.rotor_maps import make_maps

NO_CEILING = 1e30
"""Height of the ceiling if there is none [m]: finite in float32."""


def _sum_of_rotors(terms: list[tuple[wp.Function, wp.Function]], condition: Any, params: Any) -> wp.Function:
    """Return the sum of rotor effects as one function, (condition, hub, parameters of all effects) -> thrust."""

    @wp.func
    def no_term(at: condition, hub: Hub, all_params: params) -> float:
        return 0.0

    def plus(rest: wp.Function, effect: wp.Function, pick: wp.Function) -> wp.Function:
        @wp.func
        def term(at: condition, hub: Hub, all_params: params) -> float:
            return rest(at, hub, all_params) + effect(at, hub, pick(all_params))

        return term

    total = no_term
    for effect, pick in terms:
        total = plus(total, effect, pick)
    return total


def _sum_effects(terms: list[tuple[wp.Function, wp.Function]], argument: Any, params: Any, result: Any) -> wp.Function:
    """Return the sum of effects as one function, (argument, parameters of all effects) -> result.

    Effects are chained through closures. A loop over ``wp.static(functions[i])`` would be shorter, but Warp 1.19 leaves
    such functions out of a kernel's hash, and so takes the cached kernel of another effect.
    """

    @wp.func
    def no_term(at: argument, all_params: params) -> result:
        return result()

    def plus(rest: wp.Function, effect: wp.Function, pick: wp.Function) -> wp.Function:
        @wp.func
        def term(at: argument, all_params: params) -> result:
            return rest(at, all_params) + effect(at, pick(all_params))

        return term

    total = no_term
    for effect, pick in terms:
        total = plus(total, effect, pick)
    return total


def _make_hub(num_rotors: int, general: bool, upright: bool) -> wp.Function:
    """Return a function to the ``Hub`` of one rotor. (A struct assigned in a loop would have a wrong adjoint.)"""
    types = rotor_types(num_rotors, general)
    vehicle_type, condition_type = types.vehicle, types.condition

    @wp.func
    def hub_state(
        vehicle: vehicle_type, at: condition_type, i: int, thrust: float, ground: float, ceiling: float
    ) -> Hub:
        lever = wp.vec3(vehicle.rotor_lever[i, 0], vehicle.rotor_lever[i, 1], vehicle.rotor_lever[i, 2])
        hub = Hub()
        hub.speed = at.rotor_speed[i]
        hub.thrust = thrust
        hub.radius = vehicle.rotor_radius[i]
        hub.velocity = at.air_velocity + wp.cross(at.ang_vel, lever)
        if wp.static(upright):
            hub.axis = wp.vec3(0.0, 0.0, 1.0)
            axis_height = at.up[2]
            hub.axial = hub.velocity[2]
            hub.edgewise = wp.vec3(hub.velocity[0], hub.velocity[1], 0.0)
        else:
            hub.axis = wp.vec3(vehicle.rotor_axis[i, 0], vehicle.rotor_axis[i, 1], vehicle.rotor_axis[i, 2])
            axis_height = wp.dot(at.up, hub.axis)
            hub.axial = wp.dot(hub.velocity, hub.axis)
            hub.edgewise = hub.velocity - hub.axial * hub.axis
        altitude = at.position[2] + wp.dot(at.up, lever)
        wake_goes_up = thrust * axis_height < 0.0
        hub.wake_room = wp.where(wake_goes_up, ceiling - altitude, altitude - ground)
        hub.inlet_room = wp.where(wake_goes_up, altitude - ground, ceiling - altitude)
        return hub

    return hub_state


Acts = Callable[[Effect], bool] | None
"""Condition for an effect to act; None: all act."""


def _select_effects(model: Model, kind: type[Effect], acts: Acts) -> list[tuple[Any, wp.Function]]:
    """Return the acting effects of a kind, each with the function to its values."""
    return [(effect, pick.get) for effect, pick in value_access(model, kind) if acts is None or acts(effect)]


def make_wind(model: Model, acts: Acts = None) -> wp.Function:
    """Return the function (position [m], world, values of all effects) -> velocity of the air [m/s], world."""
    winds = [(effect.warp_wind(), get) for effect, get in _select_effects(model, WindEffect, acts)]
    return _sum_effects(winds, wp.vec3, values_type(model), wp.vec3)


def make_loads(model: Model, *, upright: bool, num_rotors: int | None = None, acts: Acts = None) -> wp.Function:
    """Return the Warp twin of ``rigid_body.force_breakdown`` for one environment.

    Results: thrusts [N] and drag torques [N m] of the rotors; force [N] and torque about the centre of mass [N m] of the
    effects, body; the condition of the effects.

    Args:
        model: With all effects whose values the function takes.
        upright: Whether all rotors thrust along body z. Components that are then zero are not computed, and have no gradient.
        num_rotors: Number of rotors of the vehicle that the function takes; that of the model if not given.
        acts: Condition for an effect to act; all act if not given.
    """
    num_rotors, general = model.vehicle.num_rotors if num_rotors is None else num_rotors, not model.vehicle.plain
    types = rotor_types(num_rotors, general)
    thrust_of, torque_of = make_maps(types.vehicle)
    params_type, wind = values_type(model), make_wind(model, acts)
    rotors = [(one.warp_thrust(types.condition, Hub), get) for one, get in _select_effects(model, RotorEffect, acts)]
    wrenches = [(one.warp_wrench(types.condition), get) for one, get in _select_effects(model, WrenchEffect, acts)]
    any_rotor, any_wrench, any_fluid = bool(rotors), bool(wrenches), bool(_select_effects(model, FluidEffect, acts))
    gain = _sum_of_rotors(rotors, types.condition, params_type)
    wrench = _sum_effects(wrenches, types.condition, params_type, wp.spatial_vector)
    vehicle_type, vector, condition_type = types.vehicle, types.vector, types.condition
    own_ground, hub_at = isinstance(model.ground_height, Tensor), _make_hub(num_rotors, general, upright)
    ground_height = 0.0 if isinstance(model.ground_height, Tensor) else model.ground_height
    ceiling_height = NO_CEILING if model.ceiling_height is None else model.ceiling_height

    @wp.func
    def loads(
        vehicle: vehicle_type,
        params: params_type,
        position: wp.vec3,
        attitude: wp.quat,
        lin_vel: wp.vec3,
        ang_vel: wp.vec3,
        rotor_speed: vector,
        rotor_acc: vector,
    ):
        more = wp.spatial_vector()
        at = condition_type()
        thrusts = vector()
        drags = vector()
        ground = float(wp.static(ground_height))
        if wp.static(own_ground):
            ground = vehicle.ground_height
        ceiling = float(wp.static(ceiling_height))
        if wp.static(any_rotor or any_wrench or any_fluid):
            at.position = position
            at.attitude = attitude
            at.up = world_up(attitude)
            at.air_velocity = rotate_inverse(attitude, lin_vel - wind(position, params))
            at.ang_vel = ang_vel
            at.rotor_speed = rotor_speed
            at.rotor_acc = rotor_acc
            at.upright = wp.static(upright)
            at.rotor_axis = vehicle.rotor_axis
            at.rotor_reaction = vehicle.rotor_reaction
            at.lever = vehicle.rotor_lever
            at.rotor_radius = vehicle.rotor_radius
            at.com = vehicle.com
            at.other_position = vehicle.other_position
        for i in range(wp.static(num_rotors)):
            n = rotor_speed[i]
            thrust = thrust_of(vehicle, i, n)
            if wp.static(any_rotor):
                thrust = thrust + gain(at, hub_at(vehicle, at, i, thrust, ground, ceiling), params)
            thrusts[i] = thrust
            drags[i] = torque_of(vehicle, i, n)
        if wp.static(any_wrench):
            at.rotor_thrust = thrusts
            at.rotor_drag = drags
            more = wrench(at, params)
        return thrusts, drags, more, at

    return loads
