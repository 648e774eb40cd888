"""Geometric control of multirotors on SE(3): pure functions from state and command to a body wrench.

The laws are computed in body axes: the columns of ``R^T Rd`` are the wanted axes as the body sees them. Euler angles are
avoided: *up*, the third row of R, is (-sin pitch, sin roll cos pitch, cos roll cos pitch).
Source: Lee, Leok, McClamroch (2010), Geometric tracking control of a quadrotor UAV on SE(3), eq. 10-16; the split into
position, velocity, acceleration, attitude and rate control and the command conventions follow the Aerial Gym Simulator.
Source of the reduced-attitude error (tilt before heading): Brescianini, Hehn, D'Andrea (2013), Nonlinear quadrocopter attitude
control, ETH Zurich.
Frames: world z up, body x forward, y left, z up; the *vehicle* frame is the world turned by the yaw alone.
Letters: E environments.
"""

from dataclasses import dataclass, field
from math import tan

import torch
from torch import Tensor

from aerial_gym.math.quaternion import (
    quat_conjugate,
    quat_multiply,
    quat_rotate,
    quat_rotate_inverse,
    quat_to_matrix,
    world_up,
)
from aerial_gym.math.rows import atan2, dot, unit_vector
from aerial_gym.physics.state import BodyState
from aerial_gym.physics.vehicle import share_row

LEAST_LIFT = 0.1  # Least upward part of the force setpoint, as a share of the weight, so that no vehicle turns over
SMALLEST_SQUARE = 1e-30  # Least square of a length in a quotient, which keeps it finite in float32


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
    weight_per_mass: Tensor = field(init=False)  # Gravity as rows [m/s²], (E,)
    yaw_rate_limit: Tensor = field(init=False)  # The largest yaw rate as rows [rad/s], (E,)
    max_slope: Tensor = field(init=False)  # Tangent of the largest inclination, (E,)

    def __post_init__(self) -> None:
        rows = {
            "weight_per_mass": self.gravity,
            "yaw_rate_limit": self.max_yaw_rate,
            "max_slope": tan(self.max_inclination),
        }
        for name, value in rows.items():
            row = torch.full((), value, dtype=self.mass.dtype, device=self.mass.device)
            object.__setattr__(self, name, share_row(row, len(self.mass)))


def attitude_error(turn: Tensor) -> Tensor:
    """Return ``vee(Rd^T R - R^T Rd) / 2`` [rad for small errors], body, (E, 3), for ``turn = R^T Rd``, (E, 3, 3).

    Source: Lee (2010), eq. 10.
    """
    skew = turn.transpose(1, 2) - turn
    return 0.5 * torch.stack((skew[:, 2, 1], skew[:, 0, 2], skew[:, 1, 0]), dim=-1)


def body_rates_of_yaw_rate(attitude: Tensor, yaw_rate: Tensor) -> Tensor:
    """Return the body rates [rad/s], (E, 3), of a yaw rate (E,) with roll and pitch held: ``psi' R^T e_z``.

    Source: Diebel (2006), Representing Attitude, eq. 287: ``w = psi' (-sin th, sin ph cos th, cos ph cos th)``.
    """
    return yaw_rate.unsqueeze(-1) * world_up(attitude)


def attitude_from_force(force: Tensor, heading: Tensor) -> Tensor:
    """Return the axes with z along ``force`` (E, 3) and x nearest to ``heading`` (E, 3), as columns, (E, 3, 3).

    Source: Lee (2010), eq. 12 and the text after it.
    """
    b3 = unit_vector(force)
    b2 = unit_vector(torch.linalg.cross(b3, heading))
    return torch.stack((torch.linalg.cross(b2, b3), b2, b3), dim=-1)


def heading_of_yaw(attitude: Tensor, yaw: Tensor) -> Tensor:
    """Return the horizontal unit vector of a yaw (E,) in body axes, (E, 3)."""
    return quat_rotate_inverse(attitude, torch.stack((torch.cos(yaw), torch.sin(yaw), torch.zeros_like(yaw)), dim=-1))


