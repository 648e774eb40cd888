"""The laws of ``control.lee`` as Warp functions for one environment.

The laws are computed in the body frame, where the columns of ``R^T Rd`` are the wanted axes in body coordinates. Euler angles
are avoided: *up*, the third row of R, is (-sin pitch, sin roll cos pitch, cos roll cos pitch).
Frames: world z up, body x forward, y left, z up; the *vehicle* frame is the world turned by the yaw alone.
"""

from collections.abc import Mapping
from math import tan

import torch
import warp as wp
from torch import Tensor

from aerial_gym.control.lee import LEAST_LIFT, LeeGains
from aerial_gym.math.warp_functions import inverse_root, rotate, rotate_inverse, unit, world_up


@wp.struct
class LeeParams:
    """Gains, limits, and the autopilot's vehicle parameters."""

    position: wp.vec3  # [1/s²]
    velocity: wp.vec3  # [1/s]
    attitude: wp.vec3  # [N m/rad]
    rate: wp.vec3  # [N m s/rad]
    mass: float  # [kg]
    inertia: wp.mat33  # [kg m²]
    gravity: float  # [m/s²]
    max_yaw_rate: float  # [rad/s]
    max_slope: float  # tan of the largest inclination


def gain_rows(gains: LeeGains) -> Mapping[str, Tensor]:
    """Return the fields of ``Gains`` in their order, each (E, ...)."""

    def number(value: float) -> Tensor:
        return torch.full_like(gains.mass[:1], value).as_strided((gains.mass.shape[0],), (0,))

    return {
        "position": gains.position,
        "velocity": gains.velocity,
        "attitude": gains.attitude,
        "rate": gains.rate,
        "mass": gains.mass,
        "inertia": gains.inertia,
        "gravity": number(gains.gravity),
        "max_yaw_rate": number(gains.max_yaw_rate),
        "max_slope": number(tan(gains.max_inclination)),
    }


@wp.func
def read_vec3(source: wp.array2d[float], first: int, env: int) -> wp.vec3:
    """Read three consecutive numbers of one environment."""
    return wp.vec3(source[first, env], source[first + 1, env], source[first + 2, env])


@wp.func
def write_vec3(out: wp.array2d[float], first: int, env: int, vector: wp.vec3):
    """Write three consecutive numbers of one environment."""
    for i in range(3):
        out[first + i, env] = vector[i]


@wp.func
def inverse_cos_pitch(up: wp.vec3) -> float:
    """Return ``1 / cos pitch``, finite at a pitch of 90 degrees."""
    return inverse_root(wp.max(up[1] * up[1] + up[2] * up[2], 1.0e-30))


@wp.func
def heading_axis(up: wp.vec3, inverse: float) -> wp.vec3:
    """Return vehicle x in body coordinates, from ``1 / cos pitch``: (cos pitch, sin roll sin pitch, cos roll sin pitch)."""
    slope = -up[0] * inverse
    return wp.vec3((up[1] * up[1] + up[2] * up[2]) * inverse, slope * up[1], slope * up[2])


@wp.func
def rate_torque(gains: LeeParams, ang_vel: wp.vec3, rate: wp.vec3) -> wp.vec3:
    """Return ``-K_w (w - w_d) + w x J w`` [N m], body."""
    return wp.cross(ang_vel, gains.inertia * ang_vel) - wp.cw_mul(gains.rate, ang_vel - rate)


@wp.func
def attitude_torque(gains: LeeParams, d1: wp.vec3, d2: wp.vec3, d3: wp.vec3) -> wp.vec3:
    """Return ``-K_R e_R`` [N m], body, from the wanted axes in body coordinates."""
    error = wp.vec3(d3[1] - d2[2], d1[2] - d3[0], d2[0] - d1[1])
    return -0.5 * wp.cw_mul(gains.attitude, error)


@wp.func
def limit_yaw_rate(yaw_rate: float, gains: LeeParams) -> float:
    """Return the yaw rate [rad/s] within its limits."""
    return wp.clamp(yaw_rate, -gains.max_yaw_rate, gains.max_yaw_rate)


@wp.func
def within_inclination(force: wp.vec3, least_up: float, max_slope: float) -> wp.vec3:
    """Limit a force [N], world, to a vertical part of at least ``least_up`` and to a slope, the tan of its inclination."""
    up = wp.max(force[2], least_up)
    shrink = wp.min(max_slope * up * inverse_root(wp.max(force[0] * force[0] + force[1] * force[1], 1.0e-18)), 1.0)
    return wp.vec3(shrink * force[0], shrink * force[1], up)


@wp.func
def limit_force(gains: LeeParams, acceleration: wp.vec3) -> wp.vec3:
    """Return the force [N], world, ``m (a - g)`` within the inclination."""
    weight = gains.mass * gains.gravity
    force = gains.mass * acceleration + wp.vec3(0.0, 0.0, weight)
    return within_inclination(force, LEAST_LIFT * weight, gains.max_slope)


