"""Terms of flights to a point and a heading: pure functions of tensors of one instant.

The heading error is the target's yaw minus the robot's, -pi to pi: positive where the robot must turn left.
Frames: world is z up; vehicle is the world turned by the robot's yaw. Letters: E environments, U entries of a command.
"""

import torch
from torch import Tensor

from aerial_gym.math.quaternion import quat_rotate_inverse, quat_without_tilt, wrap_angle, yaw_from_quat
from aerial_gym.task.terms.observations import OBSERVATIONS, TINY
from aerial_gym.task.terms.rewards import REWARDS, bell, dip

LEAST_CLOSING_SPEED = 1e-3  # A speed [m/s] below which nothing comes nearer: a wall at 1 cm is 10 s away


def heading_difference(target_yaw: Tensor, robot_orientation: Tensor) -> Tensor:
    """Return target's yaw minus yaw [rad], in [-pi, pi), (E,)."""
    return wrap_angle(target_yaw - yaw_from_quat(robot_orientation))


def _reward_near_target(target_position: Tensor, robot_position: Tensor, radius: float, reward: Tensor) -> Tensor:
    """Return a reward within a radius [m] of the target, 0 elsewhere, (E,)."""
    return torch.where((target_position - robot_position).norm(dim=-1) < radius, reward, 0.0)


@OBSERVATIONS.term(width=1)
def heading_error(target_yaw: Tensor, robot_orientation: Tensor) -> Tensor:
    """Return target's yaw minus yaw [rad], in [-pi, pi), (E, 1)."""
    return heading_difference(target_yaw, robot_orientation).unsqueeze(-1)


@REWARDS.term()
def aligned_distance_bell(
    target_position: Tensor, robot_position: Tensor, target_yaw: Tensor, robot_orientation: Tensor, *, height: float,
    width: float, yaw_width: float,
) -> Tensor:  # fmt: skip
    """Return ``height exp(-width d² - yaw_width e²)``, d the distance [m] and e the heading error [rad], (E,)."""
    aligned = bell(heading_difference(target_yaw, robot_orientation), 1.0, yaw_width)
    return aligned * bell((target_position - robot_position).norm(dim=-1), height, width)


@REWARDS.term()
def flight_to_target(
    target_position: Tensor, robot_position: Tensor, robot_linvel: Tensor, *, speed: float, height: float,
    width: float, away: float, near: float,
) -> Tensor:  # fmt: skip
    """Return a reward for velocity v [m/s] toward the target, near a desired ``speed``, (E,).

    ``cos a height exp(-width (|v| - speed)²)`` where the cosine of the angle a between v and the direction to the target is
    > 0, else ``away``; times ``min(d / near, 1)`` with the distance d [m].
    """
    error = target_position - robot_position
    distance, flown = error.norm(dim=-1), robot_linvel.norm(dim=-1)
    cosine = (error * robot_linvel).sum(-1) / (distance.clamp_min(TINY) * flown.clamp_min(TINY))
    worth = torch.where(cosine > 0.0, cosine * bell(flown - speed, height, width), away)
    return worth * (distance / near).clamp_max(1.0)


@REWARDS.term()
def slow_at_target(
    target_position: Tensor, robot_position: Tensor, robot_linvel: Tensor, *, radius: float, height: float, width: float
) -> Tensor:
    """Return ``height exp(-width v²)``, v the speed [m/s], closer to the target than a radius [m], else 0, (E,)."""
    return _reward_near_target(target_position, robot_position, radius, bell(robot_linvel.norm(dim=-1), height, width))


@REWARDS.term()
def heading_at_target(
    target_position: Tensor, robot_position: Tensor, target_yaw: Tensor, robot_orientation: Tensor, *, radius: float,
    height: float, width: float,
) -> Tensor:  # fmt: skip
    """Return ``height exp(-width e²)``, e the heading error [rad], closer to the target than a radius [m], else 0, (E,)."""
    worth = bell(heading_difference(target_yaw, robot_orientation), height, width)
    return _reward_near_target(target_position, robot_position, radius, worth)


@REWARDS.term()
def aligned_rest_at_target(
    target_position: Tensor, robot_position: Tensor, target_yaw: Tensor, robot_orientation: Tensor,
    robot_body_angvel: Tensor, *, radius: float, height: float, width: float, yaw_width: float,
) -> Tensor:  # fmt: skip
    """Return ``height exp(-width r² - yaw_width e²)`` closer to the target than a radius [m], else 0, (E,).

    r is the angular velocity about body z [rad/s], e the heading error [rad].
    """
    aligned = bell(heading_difference(target_yaw, robot_orientation), 1.0, yaw_width)
    return _reward_near_target(
        target_position, robot_position, radius, aligned * bell(robot_body_angvel[:, 2], height, width)
    )


@REWARDS.term()
def speeding(robot_linvel: Tensor, *, speed: float, height: float, width: float) -> Tensor:
    """Return ``height (exp(-width s²) - 1)``, s the excess of the speed over a limit [m/s], >= 0, (E,)."""
    return dip((robot_linvel.norm(dim=-1) - speed).clamp_min(0.0), height, width)


@REWARDS.term()
def unseen_flight(
    target_position: Tensor, robot_position: Tensor, robot_linvel: Tensor, robot_orientation: Tensor, *, looks: float,
    height: float, width: float, near_width: float,
) -> Tensor:  # fmt: skip
    """Return ``height (exp(-width u²) - 1) (1 - exp(-near_width d²))``, (E,), for a robot that looks ahead (1) or back (-1).

    u is the velocity to where it does not look [m/s], vehicle frame, 0 to where it does; d the distance to the target [m].
    """
    unseen = (-looks * quat_rotate_inverse(quat_without_tilt(robot_orientation), robot_linvel)[:, 0]).clamp_min(0.0)
    near = bell((target_position - robot_position).norm(dim=-1), 1.0, near_width)
    return dip(unseen, height, width) * (1.0 - near)


@REWARDS.term()
def action_size_by_difficulty(
    robot_actions: Tensor, difficulty: Tensor, *, entry: int, height: float, width: float
) -> Tensor:
    """Return ``c height (exp(-width u²) - 1)``, u an entry of the command and c the difficulty, (E,)."""
    return difficulty * dip(robot_actions[:, entry], height, width)


@REWARDS.term()
def collision_soon(
    robot_clearance: Tensor, previous_clearance: Tensor, step_time: Tensor, *, height: float, width: float
) -> Tensor:
    """Return ``-height exp(-width t⁴)``, t the time to a collision [s]; 0 without an approaching obstacle, (E,).

    t is the clearance divided by the speed at which it fell in the last step.
    """
    closing = (previous_clearance - robot_clearance) / step_time
    time = robot_clearance.clamp_min(0.0) / closing.clamp_min(LEAST_CLOSING_SPEED)
    return torch.where(closing > LEAST_CLOSING_SPEED, -bell(time * time, height, width), 0.0)
