"""Forces and steppers of one environment, composed from the chosen effects as Warp functions.

Letters: R rotors, P parameters of the effects.
"""

from typing import Any

import warp as wp
from torch import Tensor

from aerial_gym.physics.effects import (
    DelayEffect,
    Effect,
    FluidEffect,
    LoadEffect,
    RotorEffect,
    WindEffect,
    WrenchEffect,
)
from aerial_gym.physics.fused.functions import (
    angular_acceleration,
    attitude_rate,
    rotate,
    rotate_inverse,
    rotation_matrix,
    small_turn,
    unit_quat,
)
from aerial_gym.physics.fused.packing import pickers, values_type
from aerial_gym.physics.fused.rotors import make_follow, make_maps, make_stage_rates
from aerial_gym.physics.fused.types import Hub, Suspension, rotor_types
from aerial_gym.physics.model import Model

STAGES = {"euler": 1.0, "rk4": 0.5}
"""Part of a step over which a stepper follows the rotors at once."""

NO_CEILING = 1e30
"""Height in its place [m]: far above all others, and finite in float32."""


def _sum_of_rotors(terms: list[tuple[wp.Function, wp.Function]], condition: Any, params: Any) -> wp.Function:
    """Return the sum of rotor effects as one function, (condition, hub, parameters of all effects) -> thrust."""

    @wp.func
    def nothing(at: condition, hub: Hub, all_params: params) -> float:
        return 0.0

    def plus(rest: wp.Function, effect: wp.Function, pick: wp.Function) -> wp.Function:
        @wp.func
        def term(at: condition, hub: Hub, all_params: params) -> float:
            return rest(at, hub, all_params) + effect(at, hub, pick(all_params))

        return term

    total = nothing
    for effect, pick in terms:
        total = plus(total, effect, pick)
    return total


def _sum_of(terms: list[tuple[wp.Function, wp.Function]], argument: Any, params: Any, result: Any) -> wp.Function:
    """Return the sum of effects as one function, (argument, parameters of all effects) -> result.

    Effects are chained through closures. A loop over ``wp.static(functions[i])`` would be shorter, but Warp 1.19 leaves
    such functions out of a kernel's hash, and so takes the cached kernel of another effect.
    """

    @wp.func
    def nothing(at: argument, all_params: params) -> result:
        return result()

    def plus(rest: wp.Function, effect: wp.Function, pick: wp.Function) -> wp.Function:
        @wp.func
        def term(at: argument, all_params: params) -> result:
            return rest(at, all_params) + effect(at, pick(all_params))

        return term

    total = nothing
    for effect, pick in terms:
        total = plus(total, effect, pick)
    return total


def _make_hub_at(num_rotors: int, general: bool) -> wp.Function:
    """Return a function to what one rotor feels. (A struct written anew in a loop would have a wrong adjoint.)"""
    types = rotor_types(num_rotors, general)
    vehicle_type, condition_type = types.vehicle, types.condition

    @wp.func
    def hub_at(vehicle: vehicle_type, at: condition_type, i: int, thrust: float, ground: float, ceiling: float) -> Hub:
        lever = wp.vec3(vehicle.rotor_lever[i, 0], vehicle.rotor_lever[i, 1], vehicle.rotor_lever[i, 2])
        hub = Hub()
        hub.speed = at.rotor_speed[i]
        hub.thrust = thrust
        hub.radius = vehicle.rotor_radius[i]
        altitude = at.position[2] + rotate(at.attitude, lever)[2]
        hub.axis = wp.vec3(vehicle.rotor_axis[i, 0], vehicle.rotor_axis[i, 1], vehicle.rotor_axis[i, 2])
        wake_goes_up = thrust * rotate(at.attitude, hub.axis)[2] < 0.0
        hub.wake_room = wp.where(wake_goes_up, ceiling - altitude, altitude - ground)
        hub.inlet_room = wp.where(wake_goes_up, altitude - ground, ceiling - altitude)
        hub.velocity = at.air_velocity + wp.cross(at.ang_vel, lever)
        return hub

    return hub_at


