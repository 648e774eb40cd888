"""Accelerations and integrators of the fused kernel, composed for the chosen effects as Warp functions.

Letters: R rotors.
"""

from typing import Any

import warp as wp

from aerial_gym.math.warp_functions import attitude_rate, rotate, rotate_inverse, rotation_matrix, small_turn, unit_quat
from aerial_gym.physics.effects import DelayEffect, FluidEffect, LoadEffect, WrenchEffect
from aerial_gym.physics.fused.kirchhoff import make_coast, make_inverse_mass
from aerial_gym.physics.fused.loads import make_loads
from aerial_gym.physics.fused.packing import value_access, values_type
from aerial_gym.physics.fused.rotors import make_follow, make_stage_rates
from aerial_gym.physics.fused.types import KernelSuspension, rotor_types
from aerial_gym.physics.model import Model

STAGES = {"euler": 1.0, "rk4": 0.5}
"""Share of a step between two evaluations of the rotor lag."""


def make_accelerations(model: Model, *, upright: bool) -> wp.Function:
    """Return the function of linear [m/s², world] and angular acceleration [rad/s², body].

    ``upright`` as for ``make_loads``.
    """
    num_rotors, general = model.vehicle.num_rotors, not model.vehicle.plain
    types, effects, params_type = rotor_types(num_rotors, general), model.effects, values_type(model)
    vehicle_type, vector = types.vehicle, types.vector
    loads, hang = make_loads(model, upright=upright), _make_hang(model)
    any_wrench, any_load, any_fluid = bool(effects[WrenchEffect]), bool(effects[LoadEffect]), bool(effects[FluidEffect])
    fluid, pick = value_access(model, FluidEffect)[0] if any_fluid else (None, None)
    entrain = None if fluid is None else fluid.warp_entrain(types.condition)
    entrain_params = None if pick is None else pick.get

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
            if wp.static(upright):
                force += wp.vec3(0.0, 0.0, thrust)
                torque += wp.vec3(
                    thrust * vehicle.rotor_moment[i, 0],
                    thrust * vehicle.rotor_moment[i, 1],
                    drags[i] * vehicle.rotor_reaction[i, 2],
                )
            else:
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
    """Return the Warp version of ``rigid_body.with_load``; the last result is the rate of change of the load."""
    if not model.effects[LoadEffect]:
        return None
    ((effect, access),) = value_access(model, LoadEffect)
    pull, pick = effect.warp_pull(KernelSuspension), access.get
    types, params_type = rotor_types(model.vehicle.num_rotors, not model.vehicle.plain), values_type(model)
    vehicle_type, any_fluid = types.vehicle, bool(model.effects[FluidEffect])
    inverse_mass = make_inverse_mass(model) if any_fluid else None

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
        if wp.static(any_fluid):
            mobility = wp.diag(inverse_mass(vehicle, params)) - cross * vehicle.inertia_inverse * cross
        at = KernelSuspension()
        at.acceleration = acc + rotate(attitude, wp.cross(ang_acc, lever) + wp.cross(ang_vel, wp.cross(ang_vel, lever)))
        at.mobility = rotation * mobility * wp.transpose(rotation)
        at.gravity = gravity
        force, swing = pull(at, load, pick(params))
        own = rotate_inverse(attitude, force)
        torque = wp.cross(lever, own)
        more = vehicle.mass_inverse * force
        if wp.static(any_fluid):
            more = rotate(attitude, wp.cw_mul(inverse_mass(vehicle, params), own))
        return (
            acc + more,
            ang_acc + vehicle.inertia_inverse * torque,
            wp.spatial_vector(wp.spatial_bottom(load), swing),
        )

    return hang


@wp.func
def angular_acceleration(inertia: wp.mat33, inertia_inverse: wp.mat33, ang_vel: wp.vec3, torque: wp.vec3) -> wp.vec3:
    """Return ``J^-1 (tau - w x J w)`` [rad/s²], body."""
    return inertia_inverse * (torque - wp.cross(ang_vel, inertia * ang_vel))


@wp.func
def settle(load: wp.spatial_vector) -> wp.spatial_vector:
    """Normalise direction and rate of a link to ``|n| = 1``, ``n . n' = 0``."""
    direction = wp.normalize(wp.spatial_top(load))
    rate = wp.spatial_bottom(load)
    return wp.spatial_vector(direction, rate - wp.dot(rate, direction) * direction)


def make_stepper(model: Model, integrator: str, *, upright: bool) -> wp.Function:
    """Return the function of one step of the centre of mass and the rotors; ``upright`` as for ``make_loads``."""
    num_rotors, general = model.vehicle.num_rotors, not model.vehicle.plain
    types, late = rotor_types(num_rotors, general), bool(model.effects[DelayEffect])
    parts = (
        types.vehicle,
        types.vector,
        types.succession if late else types.vector,
        values_type(model),
        make_accelerations(model, upright=upright),
        bool(model.effects[LoadEffect]),
    )
    follow = make_follow(num_rotors, general, late)
    if integrator == "euler" and model.effects[FluidEffect]:
        return _make_euler_in_fluid(*parts, follow, *make_coast(model))
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
        spin_up = (1.0 / dt) * (rotors - rotor_speed)
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


def _make_euler_in_fluid(
    vehicle_type: Any,
    vector: Any,
    command_type: Any,
    params_type: Any,
    accelerations: wp.Function,
    any_load: bool,
    follow: wp.Function,
    coast: wp.Function,
    free_accelerations: wp.Function,
) -> wp.Function:
    """Return the Warp version of ``integrators.euler_in_fluid``."""

    @wp.func
    def advance_load(load: wp.spatial_vector, dt: float) -> wp.spatial_vector:
        rate = wp.spatial_bottom(load)
        return settle(wp.spatial_vector(wp.spatial_top(load) + dt * rate, rate))

    @wp.func
    def euler_in_fluid(
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
        rotors = follow(vehicle, rotor_speed, command, dt)
        spin_up = (1.0 / dt) * (rotors - rotor_speed)
        x, q, v, w = coast(vehicle, params, position, attitude, lin_vel, ang_vel, half)
        hung = load
        if wp.static(any_load):
            hung = advance_load(load, half)
        acc, ang_acc, swing = accelerations(vehicle, params, gravity, x, q, v, w, rotors, spin_up, hung)
        free_acc, free_ang_acc = free_accelerations(vehicle, params, x, q, v, w)
        pushed = v + dt * (acc - free_acc)
        turning = w + dt * (ang_acc - free_ang_acc)
        end_x, end_q, end_v, end_w = coast(vehicle, params, x, q, pushed, turning, half)
        ends = hung
        if wp.static(any_load):
            rate = wp.spatial_bottom(hung) + dt * wp.spatial_bottom(swing)
            ends = advance_load(wp.spatial_vector(wp.spatial_top(hung), rate), half)
        return end_x, end_q, end_v, end_w, rotors, ends

    return euler_in_fluid


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
