"""The laws of ``control.lee`` as Warp functions for one environment.

Euler angles are avoided: the third row of R is (-sin pitch, sin roll cos pitch, cos roll cos pitch), and its first column
points along the heading.
Frames: world z up, body x forward, y left, z up; the *vehicle* frame is the world turned by the yaw alone.
"""

from collections.abc import Mapping
from math import tan

import torch
import warp as wp
from torch import Tensor

from aerial_gym.control.lee import LeeGains
from aerial_gym.physics.fused.functions import rotate


@wp.struct
class Gains:
    """Gains and limits, and what the autopilot believes of its vehicle."""

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
    """Return three numbers of one environment."""
    return wp.vec3(source[first, env], source[first + 1, env], source[first + 2, env])


@wp.func
def load_gains(source: wp.array2d[float], first: int, env: int) -> Gains:
    """Return the gains of one environment from the rows of (N, E), in the order of ``gain_rows``."""
    gains = Gains()
    gains.position = read_vec3(source, first, env)
    gains.velocity = read_vec3(source, first + 3, env)
    gains.attitude = read_vec3(source, first + 6, env)
    gains.rate = read_vec3(source, first + 9, env)
    gains.mass = source[first + 12, env]
    gains.inertia = wp.matrix_from_rows(
        read_vec3(source, first + 13, env), read_vec3(source, first + 16, env), read_vec3(source, first + 19, env)
    )
    gains.gravity = source[first + 22, env]
    gains.max_yaw_rate = source[first + 23, env]
    gains.max_slope = source[first + 24, env]
    return gains


@wp.func
def heading_of(attitude: wp.quat) -> wp.vec3:
    """Return the unit vector of the yaw in the world plane, (cos yaw, sin yaw, 0)."""
    forward = rotate(attitude, wp.vec3(1.0, 0.0, 0.0))
    return wp.normalize(wp.vec3(forward[0], forward[1], 0.0))


@wp.func
def rate_torque(gains: Gains, ang_vel: wp.vec3, rate: wp.vec3) -> wp.vec3:
    """Return ``-K_w (w - w_d) + w x J w`` [N m], body."""
    return wp.cross(ang_vel, gains.inertia * ang_vel) - wp.cw_mul(gains.rate, ang_vel - rate)


@wp.func
def attitude_torque(gains: Gains, rotation: wp.mat33, desired: wp.mat33, ang_vel: wp.vec3, rate: wp.vec3) -> wp.vec3:
    """Return ``-K_R e_R - K_w (w - R^T Rd w_d) + w x J w`` [N m], body."""
    product = wp.transpose(desired) * rotation
    error = 0.5 * wp.vec3(product[2, 1] - product[1, 2], product[0, 2] - product[2, 0], product[1, 0] - product[0, 1])
    return rate_torque(gains, ang_vel, wp.transpose(product) * rate) - wp.cw_mul(gains.attitude, error)


@wp.func
def attitude_from_force(force: wp.vec3, heading: wp.vec3) -> wp.mat33:
    """Return the rotation with body z along ``force`` and body x nearest to ``heading``."""
    b3 = wp.normalize(force)
    b2 = wp.normalize(wp.cross(b3, heading))
    return wp.matrix_from_cols(wp.cross(b2, b3), b2, b3)


@wp.func
def body_rates(rotation: wp.mat33, yaw_rate: float, limit: float) -> wp.vec3:
    """Return the body rates [rad/s] of a yaw rate, clamped, with roll and pitch held: it times the third row of R."""
    return wp.clamp(yaw_rate, -limit, limit) * wp.vec3(rotation[2, 0], rotation[2, 1], rotation[2, 2])


@wp.func
def acceleration_wrench(
    gains: Gains, attitude: wp.quat, ang_vel: wp.vec3, acceleration: wp.vec3, heading: wp.vec3, yaw_rate: float
) -> wp.spatial_vector:
    """Return the wrench that gives an acceleration [m/s², world]: ``F = m (a - g)`` within the inclination."""
    weight = gains.mass * gains.gravity
    up = wp.max(gains.mass * acceleration[2] + weight, 0.1 * weight)
    lateral = gains.mass * wp.vec2(acceleration[0], acceleration[1])
    shrink = wp.min(gains.max_slope * up / wp.max(wp.length(lateral), 1.0e-9), 1.0)
    force = wp.vec3(shrink * lateral[0], shrink * lateral[1], up)
    rotation = wp.quat_to_matrix(attitude)
    thrust = wp.dot(force, wp.vec3(rotation[0, 2], rotation[1, 2], rotation[2, 2]))
    rate = body_rates(rotation, yaw_rate, gains.max_yaw_rate)
    torque = attitude_torque(gains, rotation, attitude_from_force(force, heading), ang_vel, rate)
    return wp.spatial_vector(wp.vec3(0.0, 0.0, thrust), torque)