def make_loads(model: Model) -> wp.Function:
    """Return a function to thrusts [N] and drag torques [N m] of the rotors, force and torque of the effects on the whole about
    the centre of mass, body, and the condition that they saw: ``rigid_body.loads_in`` for one environment."""
    num_rotors, general = model.vehicle.num_rotors, not model.vehicle.plain
    types = rotor_types(num_rotors, general)
    thrust_of, torque_of = make_maps(types.vehicle)
    params_type, picks = values_type(model), pickers(model)

    def with_picks(kind: type[Effect], twins: list[wp.Function]) -> list[tuple[wp.Function, wp.Function]]:
        return [(twin, pick.get) for twin, pick in zip(twins, picks[kind], strict=True)]

    effects = model.effects
    winds = with_picks(WindEffect, [effect.warp_wind() for effect, _ in effects[WindEffect]])
    rotors = with_picks(RotorEffect, [effect.warp_thrust(types.condition, Hub) for effect, _ in effects[RotorEffect]])
    wrenches = with_picks(WrenchEffect, [effect.warp_wrench(types.condition) for effect, _ in effects[WrenchEffect]])
    any_rotor, any_wrench, any_fluid = bool(rotors), bool(wrenches), bool(effects[FluidEffect])
    wind = _sum_of(winds, wp.vec3, params_type, wp.vec3)
    gain = _sum_of_rotors(rotors, types.condition, params_type)
    wrench = _sum_of(wrenches, types.condition, params_type, wp.spatial_vector)
    vehicle_type, vector, condition_type = types.vehicle, types.vector, types.condition
    own_ground, hub_at = isinstance(model.ground_height, Tensor), _make_hub_at(num_rotors, general)
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
            at.air_velocity = rotate_inverse(attitude, lin_vel - wind(position, params))
            at.ang_vel = ang_vel
            at.rotor_speed = rotor_speed
            at.rotor_acc = rotor_acc
            at.rotor_axis = vehicle.rotor_axis
            at.rotor_reaction = vehicle.rotor_reaction
            at.lever = vehicle.rotor_lever
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


def make_accelerations(model: Model) -> wp.Function:
    """Return a function to linear [m/s², world] and angular acceleration [rad/s², body] with just the model's effects."""
    num_rotors, general = model.vehicle.num_rotors, not model.vehicle.plain
    types, effects, params_type = rotor_types(num_rotors, general), model.effects, values_type(model)
    vehicle_type, vector = types.vehicle, types.vector
    loads, hang = make_loads(model), _make_hang(model)
    any_wrench, any_load, any_fluid = bool(effects[WrenchEffect]), bool(effects[LoadEffect]), bool(effects[FluidEffect])
    entrain = effects[FluidEffect][0][0].warp_entrain(types.condition) if any_fluid else None
    entrain_params = pickers(model)[FluidEffect][0].get if any_fluid else None

    @wp.func
    def accelerations(
        vehicle: vehicle_type,
        params: params_type,
        gravity: float,
        position: wp.vec3,
        attitude: wp.quat,
        lin_vel: wp.vec3,
        ang_vel: wp.vec3,
        rotor_speed: vector,
        rotor_acc: vector,
        load: wp.spatial_vector,
    ):
        force = wp.vec3()
        torque = wp.vec3()
        thrusts, drags, more, at = loads(vehicle, params, position, attitude, lin_vel, ang_vel, rotor_speed, rotor_acc)
        for i in range(wp.static(num_rotors)):
            thrust = thrusts[i]
            force += thrust * wp.vec3(vehicle.rotor_axis[i, 0], vehicle.rotor_axis[i, 1], vehicle.rotor_axis[i, 2])
            torque += thrust * wp.vec3(
                vehicle.rotor_moment[i, 0], vehicle.rotor_moment[i, 1], vehicle.rotor_moment[i, 2]
            )
            torque += drags[i] * wp.vec3(
                vehicle.rotor_reaction[i, 0], vehicle.rotor_reaction[i, 1], vehicle.rotor_reaction[i, 2]
            )
        if wp.static(any_wrench):
            force += wp.spatial_top(more)
            torque += wp.spatial_bottom(more)
        if wp.static(any_fluid):
            whole = entrain(
                wp.spatial_vector(force, torque), at, 1.0 / vehicle.mass_inverse, gravity, entrain_params(params)
            )
            force = wp.spatial_top(whole)
            torque = wp.spatial_bottom(whole)
        acc = rotate(attitude, vehicle.mass_inverse * force) - wp.vec3(0.0, 0.0, gravity)
        ang_acc = angular_acceleration(vehicle.inertia, vehicle.inertia_inverse, ang_vel, torque)
        swing = wp.spatial_vector()
        if wp.static(any_load):
            acc, ang_acc, swing = hang(vehicle, params, gravity, attitude, ang_vel, load, acc, ang_acc)
        return acc, ang_acc, swing

    return accelerations


