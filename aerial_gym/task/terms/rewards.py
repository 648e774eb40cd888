"""Terms of rewards: pure functions of tensors of one instant, (E, ...) to (E,). No branch on a tensor.

``bell(x, h, w) = h exp(-w x²)`` is the shape of the Aerial Gym Simulator's terms, ``cusp(x, h, w) = h exp(-w |x|)`` its sharp
one; a penalty is one of these less its height.
Letters: E environments, U entries of a command.
"""

from math import inf

import torch
from torch import Tensor

from aerial_gym.control.laws import LAWS
from aerial_gym.math.quaternion import yaw_from_quat
from aerial_gym.task.terms.gate_path import gate_path_length
from aerial_gym.task.terms.term import TermRegistry

REWARDS = TermRegistry("reward term")  # Terms by the name that a task configuration uses
VELOCITY = LAWS["velocity"].action  # Command: forward, left and upward velocity, and yaw rate


def bell(x: Tensor, height: float, width: float) -> Tensor:
    """Return ``height exp(-width x²)``."""
    return height * torch.exp(-width * x * x)


def dip(x: Tensor, height: float, width: float) -> Tensor:
    """Return ``height (exp(-width x²) - 1)``: a penalty from 0 at x = 0 down to ``-height``."""
    return bell(x, height, width) - height


def cusp(x: Tensor, height: float, width: float) -> Tensor:
    """Return ``height exp(-width |x|)``."""
    return height * torch.exp(-width * x.abs())


def body_up_component(attitude: Tensor) -> Tensor:
    """Return the world z component of body z, ``R33 = 1 - 2 (x² + y²)``, (E,)."""
    return 1.0 - 2.0 * (attitude[:, 0] ** 2 + attitude[:, 1] ** 2)


def _point_distance(a: Tensor, b: Tensor) -> Tensor:
    return (a - b).norm(dim=-1)


@REWARDS.term()
def constant(robot_position: Tensor, *, value: float = 1.0) -> Tensor:
    """Return a constant reward per step, (E,), for staying alive."""
    return torch.full_like(robot_position[:, 0], value)


@REWARDS.term()
def distance_bell(target_position: Tensor, robot_position: Tensor, *, height: float, width: float) -> Tensor:
    """Return ``height exp(-width d²)``, d the distance to the target [m], (E,)."""
    return bell(_point_distance(target_position, robot_position), height, width)


@REWARDS.term()
def distance_cusp(target_position: Tensor, robot_position: Tensor, *, height: float, width: float) -> Tensor:
    """Return ``height exp(-width d)``, d the distance to the target [m], (E,)."""
    return cusp(_point_distance(target_position, robot_position), height, width)


@REWARDS.term()
def position_bells(
    target_position: Tensor, robot_position: Tensor, *, height: float, width: float,
    stretch: tuple[float, float, float] = (1.0, 1.0, 1.0),
) -> Tensor:  # fmt: skip
    """Return the sum over axes of ``height exp(-width (s e)²)``, e the position error [m], world, s the stretch, (E,)."""
    errors = (target_position - robot_position).unbind(-1)
    x, y, z = (bell(factor * error, height, width) for factor, error in zip(stretch, errors, strict=True))
    return x + y + z


@REWARDS.term()
def distance_linear(target_position: Tensor, robot_position: Tensor, *, offset: float, scale: float) -> Tensor:
    """Return ``(offset - d) / scale``, d the distance to the target [m], (E,)."""
    return (offset - _point_distance(target_position, robot_position)) / scale


@REWARDS.term()
def distance_rounded(
    target_position: Tensor, robot_position: Tensor, *, offset: float, scale: float, width: float
) -> Tensor:
    """Return ``(offset - sqrt(d² + width²)) / scale``, d the distance to the target [m], (E,): smooth also at the target."""
    error = target_position - robot_position
    return (offset - ((error * error).sum(-1) + width * width).sqrt()) / scale


@REWARDS.term()
def progress(
    target_position: Tensor, robot_position: Tensor, previous_distance: Tensor, *, closer: float, further: float
) -> Tensor:
    """Return the decrease of the target distance in this step [m], times ``closer`` if > 0, else ``further``, (E,)."""
    gained = previous_distance - _point_distance(target_position, robot_position)
    return torch.where(gained > 0.0, closer, further) * gained