@wp.func
def force_wrench(
    gains: LeeParams, attitude: wp.quat, ang_vel: wp.vec3, force: wp.vec3, heading: wp.vec3, rate: wp.vec3
) -> wp.spatial_vector:
    """Return the wrench with the thrust of a force [N, world], and the torque that turns body z along it.

    Args:
        attitude: Body to world.
        ang_vel: [rad/s], body.
        force: World [N].
        heading: Wanted direction of body x, body.
        rate: Wanted angular velocity [rad/s], wanted body frame.
    """
    seen = rotate_inverse(attitude, force)
    d3 = unit(seen)
    d2 = unit(wp.cross(d3, heading))
    d1 = wp.cross(d2, d3)
    turned = rate[0] * d1 + rate[1] * d2 + rate[2] * d3
    torque = rate_torque(gains, ang_vel, turned) + attitude_torque(gains, d1, d2, d3)
    return wp.spatial_vector(0.0, 0.0, seen[2], torque[0], torque[1], torque[2])


vec5 = wp.types.vector(length=5, dtype=wp.float32)
vec6 = wp.types.vector(length=6, dtype=wp.float32)
vec7 = wp.types.vector(length=7, dtype=wp.float32)


@wp.func
def prepare_position(action: wp.vec4, gains: LeeParams) -> vec5:
    """Return x, y, z [m] and cosine and sine of the yaw."""
    return vec5(action[0], action[1], action[2], wp.cos(action[3]), wp.sin(action[3]))


@wp.func
def position_control(
    position: wp.vec3, attitude: wp.quat, lin_vel: wp.vec3, ang_vel: wp.vec3, wanted: vec5, gains: LeeParams
) -> wp.spatial_vector:
    """Return the wrench for x, y, z [m, world] and yaw [rad]."""
    error = wp.vec3(wanted[0], wanted[1], wanted[2]) - position
    acceleration = wp.cw_mul(gains.position, error) - wp.cw_mul(gains.velocity, lin_vel)
    heading = rotate_inverse(attitude, wp.vec3(wanted[3], wanted[4], 0.0))
    return force_wrench(gains, attitude, ang_vel, limit_force(gains, acceleration), heading, wp.vec3())


@wp.func
def prepare_pose(action: vec7, gains: LeeParams) -> vec7:
    """Return x, y, z [m] and a unit quaternion; the identity for zeros."""
    q = wp.quat(action[3], action[4], action[5], action[6])
    if wp.length(q) == 0.0:
        q = wp.quat_identity()
    q = wp.normalize(q)
    return vec7(action[0], action[1], action[2], q[0], q[1], q[2], q[3])


@wp.func
def pose_control(
    position: wp.vec3, attitude: wp.quat, lin_vel: wp.vec3, ang_vel: wp.vec3, wanted: vec7, gains: LeeParams
) -> wp.spatial_vector:
    """Return the wrench for x, y, z [m, world] and an attitude."""
    error = wp.vec3(wanted[0], wanted[1], wanted[2]) - position
    acceleration = wp.cw_mul(gains.position, error) - wp.cw_mul(gains.velocity, lin_vel)
    force = gains.mass * rotate_inverse(attitude, acceleration + wp.vec3(0.0, 0.0, gains.gravity))
    turn = wp.quat(wanted[3], wanted[4], wanted[5], wanted[6])
    d1 = rotate_inverse(attitude, rotate(turn, wp.vec3(1.0, 0.0, 0.0)))
    d2 = rotate_inverse(attitude, rotate(turn, wp.vec3(0.0, 1.0, 0.0)))
    torque = rate_torque(gains, ang_vel, wp.vec3()) + attitude_torque(gains, d1, d2, wp.cross(d1, d2))
    return wp.spatial_vector(force, torque)


@wp.func
def prepare_steering(action: wp.vec4, gains: LeeParams) -> vec5:
    """Return vx, vy, vz [m/s] and cosine and sine of the yaw."""
    return vec5(action[0], action[1], action[2], wp.cos(action[3]), wp.sin(action[3]))


@wp.func
def steering_control(
    position: wp.vec3, attitude: wp.quat, lin_vel: wp.vec3, ang_vel: wp.vec3, wanted: vec5, gains: LeeParams
) -> wp.spatial_vector:
    """Return the wrench for vx, vy, vz [m/s, vehicle frame] and yaw [rad]."""
    inverse = inverse_cos_pitch(world_up(attitude))
    velocity = from_vehicle_frame(attitude, inverse, wp.vec3(wanted[0], wanted[1], wanted[2]))
    force = limit_force(gains, wp.cw_mul(gains.velocity, velocity - lin_vel))
    heading = rotate_inverse(attitude, wp.vec3(wanted[3], wanted[4], 0.0))
    return force_wrench(gains, attitude, ang_vel, force, heading, wp.vec3())


@wp.func
def from_vehicle_frame(q: wp.quat, inverse: float, vector: wp.vec3) -> wp.vec3:
    """Return a vector of the vehicle frame in the world, from ``1 / cos pitch``."""
    cosine = inverse * (1.0 - 2.0 * (q[1] * q[1] + q[2] * q[2]))
    sine = inverse * 2.0 * (q[0] * q[1] + q[3] * q[2])
    return wp.vec3(cosine * vector[0] - sine * vector[1], sine * vector[0] + cosine * vector[1], vector[2])