def inverse_cos_pitch(up: Tensor) -> Tensor:
    """Return ``1 / cos pitch``, (E,), finite at a pitch of 90 degrees, from world z in body axes (E, 3)."""
    return 1.0 / (up[:, 1] * up[:, 1] + up[:, 2] * up[:, 2]).clamp_min(SMALLEST_SQUARE).sqrt()


def vehicle_x_in_body_axes(up: Tensor) -> Tensor:
    """Return vehicle x in body axes, (E, 3): (cos pitch, sin roll sin pitch, cos roll sin pitch)."""
    inverse = inverse_cos_pitch(up)
    slope = -up[:, 0] * inverse
    cosine = (up[:, 1] * up[:, 1] + up[:, 2] * up[:, 2]) * inverse
    return torch.stack((cosine, slope * up[:, 1], slope * up[:, 2]), dim=-1)


def from_vehicle_frame(attitude: Tensor, vector: Tensor) -> Tensor:
    """Return a vector (E, 3) of the vehicle frame in the world, (E, 3)."""
    (qx, qy, qz, qw), (x, y, z) = attitude.unbind(-1), vector.unbind(-1)
    inverse = inverse_cos_pitch(world_up(attitude))
    cosine = inverse * (1.0 - 2.0 * (qy * qy + qz * qz))
    sine = inverse * 2.0 * (qx * qy + qw * qz)
    return torch.stack((cosine * x - sine * y, sine * x + cosine * y, z), dim=-1)


def attitude_torque(gains: LeeGains, turn: Tensor, ang_vel: Tensor, rate: Tensor) -> Tensor:
    """Return ``-K_R e_R - K_w e_w + w x J w`` [N m], body, (E, 3). Source: Lee (2010), eq. 16 without feed-forward.

    Args:
        turn: ``R^T Rd``, wanted to actual body axes, (E, 3, 3).
        ang_vel: Angular velocity w [rad/s], body, (E, 3).
        rate: Wanted angular velocity [rad/s], in the wanted body frame, (E, 3).
    """
    wanted = (turn * rate.unsqueeze(1)).sum(-1)
    return rate_torque(gains, ang_vel, wanted) - gains.attitude * attitude_error(turn)


def rate_torque(gains: LeeGains, ang_vel: Tensor, rate: Tensor) -> Tensor:
    """Return ``-K_w (w - w_d) + w x J w`` [N m], body, (E, 3)."""
    momentum = (gains.inertia * ang_vel.unsqueeze(1)).sum(-1)
    return torch.linalg.cross(ang_vel, momentum) - gains.rate * (ang_vel - rate)


def limit_inclination(force: Tensor, minimum: Tensor, max_slope: Tensor | float) -> Tensor:
    """Return the force (E, 3) with z at least ``minimum`` (E,) [N] and a slope, tan of its inclination, within its limit."""
    x, y, z = force.unbind(-1)
    up = torch.maximum(z, minimum)
    shrink = (max_slope * up / (x * x + y * y).clamp_min(1e-18).sqrt()).clamp_max(1.0)
    return torch.stack((shrink * x, shrink * y, up), dim=-1)


def force_within_inclination(acceleration: Tensor, gains: LeeGains) -> Tensor:
    """Return the force ``m (a - g)`` [N], world, (E, 3), of an acceleration [m/s²] (E, 3), within the inclination."""
    weight = gains.mass * gains.weight_per_mass
    x, y, z = (gains.mass.unsqueeze(-1) * acceleration).unbind(-1)
    return limit_inclination(torch.stack((x, y, z + weight), dim=-1), LEAST_LIFT * weight, gains.max_slope)


def force_wrench(state: BodyState, force: Tensor, heading: Tensor, yaw_rate: Tensor | None, gains: LeeGains) -> Tensor:
    """Return the wrench (E, 6), body: the part of a force along body z, and the torque that turns body z along the force.

    Args:
        force: [N], world, (E, 3).
        heading: Wanted direction of body x, body, (E, 3).
        yaw_rate: Rate at which the heading turns [rad/s], within its limits, (E,); None if it does not.
    """
    along = quat_rotate_inverse(state.attitude, force)
    turn = attitude_from_force(along, heading)
    still = torch.zeros_like(state.ang_vel)
    rate = still if yaw_rate is None else body_rates_of_yaw_rate(state.attitude, yaw_rate)
    return thrust_wrench(along[:, 2], attitude_torque(gains, turn, state.ang_vel, rate))