@REWARDS.term()
def velocity_error_bell(target_velocity: Tensor, robot_linvel: Tensor, *, height: float, width: float) -> Tensor:
    """Return ``height exp(-width e²)``, e the difference between the target's velocity and the robot's [m/s], (E,)."""
    return bell(_point_distance(target_velocity, robot_linvel), height, width)


@REWARDS.term()
def velocity_error_cost(target_velocity: Tensor, robot_linvel: Tensor, *, weight: float) -> Tensor:
    """Return ``-weight e²``, e the difference between the target's velocity and the robot's [m/s], (E,)."""
    error = target_velocity - robot_linvel
    return -weight * (error * error).sum(-1)


@REWARDS.term()
def speed_cost(robot_linvel: Tensor, *, weight: float) -> Tensor:
    """Return ``-weight v²``, v the speed [m/s], (E,)."""
    return -weight * (robot_linvel * robot_linvel).sum(-1)


@REWARDS.term()
def turning_cost(robot_body_angvel: Tensor, *, weight: float) -> Tensor:
    """Return ``-weight |w|²``, w the angular velocity [rad/s], (E,)."""
    return -weight * (robot_body_angvel * robot_body_angvel).sum(-1)


@REWARDS.term()
def upright(robot_orientation: Tensor, *, height: float, offset: float) -> Tensor:
    """Return ``height / (offset + t²)`` with t = 1 - R33, which is 0 for an upright body, (E,)."""
    tilt = 1.0 - body_up_component(robot_orientation)
    return height / (offset + tilt * tilt)


@REWARDS.term()
def tilt_bell(robot_orientation: Tensor, *, height: float, width: float) -> Tensor:
    """Return ``height exp(-width t²)`` with t = 1 - R33, which is 0 for an upright body, (E,)."""
    return bell(1.0 - body_up_component(robot_orientation), height, width)


@REWARDS.term()
def nose_along_x_bell(robot_orientation: Tensor, *, height: float, width: float) -> Tensor:
    """Return ``height exp(-width t²)`` with t = 1 - R11, which is 0 where body x is along world x, (E,)."""
    _, y, z, _ = robot_orientation.unbind(-1)
    return bell(2.0 * (y * y + z * z), height, width)


@REWARDS.term()
def yaw_cusp(robot_orientation: Tensor, *, height: float, width: float) -> Tensor:
    """Return ``height exp(-width |yaw|)``, yaw from -pi to pi [rad], (E,)."""
    return cusp(yaw_from_quat(robot_orientation), height, width)


@REWARDS.term()
def velocity_bells(robot_linvel: Tensor, *, height: float, width: float) -> Tensor:
    """Return the sum over axes of ``height exp(-width v²)``, v the velocity [m/s], world, (E,)."""
    return bell(robot_linvel, height, width).sum(dim=-1)


@REWARDS.term()
def rates_bells(robot_body_angvel: Tensor, *, height: float, width: float) -> Tensor:
    """Return the sum over axes of ``height exp(-width w²)``, w the angular velocity [rad/s], body, (E,)."""
    return bell(robot_body_angvel, height, width).sum(dim=-1)


@REWARDS.term()
def still(robot_body_angvel: Tensor, *, height: float) -> Tensor:
    """Return ``height / (1 + |w|²)``, w the angular velocity [rad/s], (E,)."""
    return height / (1.0 + (robot_body_angvel * robot_body_angvel).sum(-1))


@REWARDS.term()
def calm(robot_body_angvel: Tensor, *, height: float, width: float) -> Tensor:
    """Return ``height exp(-width w²)``, w the size of the angular velocity [rad/s], (E,)."""
    return bell(robot_body_angvel.norm(dim=-1), height, width)


@REWARDS.term()
def yaw_rate_bell(robot_body_angvel: Tensor, *, height: float, width: float) -> Tensor:
    """Return ``height exp(-width w_z²)``, w_z the rate about body z [rad/s], (E,)."""
    return bell(robot_body_angvel[:, 2], height, width)


@REWARDS.term()
def roll_pitch_bells(robot_euler_angles: Tensor, *, height: float, width: float) -> Tensor:
    """Return the sum over roll and pitch [rad] of ``height exp(-width angle²)``, (E,)."""
    return bell(robot_euler_angles[:, :2], height, width).sum(dim=-1)


@REWARDS.term()
def joint_rates_size(dof_velocity: Tensor, *, height: float, width: float) -> Tensor:
    """Return the sum over joints of ``height (exp(-width q'²) - 1)``, q' the rate of a joint [rad/s], (E,)."""
    return dip(dof_velocity, height, width).sum(dim=-1)