@wp.func
def prepare_velocity(action: wp.vec4, gains: LeeParams) -> wp.vec4:
    """Return vx, vy, vz [m/s] and the limited yaw rate [rad/s]."""
    return wp.vec4(action[0], action[1], action[2], limit_yaw_rate(action[3], gains))


@wp.func
def velocity_control(
    position: wp.vec3, attitude: wp.quat, lin_vel: wp.vec3, ang_vel: wp.vec3, wanted: wp.vec4, gains: LeeParams
) -> wp.spatial_vector:
    """Return the wrench for vx, vy, vz [m/s, vehicle frame] and yaw rate [rad/s]."""
    q = attitude
    up = world_up(q)
    inverse = inverse_cos_pitch(up)
    velocity = from_vehicle_frame(q, inverse, wp.vec3(wanted[0], wanted[1], wanted[2]))
    force = limit_force(gains, wp.cw_mul(gains.velocity, velocity - lin_vel))
    return force_wrench(gains, q, ang_vel, force, heading_axis(up, inverse), wanted[3] * up)


@wp.func
def prepare_acceleration(action: wp.vec4, gains: LeeParams) -> wp.vec4:
    """Return the limited force [N] and the limited yaw rate [rad/s]."""
    force = limit_force(gains, wp.vec3(action[0], action[1], action[2]))
    return wp.vec4(force[0], force[1], force[2], limit_yaw_rate(action[3], gains))


@wp.func
def acceleration_control(
    position: wp.vec3, attitude: wp.quat, lin_vel: wp.vec3, ang_vel: wp.vec3, wanted: wp.vec4, gains: LeeParams
) -> wp.spatial_vector:
    """Return the wrench for ax, ay, az [m/s², world] and yaw rate [rad/s]."""
    up = world_up(attitude)
    heading = heading_axis(up, inverse_cos_pitch(up))
    return force_wrench(gains, attitude, ang_vel, wp.vec3(wanted[0], wanted[1], wanted[2]), heading, wanted[3] * up)


@wp.func
def prepare_attitude(action: wp.vec4, gains: LeeParams) -> vec6:
    """Return the thrust [N], sines and cosines of roll and pitch, and the limited yaw rate [rad/s]."""
    return vec6(
        (action[0] + 1.0) * gains.mass * gains.gravity,
        wp.sin(action[1]),
        wp.cos(action[1]),
        wp.sin(action[2]),
        wp.cos(action[2]),
        limit_yaw_rate(action[3], gains),
    )


@wp.func
def attitude_control(
    position: wp.vec3, attitude: wp.quat, lin_vel: wp.vec3, ang_vel: wp.vec3, wanted: vec6, gains: LeeParams
) -> wp.spatial_vector:
    """Return the wrench for thrust [multiples of weight, 0 is hover], roll, pitch [rad] and yaw rate [rad/s].

    The wanted attitude has the heading of the body, so that yaw cancels: vehicle x, y and z in body coordinates are rotated
    by the wanted pitch and then by the wanted roll.
    """
    up = world_up(attitude)
    inverse = inverse_cos_pitch(up)
    heading = heading_axis(up, inverse)
    left_y = up[2] * inverse  # vehicle y has no part along body x
    left_z = -up[1] * inverse
    d1 = wanted[4] * heading - wanted[3] * up
    lifted = wanted[3] * heading + wanted[4] * up
    d2 = wp.vec3(
        wanted[1] * lifted[0], wanted[1] * lifted[1] + wanted[2] * left_y, wanted[1] * lifted[2] + wanted[2] * left_z
    )
    d3 = wp.vec3(
        wanted[2] * lifted[0], wanted[2] * lifted[1] - wanted[1] * left_y, wanted[2] * lifted[2] - wanted[1] * left_z
    )
    rate = wanted[5] * up
    turned = rate[0] * d1 + rate[1] * d2 + rate[2] * d3
    torque = rate_torque(gains, ang_vel, turned) + attitude_torque(gains, d1, d2, d3)
    return wp.spatial_vector(0.0, 0.0, wanted[0], torque[0], torque[1], torque[2])


@wp.func
def prepare_rates(action: wp.vec4, gains: LeeParams) -> wp.vec4:
    """Return the thrust [N] and body rates p, q, r [rad/s]."""
    return wp.vec4((action[0] + 1.0) * gains.mass * gains.gravity, action[1], action[2], action[3])


@wp.func
def rates_control(
    position: wp.vec3, attitude: wp.quat, lin_vel: wp.vec3, ang_vel: wp.vec3, wanted: wp.vec4, gains: LeeParams
) -> wp.spatial_vector:
    """Return the wrench for thrust [multiples of weight, 0 is hover] and body rates p, q, r [rad/s]."""
    torque = rate_torque(gains, ang_vel, wp.vec3(wanted[1], wanted[2], wanted[3]))
    return wp.spatial_vector(0.0, 0.0, wanted[0], torque[0], torque[1], torque[2])