def acceleration_wrench(
    state: BodyState, acceleration: Tensor, yaw: Tensor, yaw_rate: Tensor | None, gains: LeeGains
) -> Tensor:
    """Return the wrench (E, 6), body, that gives an acceleration: ``F = m (a - g)``, thrust ``F . b3``, attitude along F.

    Args:
        acceleration: Wanted acceleration [m/s²], world, (E, 3).
        yaw: Wanted heading [rad], (E,).
        yaw_rate: Rate at which the heading turns [rad/s], (E,); None if it does not.
    """
    heading, force = heading_of_yaw(state.attitude, yaw), force_within_inclination(acceleration, gains)
    rate = None if yaw_rate is None else yaw_rate_within_limits(yaw_rate, gains)
    return force_wrench(state, force, heading, rate, gains)


def yaw_rate_within_limits(yaw_rate: Tensor, gains: LeeGains) -> Tensor:
    """Return the yaw rate [rad/s], (E,), within its limits."""
    return yaw_rate.clamp(-gains.yaw_rate_limit, gains.yaw_rate_limit)


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
    x, y, z = (gains.position * (action[:, :3] - state.position) - gains.velocity * state.lin_vel).unbind(-1)
    acceleration = torch.stack((x, y, z + gains.weight_per_mass), dim=-1)
    force = gains.mass.unsqueeze(-1) * quat_rotate_inverse(state.attitude, acceleration)
    size = dot(action[:, 3:], action[:, 3:]).unsqueeze(-1).sqrt()
    level = torch.zeros_like(action[:, 3:]) + action.new_tensor((0.0, 0.0, 0.0, 1.0))
    wanted = quat_to_matrix(torch.where(size > 0.0, action[:, 3:] / torch.where(size > 0.0, size, 1.0), level))
    d1, d2 = (quat_rotate_inverse(state.attitude, wanted[:, :, k]) for k in (0, 1))
    turn = torch.stack((d1, d2, torch.linalg.cross(d1, d2)), dim=-1)
    return torch.cat((force, attitude_torque(gains, turn, state.ang_vel, torch.zeros_like(state.ang_vel))), dim=-1)


def steering_control(state: BodyState, action: Tensor, gains: LeeGains) -> Tensor:
    """Return the wrench for vx, vy, vz [m/s, vehicle frame] and yaw [rad], action (E, 4)."""
    wanted = from_vehicle_frame(state.attitude, action[:, :3])
    return acceleration_wrench(state, gains.velocity * (wanted - state.lin_vel), action[:, 3], None, gains)


def velocity_control(state: BodyState, action: Tensor, gains: LeeGains) -> Tensor:
    """Return the wrench for vx, vy, vz [m/s, vehicle frame] and yaw rate [rad/s], action (E, 4)."""
    wanted, heading = (
        from_vehicle_frame(state.attitude, action[:, :3]),
        vehicle_x_in_body_axes(world_up(state.attitude)),
    )
    force = force_within_inclination(gains.velocity * (wanted - state.lin_vel), gains)
    return force_wrench(state, force, heading, yaw_rate_within_limits(action[:, 3], gains), gains)


def acceleration_control(state: BodyState, action: Tensor, gains: LeeGains) -> Tensor:
    """Return the wrench for ax, ay, az [m/s², world] and yaw rate [rad/s], action (E, 4)."""
    heading, force = vehicle_x_in_body_axes(world_up(state.attitude)), force_within_inclination(action[:, :3], gains)
    return force_wrench(state, force, heading, yaw_rate_within_limits(action[:, 3], gains), gains)


def attitude_control(state: BodyState, action: Tensor, gains: LeeGains) -> Tensor:
    """Return the wrench for thrust [multiples of weight, 0 is hover], roll, pitch [rad], yaw rate [rad/s], action (E, 4).

    The wanted attitude has the heading of the body.
    """
    up = world_up(state.attitude)
    turn = axes_at_roll_and_pitch(up, action[:, 1], action[:, 2])
    rate = body_rates_of_yaw_rate(state.attitude, yaw_rate_within_limits(action[:, 3], gains))
    torque = attitude_torque(gains, turn, state.ang_vel, rate)
    return thrust_wrench((action[:, 0] + 1.0) * gains.mass * gains.weight_per_mass, torque)