def _make_hang(model: Model) -> wp.Function | None:
    """Return ``rigid_body.with_load`` for one environment; the last result is the rate of change of the load."""
    if not model.effects[LoadEffect]:
        return None
    effect = model.effects[LoadEffect][0][0]
    pull, pick = effect.warp_pull(Suspension), pickers(model)[LoadEffect][0].get
    types, params_type = rotor_types(model.vehicle.num_rotors, not model.vehicle.plain), values_type(model)
    vehicle_type = types.vehicle

    @wp.func
    def hang(
        vehicle: vehicle_type,
        params: params_type,
        gravity: float,
        attitude: wp.quat,
        ang_vel: wp.vec3,
        load: wp.spatial_vector,
        acc: wp.vec3,
        ang_acc: wp.vec3,
    ):
        lever = -vehicle.com
        cross = wp.skew(lever)
        rotation = rotation_matrix(attitude)
        mobility = vehicle.mass_inverse * wp.identity(n=3, dtype=float) - cross * vehicle.inertia_inverse * cross
        at = Suspension()
        at.acceleration = acc + rotate(attitude, wp.cross(ang_acc, lever) + wp.cross(ang_vel, wp.cross(ang_vel, lever)))
        at.mobility = rotation * mobility * wp.transpose(rotation)
        at.gravity = gravity
        force, swing = pull(at, load, pick(params))
        torque = wp.cross(lever, rotate_inverse(attitude, force))
        return (
            acc + vehicle.mass_inverse * force,
            ang_acc + vehicle.inertia_inverse * torque,
            wp.spatial_vector(wp.spatial_bottom(load), swing),
        )

    return hang


@wp.func
def settle(load: wp.spatial_vector) -> wp.spatial_vector:
    """Return direction and rate of a link with ``|n| = 1``, ``n . n' = 0``."""
    direction = wp.normalize(wp.spatial_top(load))
    rate = wp.spatial_bottom(load)
    return wp.spatial_vector(direction, rate - wp.dot(rate, direction) * direction)


def make_stepper(model: Model, integrator: str) -> wp.Function:
    """Return a function that advances the motion of the centre of mass and the rotors by one step."""
    num_rotors, general = model.vehicle.num_rotors, not model.vehicle.plain
    types, late = rotor_types(num_rotors, general), bool(model.effects[DelayEffect])
    parts = (
        types.vehicle,
        types.vector,
        types.succession if late else types.vector,
        values_type(model),
        make_accelerations(model),
        bool(model.effects[LoadEffect]),
    )
    follow = make_follow(num_rotors, general, late)
    if integrator == "euler":
        return _make_euler(*parts, follow)
    return _make_rk4(
        *parts,
        follow,
        make_follow(num_rotors, general, late, stages=2),
        make_stage_rates(num_rotors, general, late),
    )


