"""Geometric control of multirotors on SE(3): pure functions from state and command to a body wrench.

Source: Lee, Leok, McClamroch (2010), Geometric tracking control of a quadrotor UAV on SE(3), eq. 10-16; the split into
position, velocity, acceleration, attitude and rate control and the command conventions follow the Aerial Gym Simulator.
Frames: world z up, body x forward, y left, z up; the *vehicle* frame is the world turned by the yaw alone.
Letters: E environments.
"""

from dataclasses import dataclass
from math import tan

import torch
from torch import Tensor

from aerial_gym.math.quaternion import quat_from_yaw, quat_rotate, quat_rotate_inverse, quat_to_matrix, yaw_from_quat
from aerial_gym.physics.state import BodyState

LEAST_LIFT = 0.1
"""Least upward component of the force setpoint, as a share of the weight, so that the vehicle never turns over."""


@dataclass(frozen=True, kw_only=True)
class LeeGains:
    """Gains of every environment, and the autopilot's vehicle parameters."""

    position: Tensor  # [1/s²], (E, 3)
    velocity: Tensor  # [1/s], (E, 3)
    attitude: Tensor  # [N m/rad], (E, 3)
    rate: Tensor  # [N m s/rad], (E, 3)
    mass: Tensor  # Declared mass [kg], (E,)
    inertia: Tensor  # Declared inertia [kg m²], (E, 3, 3)
    gravity: float  # [m/s²]
    max_yaw_rate: float  # [rad/s]
    max_inclination: float  # [rad]


def attitude_error(rotation: Tensor, desired: Tensor) -> Tensor:
    """Return ``vee(Rd^T R - R^T Rd) / 2`` [rad for small errors], body, (E, 3). Source: Lee (2010), eq. 10."""
    product = desired.transpose(1, 2) @ rotation
    skew = 0.5 * (product - product.transpose(1, 2))
    return torch.stack((skew[:, 2, 1], skew[:, 0, 2], skew[:, 1, 0]), dim=-1)


def body_rates_of_yaw_rate(rotation: Tensor, yaw_rate: Tensor) -> Tensor:
    """Return the body rates [rad/s], (E, 3), of a yaw rate (E,) with roll and pitch held: ``psi' R^T e_z``.

    Source: Diebel (2006), Representing Attitude, eq. 287: ``w = psi' (-sin th, sin ph cos th, cos ph cos th)``, which is the
    last row of R (E, 3, 3).
    """
    return yaw_rate.unsqueeze(-1) * rotation[:, 2]


def attitude_from_force(force: Tensor, yaw: Tensor) -> Tensor:
    """Return the rotation with body z along ``force`` (E, 3) and body x nearest to heading ``yaw`` (E,), (E, 3, 3).

    Source: Lee (2010), eq. 12 and the text after it.
    """
    b3 = force / force.norm(dim=-1, keepdim=True)
    heading = torch.stack((torch.cos(yaw), torch.sin(yaw), torch.zeros_like(yaw)), dim=-1)
    b2 = torch.linalg.cross(b3, heading)
    b2 = b2 / b2.norm(dim=-1, keepdim=True)
    return torch.stack((torch.linalg.cross(b2, b3), b2, b3), dim=-1)


def attitude_torque(gains: LeeGains, rotation: Tensor, desired: Tensor, ang_vel: Tensor, rate: Tensor) -> Tensor:
    """Return ``-K_R e_R - K_w e_w + w x J w`` [N m], body, (E, 3). Source: Lee (2010), eq. 16 without feed-forward.

    Args:
        rotation: Body to world R, (E, 3, 3).
        desired: Wanted body to world Rd, (E, 3, 3).
        ang_vel: Angular velocity w [rad/s], body, (E, 3).
        rate: Wanted angular velocity [rad/s], in the wanted body frame, (E, 3).
    """
    wanted = (rotation.transpose(1, 2) @ desired @ rate.unsqueeze(-1)).squeeze(-1)
    error = attitude_error(rotation, desired)
    return rate_torque(gains, ang_vel, wanted) - gains.attitude * error


