"""Free motion of a hull with added mass: the Warp version of ``physics.kirchhoff``."""

from typing import Any

import warp as wp

from aerial_gym.math.warp_functions import rotate, rotate_inverse, unit_quat
from aerial_gym.physics.effects import FluidEffect
from aerial_gym.physics.fused.loads import make_wind
from aerial_gym.physics.fused.packing import model_types, value_access, values_type
from aerial_gym.physics.kirchhoff import ITERATIONS
from aerial_gym.physics.model import Model


@wp.func
def _half_rotation(a: wp.vec3, vector: wp.vec3) -> wp.vec3:
    return (vector - wp.cross(a, vector) + wp.dot(a, vector) * a) / (1.0 + wp.dot(a, a))


@wp.func
def _slope(
    inverse_mass: wp.vec3, turn: wp.vec3, v: wp.vec3, w: wp.vec3, p: wp.vec3, spin: wp.vec3, axis: wp.vec3, half: float
) -> wp.vec3:
    """Return the derivative of Newton's residual along an axis; ``turn`` is J times the axis."""
    more = half * _half_rotation(half * w, wp.cross(p, axis))
    gyroscopic = wp.cross(axis, spin) + wp.cross(w, turn)
    return turn + half * (gyroscopic + wp.cross(wp.cw_mul(inverse_mass, more), p) + wp.cross(v, more))


@wp.func
def _mean_ang_vel(inverse_mass: wp.vec3, inertia: wp.mat33, lin_vel: wp.vec3, ang_vel: wp.vec3, dt: float):
    """Return the mean angular velocity of a step without force [rad/s], body."""
    half = 0.5 * dt
    impulse = wp.cw_div(lin_vel, inverse_mass)
    spin = inertia * ang_vel
    x = wp.vec3(1.0, 0.0, 0.0)
    y = wp.vec3(0.0, 1.0, 0.0)
    z = wp.vec3(0.0, 0.0, 1.0)
    w = ang_vel
    for _i in range(wp.static(ITERATIONS)):
        p = _half_rotation(half * w, impulse)
        now = inertia * w
        v = wp.cw_mul(inverse_mass, p)
        missing = now - spin + half * (wp.cross(w, now) + wp.cross(v, p))
        a = _slope(inverse_mass, inertia * x, v, w, p, now, x, half)
        b = _slope(inverse_mass, inertia * y, v, w, p, now, y, half)
        c = _slope(inverse_mass, inertia * z, v, w, p, now, z, half)
        beside = wp.cross(b, c)
        numerators = wp.vec3(wp.dot(missing, beside), wp.dot(a, wp.cross(missing, c)), wp.dot(a, wp.cross(b, missing)))
        w = w - numerators / wp.dot(a, beside)
    return w


def make_inverse_mass(model: Model) -> wp.Function:
    """Return the function of the inverse mass of hull and fluid along each body axis [1/kg]."""
    ((effect, pick),) = value_access(model, FluidEffect)
    added_mass, get = effect.warp_added_mass(), pick.get
    vehicle_type: Any = model_types(model).vehicle
    params_type: Any = values_type(model)

    @wp.func
    def inverse_mass(vehicle: vehicle_type, params: params_type) -> wp.vec3:
        added = added_mass(get(params))
        own = 1.0 / vehicle.mass_inverse
        return wp.vec3(1.0 / (own + added[0]), 1.0 / (own + added[1]), 1.0 / (own + added[2]))

    return inverse_mass


def make_coast(model: Model) -> tuple[wp.Function, wp.Function]:
    """Return the Warp version of ``integrators.coast`` without a load, and the function of the accelerations of that motion.

    The accelerations are instantaneous: linear [m/s²], world, and angular [rad/s²], body.
    """
    ((effect, pick),) = value_access(model, FluidEffect)
    wind, added_mass, get, inverse_mass = make_wind(model), effect.warp_added_mass(), pick.get, make_inverse_mass(model)
    vehicle_type: Any = model_types(model).vehicle
    params_type: Any = values_type(model)

    @wp.func
    def coast(
        vehicle: vehicle_type,
        params: params_type,
        position: wp.vec3,
        attitude: wp.quat,
        lin_vel: wp.vec3,
        ang_vel: wp.vec3,
        dt: float,
    ):
        v = rotate_inverse(attitude, lin_vel - wind(position, params))
        inverse = inverse_mass(vehicle, params)
        mean = _mean_ang_vel(inverse, vehicle.inertia, v, ang_vel, dt)
        a = 0.5 * dt * mean
        square = wp.dot(a, a)
        more = -wp.cw_mul(inverse, wp.cross(a, _half_rotation(a, wp.cw_div(v, inverse))))
        end = v + 2.0 * more
        move = dt / (1.0 + square) * (more + wp.cross(a, v + more) - square * v)
        gain = 2.0 * more + 2.0 / (1.0 + square) * (wp.cross(a, end) + wp.cross(a, wp.cross(a, end)))
        turned = unit_quat(attitude * wp.quat(a[0], a[1], a[2], 1.0))
        x = position + dt * lin_vel + rotate(attitude, move)
        return x, turned, lin_vel + rotate(attitude, gain), 2.0 * mean - ang_vel

    @wp.func
    def free_accelerations(
        vehicle: vehicle_type,
        params: params_type,
        position: wp.vec3,
        attitude: wp.quat,
        lin_vel: wp.vec3,
        w: wp.vec3,
    ):
        added = added_mass(get(params))
        v = rotate_inverse(attitude, lin_vel - wind(position, params))
        momentum = wp.cw_mul(added, v)
        push = wp.cw_mul(added, wp.cross(w, v)) - wp.cross(w, momentum)
        torque = -wp.cross(w, vehicle.inertia * w) - wp.cross(v, momentum)
        return rotate(attitude, wp.cw_mul(inverse_mass(vehicle, params), push)), vehicle.inertia_inverse * torque

    return coast, free_accelerations