@REWARDS.term()
def slow(robot_linvel: Tensor, *, height: float, width: float) -> Tensor:
    """Return ``height exp(-width v²)``, v the speed [m/s], (E,)."""
    return bell(robot_linvel.norm(dim=-1), height, width)


@REWARDS.term()
def load_distance_bell(load_target: Tensor, load_position: Tensor, *, height: float, width: float) -> Tensor:
    """Return ``height exp(-width d²)``, d the distance of the load to its target [m], (E,)."""
    return bell(_point_distance(load_target, load_position), height, width)


@REWARDS.term()
def load_slow(load_linvel: Tensor, *, height: float, width: float) -> Tensor:
    """Return ``height exp(-width v²)``, v the speed of the load [m/s], (E,)."""
    return bell(load_linvel.norm(dim=-1), height, width)


@REWARDS.term()
def action_size(robot_actions: Tensor, *, entry: int, height: float, width: float) -> Tensor:
    """Return ``height (exp(-width u²) - 1)``, u an entry of the command, (E,)."""
    return dip(robot_actions[:, entry], height, width)


@REWARDS.term()
def action_change(
    robot_actions: Tensor, robot_prev_actions: Tensor, *, entry: int, height: float, width: float
) -> Tensor:
    """Return ``height (exp(-width du²) - 1)``, du the change of an entry of the command since the last step, (E,)."""
    return dip((robot_actions - robot_prev_actions)[:, entry], height, width)


@REWARDS.term()
def all_actions_size(robot_actions: Tensor, *, offset: float, height: float, width: float) -> Tensor:
    """Return the sum over entries of ``height (exp(-width (u - offset)²) - 1)``, u an entry of the command, (E,)."""
    return dip(robot_actions - offset, height, width).sum(dim=-1)


@REWARDS.term()
def all_actions_square(robot_actions: Tensor, *, offset: float, weight: float) -> Tensor:
    """Return the sum over entries of ``weight (u - offset)²``, u an entry of the command, (E,)."""
    return weight * (robot_actions - offset).square().sum(dim=-1)


@REWARDS.term()
def all_actions_change(robot_actions: Tensor, robot_prev_actions: Tensor, *, height: float, width: float) -> Tensor:
    """Return the sum over entries of ``height (exp(-width du²) - 1)``, du its change since the last step, (E,)."""
    return dip(robot_actions - robot_prev_actions, height, width).sum(dim=-1)


@REWARDS.term()
def all_actions_size_cusp(robot_actions: Tensor, *, height: float, width: float) -> Tensor:
    """Return the sum over entries of ``height (exp(-width |u|) - 1)``, u an entry of the command, (E,)."""
    return (cusp(robot_actions, height, width) - height).sum(dim=-1)


@REWARDS.term()
def all_actions_change_cusp(
    robot_actions: Tensor, robot_prev_actions: Tensor, *, height: float, width: float
) -> Tensor:
    """Return the sum over entries of ``height (exp(-width |du|) - 1)``, du its change since the last step, (E,)."""
    return (cusp(robot_actions - robot_prev_actions, height, width) - height).sum(dim=-1)


REWARDS.term("velocity_command_size", command=VELOCITY)(action_size)
REWARDS.term("velocity_command_change", command=VELOCITY)(action_change)


@REWARDS.term()
def clearance_penalty(robot_clearance: Tensor, *, distance: float) -> Tensor:
    """Return ``-max(1 - clearance / distance, 0)``, distance in m, (E,)."""
    return -((distance - robot_clearance.clamp(0.0, inf)) / distance).clamp_min(0.0)


@REWARDS.term()
def target_reached(target_reached: Tensor, *, value: float = 1.0) -> Tensor:
    """Return ``value`` in the step that reaches a point of a sequence, else 0, (E,)."""
    return value * target_reached.float()


@REWARDS.term()
def gate_passed(gate_passed: Tensor, *, value: float = 1.0) -> Tensor:
    """Return ``value`` in the step that passes the gate, else 0, (E,)."""
    return value * gate_passed.float()


@REWARDS.term()
def way_gained(
    target_position: Tensor, target_orientation: Tensor, robot_position: Tensor, previous_way: Tensor,
    gate_passed: Tensor,
) -> Tensor:  # fmt: skip
    """Return the decrease of the path length through the next gate in this step [m], (E,)."""
    way = gate_path_length(target_position, target_orientation, robot_position)
    return previous_way - torch.where(gate_passed, 0.0, way)
