# pyright: reportArgumentType=false, reportAssignmentType=false, reportAttributeAccessIssue=false, reportCallIssue=false
# pyright: reportGeneralTypeIssues=false, reportIndexIssue=false, reportOperatorIssue=false, reportReturnType=false
# pyright: reportInvalidTypeForm=false, reportOptionalCall=false, reportOptionalMemberAccess=false
# (Warp compiles these functions from their source; Python's type rules do not describe them.)
"""Forces and steppers of one environment, composed from the chosen effects as Warp functions.

Letters: R rotors, P parameters of the effects.
"""

from typing import Any

import warp as wp

from aerial_gym.physics.fused.functions import (
    angular_acceleration,
    attitude_rate,
    lag_acceleration,
    lag_speed,
    rotate,
    rotate_inverse,
    small_turn,
)
from aerial_gym.physics.fused.types import Hub, rotor_types, vector_of
from aerial_gym.physics.model import Model

STAGES = {"euler": 1.0, "rk4": 0.5}
"""Part of a step over which a stepper follows the rotors at once."""


def _picker(num_params: int, first: int, length: int) -> wp.Function:
    """Return a function that takes the parameters of one effect out of those of all."""
    params, own = vector_of(max(num_params, 1)), vector_of(length)

    @wp.func
    def pick(all_params: params) -> own:
        picked = own()
        for i in range(wp.static(length)):
            picked[i] = all_params[wp.static(first) + i]
        return picked

    return pick


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


def _make_hub_at(num_rotors: int) -> wp.Function:
    """Return a function to what one rotor feels. (A struct written anew in a loop would have a wrong adjoint.)"""
    types = rotor_types(num_rotors)
    vehicle_type, condition_type = types.vehicle, types.condition

    @wp.func
    def hub_at(vehicle: vehicle_type, at: condition_type, i: int, thrust: float, ground: float) -> Hub:
        lever = wp.vec3(vehicle.rotor_lever[i, 0], vehicle.rotor_lever[i, 1], vehicle.rotor_lever[i, 2])
        hub = Hub()
        hub.speed = at.rotor_speed[i]
        hub.thrust = thrust
        hub.radius = vehicle.rotor_radius[i]
        hub.height = at.position[2] + rotate(at.attitude, lever)[2] - ground
        hub.axis = wp.vec3(vehicle.rotor_axis[i, 0], vehicle.rotor_axis[i, 1], vehicle.rotor_axis[i, 2])
        hub.velocity = at.air_velocity + wp.cross(at.ang_vel, lever)
        return hub

    return hub_at


def make_accelerations(model: Model) -> wp.Function:
    """Return a function to linear [m/s², world] and angular acceleration [rad/s², body] with just the model's effects."""
    num_rotors = model.vehicle.num_rotors
    types = rotor_types(num_rotors)
    widths = [params.shape[1] for _, params in model.forces]
    pickers = [_picker(sum(widths), sum(widths[:i]), width) for i, width in enumerate(widths)]
    winds = [effect.warp_wind() for effect, _ in model.winds]
    rotors = [effect.warp_thrust(types.condition, Hub) for effect, _ in model.rotors]
    wrenches = [effect.warp_wrench(types.condition) for effect, _ in model.wrenches]
    any_rotor, any_wrench, params_type = bool(rotors), bool(wrenches), vector_of(max(sum(widths), 1))
    of_winds, of_rest = pickers[: len(winds)], pickers[len(winds) :]
    of_rotors, of_wrenches = of_rest[: len(rotors)], of_rest[len(rotors) :]
    wind = _sum_of(list(zip(winds, of_winds, strict=True)), wp.vec3, params_type, wp.vec3)
    gain = _sum_of_rotors(list(zip(rotors, of_rotors, strict=True)), types.condition, params_type)
    wrench = _sum_of(list(zip(wrenches, of_wrenches, strict=True)), types.condition, params_type, wp.spatial_vector)
    vehicle_type, vector, condition_type = types.vehicle, types.vector, types.condition
    ground_height, hub_at = model.ground_height, _make_hub_at(num_rotors)

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
    ):
        force = wp.vec3()
        torque = wp.vec3()
        at = condition_type()
        thrusts = vector()
        ground = float(wp.static(ground_height))
        if wp.static(any_rotor or any_wrench):
            at.position = position
            at.attitude = attitude
            at.air_velocity = rotate_inverse(attitude, lin_vel - wind(position, params))
            at.ang_vel = ang_vel
            at.rotor_speed = rotor_speed
            at.rotor_acc = rotor_acc
            at.rotor_axis = vehicle.rotor_axis
            at.rotor_reaction = vehicle.rotor_reaction
            at.lever = vehicle.rotor_lever
        for i in range(wp.static(num_rotors)):
            n = rotor_speed[i]
            thrust = vehicle.thrust_map[i, 0] + n * (vehicle.thrust_map[i, 1] + n * vehicle.thrust_map[i, 2])
            if wp.static(any_rotor):
                thrust = thrust + gain(at, hub_at(vehicle, at, i, thrust, ground), params)
            drag = vehicle.torque_map[i, 0] + n * (vehicle.torque_map[i, 1] + n * vehicle.torque_map[i, 2])
            force += thrust * wp.vec3(vehicle.rotor_axis[i, 0], vehicle.rotor_axis[i, 1], vehicle.rotor_axis[i, 2])
            torque += thrust * wp.vec3(
                vehicle.rotor_moment[i, 0], vehicle.rotor_moment[i, 1], vehicle.rotor_moment[i, 2]
            )
            torque += drag * wp.vec3(
                vehicle.rotor_reaction[i, 0], vehicle.rotor_reaction[i, 1], vehicle.rotor_reaction[i, 2]
            )
            thrusts[i] = thrust
        if wp.static(any_wrench):
            at.rotor_thrust = thrusts
            more = wrench(at, params)
            force += wp.spatial_top(more)
            torque += wp.spatial_bottom(more)
        acc = rotate(attitude, vehicle.mass_inverse * force) - wp.vec3(0.0, 0.0, gravity)
        return acc, angular_acceleration(vehicle.inertia, vehicle.inertia_inverse, ang_vel, torque)

    return accelerations