def rate_torque(gains: LeeGains, ang_vel: Tensor, rate: Tensor) -> Tensor:
    """Return ``-K_w (w - w_d) + w x J w`` [N m], body, (E, 3)."""
    momentum = (gains.inertia * ang_vel.unsqueeze(1)).sum(-1)
    return torch.linalg.cross(ang_vel, momentum) - gains.rate * (ang_vel - rate)


def limit_inclination(force: Tensor, minimum: Tensor, max_inclination: float) -> Tensor:
    """Return the force (E, 3) with z at least ``minimum`` (E,) [N] and tilted at most ``max_inclination`` [rad]."""
    up = torch.maximum(force[:, 2], minimum)
    lateral = force[:, :2]
    largest = up * tan(max_inclination)
    shrink = torch.clamp(largest / lateral.norm(dim=-1).clamp_min(1e-9), max=1.0)
    return torch.cat((lateral * shrink.unsqueeze(-1), up.unsqueeze(-1)), dim=-1)


def acceleration_wrench(
    state: BodyState, acceleration: Tensor, yaw: Tensor, yaw_rate: Tensor | None, gains: LeeGains
) -> Tensor:
    """Return the wrench (E, 6), body, that gives an acceleration: ``F = m (a - g)``, thrust ``F . b3``, attitude along F.

    Args:
        acceleration: Wanted acceleration [m/s²], world, (E, 3).
        yaw: Wanted heading [rad], (E,).
        yaw_rate: Rate at which the heading turns [rad/s], (E,); None if it does not.
    """
    weight = gains.mass * gains.gravity
    lateral, up = acceleration[:, :2], acceleration[:, 2:] + gains.gravity
    force = gains.mass.unsqueeze(-1) * torch.cat((lateral, up), dim=-1)
    force = limit_inclination(force, LEAST_LIFT * weight, gains.max_inclination)
    rotation = quat_to_matrix(state.attitude)
    thrust = (force * rotation[:, :, 2]).sum(-1)
    still = torch.zeros_like(state.ang_vel)
    rate = still if yaw_rate is None else body_rates_of_yaw_rate(rotation, _clamp_rate(gains.max_yaw_rate, yaw_rate))
    torque = attitude_torque(gains, rotation, attitude_from_force(force, yaw), state.ang_vel, rate)
    return thrust_wrench(thrust, torque)


def _clamp_rate(largest: float, rate: Tensor) -> Tensor:
    return rate.clamp(-largest, largest)


def thrust_wrench(thrust: Tensor, torque: Tensor) -> Tensor:
    """Return the wrench (E, 6) of a thrust (E,) along body z and a torque (E, 3)."""
    zero = torch.zeros_like(thrust)
    return torch.cat((torch.stack((zero, zero, thrust), dim=-1), torque), dim=-1)


def position_control(state: BodyState, action: Tensor, gains: LeeGains) -> Tensor:
    """Return the wrench for x, y, z [m, world] and yaw [rad], action (E, 4): ``a = K_p e_p + K_v e_v``."""
    acceleration = gains.position * (action[:, :3] - state.position) - gains.velocity * state.lin_vel
    return acceleration_wrench(state, acceleration, action[:, 3], None, gains)