def _make_euler(
    vehicle_type: Any,
    vector: Any,
    command_type: Any,
    params_type: Any,
    accelerations: wp.Function,
    any_load: bool,
    follow: wp.Function,
) -> wp.Function:
    @wp.func
    def euler(
        vehicle: vehicle_type,
        params: params_type,
        gravity: float,
        position: wp.vec3,
        attitude: wp.quat,
        lin_vel: wp.vec3,
        ang_vel: wp.vec3,
        rotor_speed: vector,
        load: wp.spatial_vector,
        command: command_type,
        dt: float,
    ):
        rotors = follow(vehicle, rotor_speed, command, dt)
        spin_up = (rotors - rotor_speed) / dt
        acc, ang_acc, swing = accelerations(
            vehicle, params, gravity, position, attitude, lin_vel, ang_vel, rotors, spin_up, load
        )
        v = lin_vel + dt * acc
        w = ang_vel + dt * ang_acc
        hung = load
        if wp.static(any_load):
            rate = wp.spatial_bottom(load) + dt * wp.spatial_bottom(swing)
            hung = settle(wp.spatial_vector(wp.spatial_top(load) + dt * rate, rate))
        return position + dt * v, unit_quat(attitude * small_turn(dt * w)), v, w, rotors, hung

    return euler


def _make_rk4(
    vehicle_type: Any,
    vector: Any,
    command_type: Any,
    params_type: Any,
    accelerations: wp.Function,
    any_load: bool,
    follow_half: wp.Function,
    follow: wp.Function,
    stage_rates: wp.Function,
) -> wp.Function:
    @wp.func
    def rk4(
        vehicle: vehicle_type,
        params: params_type,
        gravity: float,
        position: wp.vec3,
        attitude: wp.quat,
        lin_vel: wp.vec3,
        ang_vel: wp.vec3,
        rotor_speed: vector,
        load: wp.spatial_vector,
        command: command_type,
        dt: float,
    ):
        half = 0.5 * dt
        middle = follow_half(vehicle, rotor_speed, command, half)
        end = follow(vehicle, rotor_speed, command, dt)
        n1, n2, n4 = stage_rates(vehicle, rotor_speed, middle, end, command, dt)
        a1, b1, s1 = accelerations(
            vehicle, params, gravity, position, attitude, lin_vel, ang_vel, rotor_speed, n1, load
        )
        r1 = attitude_rate(attitude, ang_vel)
        v2 = lin_vel + half * a1
        w2 = ang_vel + half * b1
        q2 = attitude + half * r1
        l2 = load + half * s1
        a2, b2, s2 = accelerations(vehicle, params, gravity, position + half * lin_vel, q2, v2, w2, middle, n2, l2)
        r2 = attitude_rate(q2, w2)
        v3 = lin_vel + half * a2
        w3 = ang_vel + half * b2
        q3 = attitude + half * r2
        l3 = load + half * s2
        a3, b3, s3 = accelerations(vehicle, params, gravity, position + half * v2, q3, v3, w3, middle, n2, l3)
        r3 = attitude_rate(q3, w3)
        v4 = lin_vel + dt * a3
        w4 = ang_vel + dt * b3
        q4 = attitude + dt * r3
        l4 = load + dt * s3
        a4, b4, s4 = accelerations(vehicle, params, gravity, position + dt * v3, q4, v4, w4, end, n4, l4)
        r4 = attitude_rate(q4, w4)
        sixth = dt / 6.0
        hung = load
        if wp.static(any_load):
            hung = settle(load + sixth * (s1 + 2.0 * s2 + 2.0 * s3 + s4))
        return (
            position + sixth * (lin_vel + 2.0 * v2 + 2.0 * v3 + v4),
            unit_quat(attitude + sixth * (r1 + 2.0 * r2 + 2.0 * r3 + r4)),
            lin_vel + sixth * (a1 + 2.0 * a2 + 2.0 * a3 + a4),
            ang_vel + sixth * (b1 + 2.0 * b2 + 2.0 * b3 + b4),
            end,
            hung,
        )

    return rk4