def make_stepper(model: Model, integrator: str) -> wp.Function:
    """Return a function that advances the motion of the centre of mass and the rotors by one step."""
    types = rotor_types(model.vehicle.num_rotors)
    num_params = sum(params.shape[1] for _, params in model.forces)
    parts = (types.vehicle, types.vector, vector_of(max(num_params, 1)), make_accelerations(model))
    follow = _make_follow(model.vehicle.num_rotors)
    if integrator == "euler":
        return _make_euler(*parts, follow)
    return _make_rk4(*parts, follow, _make_spin_up(model.vehicle.num_rotors))


def _make_follow(num_rotors: int) -> wp.Function:
    types = rotor_types(num_rotors)
    vehicle_type, vector = types.vehicle, types.vector

    @wp.func
    def follow(vehicle: vehicle_type, speed: vector, command: vector) -> vector:
        after = vector()
        for i in range(wp.static(num_rotors)):
            after[i] = lag_speed(speed[i], command[i], vehicle.decay_up[i], vehicle.decay_down[i])
        return after

    return follow


def _make_spin_up(num_rotors: int) -> wp.Function:
    """Return ``rotors.lag_acceleration`` for stages of half a step."""
    types = rotor_types(num_rotors)
    vehicle_type, vector = types.vehicle, types.vector

    @wp.func
    def spin_up(vehicle: vehicle_type, speed: vector, command: vector, first: vector, dt: float) -> vector:
        rate = vector()
        for i in range(wp.static(num_rotors)):
            rate[i] = lag_acceleration(
                speed[i], command[i], vehicle.decay_up[i], vehicle.decay_down[i], command[i] - first[i], dt
            )
        return rate

    return spin_up


def _make_euler(
    vehicle_type: Any, vector: Any, params_type: Any, accelerations: wp.Function, follow: wp.Function
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
        command: vector,
        dt: float,
    ):
        rotors = follow(vehicle, rotor_speed, command)
        spin_up = (rotors - rotor_speed) / dt
        acc, ang_acc = accelerations(vehicle, params, gravity, position, attitude, lin_vel, ang_vel, rotors, spin_up)
        v = lin_vel + dt * acc
        w = ang_vel + dt * ang_acc
        return position + dt * v, wp.normalize(attitude * small_turn(dt * w)), v, w, rotors

    return euler


def _make_rk4(
    vehicle_type: Any,
    vector: Any,
    params_type: Any,
    accelerations: wp.Function,
    follow: wp.Function,
    spin_up: wp.Function,
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
        command: vector,
        dt: float,
    ):
        middle = follow(vehicle, rotor_speed, command)
        end = follow(vehicle, middle, command)
        half = 0.5 * dt
        n1 = spin_up(vehicle, rotor_speed, command, rotor_speed, dt)
        n2 = spin_up(vehicle, middle, command, rotor_speed, dt)
        n4 = spin_up(vehicle, end, command, rotor_speed, dt)
        a1, b1 = accelerations(vehicle, params, gravity, position, attitude, lin_vel, ang_vel, rotor_speed, n1)
        r1 = attitude_rate(attitude, ang_vel)
        v2 = lin_vel + half * a1
        w2 = ang_vel + half * b1
        q2 = attitude + half * r1
        a2, b2 = accelerations(vehicle, params, gravity, position + half * lin_vel, q2, v2, w2, middle, n2)
        r2 = attitude_rate(q2, w2)
        v3 = lin_vel + half * a2
        w3 = ang_vel + half * b2
        q3 = attitude + half * r2
        a3, b3 = accelerations(vehicle, params, gravity, position + half * v2, q3, v3, w3, middle, n2)
        r3 = attitude_rate(q3, w3)
        v4 = lin_vel + dt * a3
        w4 = ang_vel + dt * b3
        q4 = attitude + dt * r3
        a4, b4 = accelerations(vehicle, params, gravity, position + dt * v3, q4, v4, w4, end, n4)
        r4 = attitude_rate(q4, w4)
        sixth = dt / 6.0
        return (
            position + sixth * (lin_vel + 2.0 * v2 + 2.0 * v3 + v4),
            wp.normalize(attitude + sixth * (r1 + 2.0 * r2 + 2.0 * r3 + r4)),
            lin_vel + sixth * (a1 + 2.0 * a2 + 2.0 * a3 + a4),
            ang_vel + sixth * (b1 + 2.0 * b2 + 2.0 * b3 + b4),
            end,
        )

    return rk4