def pose_control(state: BodyState, action: Tensor, gains: LeeGains) -> Tensor:
    """Return the wrench for x, y, z [m] and attitude, xyzw, world, action (E, 7), of a fully actuated vehicle.

    The force ``F = R^T m (K_p e_p - K_v v - g)`` has any direction, and the torque controls attitude. A quaternion of zeros
    stands for the identity.
    """
    acceleration = gains.position * (action[:, :3] - state.position) - gains.velocity * state.lin_vel
    force = gains.mass.unsqueeze(-1) * torch.cat((acceleration[:, :2], acceleration[:, 2:] + gains.gravity), dim=-1)
    size = action[:, 3:].norm(dim=-1, keepdim=True)
    level = torch.zeros_like(action[:, 3:])
    level[:, 3] = 1.0
    desired = quat_to_matrix(torch.where(size > 0.0, action[:, 3:] / torch.where(size > 0.0, size, 1.0), level))
    rotation, still = quat_to_matrix(state.attitude), torch.zeros_like(state.ang_vel)
    torque = attitude_torque(gains, rotation, desired, state.ang_vel, still)
    return torch.cat((quat_rotate_inverse(state.attitude, force), torque), dim=-1)


def steering_control(state: BodyState, action: Tensor, gains: LeeGains) -> Tensor:
    """Return the wrench for vx, vy, vz [m/s, vehicle frame] and yaw [rad], action (E, 4)."""
    wanted = quat_rotate(quat_from_yaw(yaw_from_quat(state.attitude)), action[:, :3])
    return acceleration_wrench(state, gains.velocity * (wanted - state.lin_vel), action[:, 3], None, gains)


def velocity_control(state: BodyState, action: Tensor, gains: LeeGains) -> Tensor:
    """Return the wrench for vx, vy, vz [m/s, vehicle frame] and yaw rate [rad/s], action (E, 4)."""
    yaw = yaw_from_quat(state.attitude)
    wanted = quat_rotate(quat_from_yaw(yaw), action[:, :3])
    return acceleration_wrench(state, gains.velocity * (wanted - state.lin_vel), yaw, action[:, 3], gains)


def acceleration_control(state: BodyState, action: Tensor, gains: LeeGains) -> Tensor:
    """Return the wrench for ax, ay, az [m/s², world] and yaw rate [rad/s], action (E, 4)."""
    return acceleration_wrench(state, action[:, :3], yaw_from_quat(state.attitude), action[:, 3], gains)


def attitude_control(state: BodyState, action: Tensor, gains: LeeGains) -> Tensor:
    """Return the wrench for thrust [multiples of weight, 0 is hover], roll, pitch [rad], yaw rate [rad/s], action (E, 4)."""
    rotation = quat_to_matrix(state.attitude)
    desired = matrix_from_euler(action[:, 1], action[:, 2], yaw_from_quat(state.attitude))
    rate = body_rates_of_yaw_rate(rotation, _clamp_rate(gains.max_yaw_rate, action[:, 3]))
    torque = attitude_torque(gains, rotation, desired, state.ang_vel, rate)
    return thrust_wrench((action[:, 0] + 1.0) * gains.mass * gains.gravity, torque)


def rates_control(state: BodyState, action: Tensor, gains: LeeGains) -> Tensor:
    """Return the wrench for thrust [multiples of weight, 0 is hover] and body rates p, q, r [rad/s], action (E, 4)."""
    torque = rate_torque(gains, state.ang_vel, action[:, 1:4])
    return thrust_wrench((action[:, 0] + 1.0) * gains.mass * gains.gravity, torque)


def matrix_from_euler(roll: Tensor, pitch: Tensor, yaw: Tensor) -> Tensor:
    """Return ``Rz(yaw) Ry(pitch) Rx(roll)``, (E, 3, 3). Source: Diebel (2006), eq. 67."""
    sr, cr, sp, cp = torch.sin(roll), torch.cos(roll), torch.sin(pitch), torch.cos(pitch)
    sy, cy = torch.sin(yaw), torch.cos(yaw)
    rows = (
        cy * cp,
        cy * sp * sr - sy * cr,
        cy * sp * cr + sy * sr,
        sy * cp,
        sy * sp * sr + cy * cr,
        sy * sp * cr - cy * sr,
        -sp,
        cp * sr,
        cp * cr,
    )
    return torch.stack(rows, dim=-1).unflatten(-1, (3, 3))