@wp.func
def position_control(
    position: wp.vec3, attitude: wp.quat, lin_vel: wp.vec3, ang_vel: wp.vec3, action: wp.vec4, gains: Gains
) -> wp.spatial_vector:
    """Return the wrench for x, y, z [m, world] and yaw [rad]."""
    error = wp.vec3(action[0], action[1], action[2]) - position
    acceleration = wp.cw_mul(gains.position, error) - wp.cw_mul(gains.velocity, lin_vel)
    heading = wp.vec3(wp.cos(action[3]), wp.sin(action[3]), 0.0)
    return acceleration_wrench(gains, attitude, ang_vel, acceleration, heading, 0.0)


@wp.func
def velocity_control(
    position: wp.vec3, attitude: wp.quat, lin_vel: wp.vec3, ang_vel: wp.vec3, action: wp.vec4, gains: Gains
) -> wp.spatial_vector:
    """Return the wrench for vx, vy, vz [m/s, vehicle frame] and yaw rate [rad/s]."""
    heading = heading_of(attitude)
    wanted = wp.vec3(
        heading[0] * action[0] - heading[1] * action[1], heading[1] * action[0] + heading[0] * action[1], action[2]
    )
    acceleration = wp.cw_mul(gains.velocity, wanted - lin_vel)
    return acceleration_wrench(gains, attitude, ang_vel, acceleration, heading, action[3])


@wp.func
def acceleration_control(
    position: wp.vec3, attitude: wp.quat, lin_vel: wp.vec3, ang_vel: wp.vec3, action: wp.vec4, gains: Gains
) -> wp.spatial_vector:
    """Return the wrench for ax, ay, az [m/s², world] and yaw rate [rad/s]."""
    acceleration = wp.vec3(action[0], action[1], action[2])
    return acceleration_wrench(gains, attitude, ang_vel, acceleration, heading_of(attitude), action[3])


@wp.func
def attitude_control(
    position: wp.vec3, attitude: wp.quat, lin_vel: wp.vec3, ang_vel: wp.vec3, action: wp.vec4, gains: Gains
) -> wp.spatial_vector:
    """Return the wrench for thrust [multiples of weight, 0 is hover], roll, pitch [rad] and yaw rate [rad/s]."""
    heading = heading_of(attitude)
    sr, cr = wp.sin(action[1]), wp.cos(action[1])
    sp, cp = wp.sin(action[2]), wp.cos(action[2])
    sy, cy = heading[1], heading[0]
    desired = wp.matrix_from_rows(
        wp.vec3(cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr),
        wp.vec3(sy * cp, sy * sp * sr + cy * cr, sy * sp * cr - cy * sr),
        wp.vec3(-sp, cp * sr, cp * cr),
    )
    rotation = wp.quat_to_matrix(attitude)
    rate = body_rates(rotation, action[3], gains.max_yaw_rate)
    torque = attitude_torque(gains, rotation, desired, ang_vel, rate)
    thrust = (action[0] + 1.0) * gains.mass * gains.gravity
    return wp.spatial_vector(wp.vec3(0.0, 0.0, thrust), torque)


@wp.func
def rates_control(
    position: wp.vec3, attitude: wp.quat, lin_vel: wp.vec3, ang_vel: wp.vec3, action: wp.vec4, gains: Gains
) -> wp.spatial_vector:
    """Return the wrench for thrust [multiples of weight, 0 is hover] and body rates p, q, r [rad/s]."""
    torque = rate_torque(gains, ang_vel, wp.vec3(action[1], action[2], action[3]))
    thrust = (action[0] + 1.0) * gains.mass * gains.gravity
    return wp.spatial_vector(wp.vec3(0.0, 0.0, thrust), torque)