def rates_control(state: BodyState, action: Tensor, gains: LeeGains) -> Tensor:
    """Return the wrench for thrust [multiples of weight, 0 is hover] and body rates p, q, r [rad/s], action (E, 4)."""
    torque = rate_torque(gains, state.ang_vel, action[:, 1:4])
    return thrust_wrench((action[:, 0] + 1.0) * gains.mass * gains.weight_per_mass, torque)


def axes_at_roll_and_pitch(up: Tensor, roll: Tensor, pitch: Tensor) -> Tensor:
    """Return the axes, as columns in body axes, (E, 3, 3), of a body with the same heading at a roll and pitch [rad], (E,).

    The axes of the vehicle frame are turned by the pitch about y, then by the roll about x.

    Args:
        up: World z in body axes, (E, 3).
    """
    (sr, cr), (sp, cp) = ((torch.sin(a).unsqueeze(-1), torch.cos(a).unsqueeze(-1)) for a in (roll, pitch))
    ahead, inverse = vehicle_x_in_body_axes(up), inverse_cos_pitch(up)
    left = torch.stack((torch.zeros_like(inverse), up[:, 2] * inverse, -up[:, 1] * inverse), dim=-1)
    raised = sp * ahead + cp * up
    return torch.stack((cp * ahead - sp * up, sr * raised + cr * left, cr * raised - sr * left), dim=-1)


OPPOSITE = 1e-5  # Length of `a x b` below which opposite a and b have no shortest rotation. Source: PX4, `matrix`


def shortest_turn(a: Tensor, b: Tensor) -> tuple[Tensor, Tensor]:
    """Return the quaternion (E, 4) of the shortest rotation from unit vectors a to b (E, 3), and whether it exists (E, 1).

    Source: Derived: ``(a x b, 1 + a . b)``, normalised.
    """
    cross, dot = torch.linalg.cross(a, b), (a * b).sum(-1, keepdim=True)
    exists = ((cross * cross).sum(-1, keepdim=True) >= OPPOSITE**2) | (dot > 0.0)
    half = torch.cat((cross, torch.where(exists, 1.0 + dot, 1.0)), dim=-1)
    return half / half.norm(dim=-1, keepdim=True), exists


def canonical_quat(q: Tensor) -> Tensor:
    """Return the equal rotation with ``w >= 0``, (E, 4)."""
    return torch.where(q[:, 3:] < 0.0, -q, q)


def unit_z(like: Tensor) -> Tensor:
    """Return a unit vector along z for every row, (E, 3)."""
    return like.new_tensor((0.0, 0.0, 1.0)).expand(len(like), 3)


def unit_x(like: Tensor) -> Tensor:
    """Return a unit vector along x for every row, (E, 3)."""
    return like.new_tensor((1.0, 0.0, 0.0)).expand(len(like), 3)


def tilt_first_error(attitude: Tensor, wanted: Tensor, yaw_share: Tensor) -> Tensor:
    """Return the vector part of the error quaternion, body, (E, 3): shortest rotation of body z, then a share of the heading.

    Args:
        attitude: Body to world, (E, 4).
        wanted: Wanted attitude, (E, 4).
        yaw_share: Share of the heading error, 0 to 1, (E, 1).
    """
    turn, exists = shortest_turn(*(quat_rotate(q, unit_z(q)) for q in (attitude, wanted)))
    tilted = torch.where(exists, quat_multiply(turn, attitude), wanted)
    heading = canonical_quat(quat_multiply(quat_conjugate(tilted), wanted))
    half = yaw_share * atan2(heading[:, 2:3], heading[:, 3:])
    zero = torch.zeros_like(half)
    part = torch.cat((zero, zero, torch.sin(half), torch.cos(half)), dim=-1)
    return canonical_quat(quat_multiply(quat_conjugate(attitude), quat_multiply(tilted, part)))[:, :3]
