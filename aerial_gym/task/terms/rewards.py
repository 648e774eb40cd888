"""Terms of rewards: pure functions of tensors of one instant, (E, ...) to (E,). No branch on a tensor.

``bell(x, h, w) = h exp(-w x²)`` is the shape of the Aerial Gym Simulator's terms, ``cusp(x, h, w) = h exp(-w |x|)`` its sharp
one; a penalty is one of these less its height.
Letters: E environments, U entries of a command.
"""

from collections.abc import Callable, Sequence
from inspect import Parameter, Signature, signature
from math import inf

import torch
from torch import Tensor

from aerial_gym.control.laws import LAWS
from aerial_gym.math.quaternion import yaw_from_quat
from aerial_gym.task.terms.gate_path import gate_path_length
from aerial_gym.task.terms.term import Term, TermRegistry
from aerial_gym.task.vehicles.names import NEAREST

REWARDS = TermRegistry("reward term")  # Terms by the name that a task configuration uses
Quantity = Callable[..., Tensor]  # Function of tensors whose names are those of its arguments
NEAREST_ONE = NEAREST.format(count=1)
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


def _nose_error(attitude: Tensor) -> Tensor:
    """Return 1 minus the world x component of body x, (E,)."""
    _, y, z, _ = attitude.unbind(-1)
    return 2.0 * (y * y + z * z)


def _make_reward(shape: Callable[[Tensor, float, float], Tensor], quantity: Quantity) -> Quantity:
    """Return the term ``shape(x, height, width)`` of a quantity x, (E,), or its sum over the entries of x, (E, W)."""

    def reward(*inputs: Tensor, height: float, width: float) -> Tensor:
        value = shape(quantity(*inputs), height, width)
        return value if value.ndim == 1 else value.sum(dim=-1)

    numbers = [Parameter(number, Parameter.KEYWORD_ONLY) for number in ("height", "width")]
    reward.__signature__ = Signature([*signature(quantity).parameters.values(), *numbers])  # type: ignore[attr-defined]
    return reward


def _register_rewards(
    shape: Callable[[Tensor, float, float], Tensor], formula: str, rows: Sequence[tuple[str, Quantity, str]]
) -> None:
    """Register rewards of a shape by name, quantity, and the letter of the quantity in the formula with its meaning."""
    for name, quantity, text in rows:
        letter, _, meaning = text.partition(": ")
        line = f"Return {formula.format(letter)}, {meaning}, (E,)."
        REWARDS.register(name, Term(name=name, value=_make_reward(shape, quantity), text=line))


_register_rewards(bell, "``height exp(-width {}²)``", (
    ("distance_bell", lambda target_position, robot_position: _point_distance(target_position, robot_position),
     "d: d the distance to the target [m]"),
    ("velocity_error_bell", lambda target_velocity, robot_linvel: _point_distance(target_velocity, robot_linvel),
     "e: e the difference between the target's velocity and the robot's [m/s]"),
    ("tilt_bell", lambda robot_orientation: 1.0 - body_up_component(robot_orientation),
     "t: with t = 1 - R33, which is 0 for an upright body"),
    ("nose_along_x_bell", lambda robot_orientation: _nose_error(robot_orientation),
     "t: with t = 1 - R11, which is 0 where body x is along world x"),
    ("calm", lambda robot_body_angvel: robot_body_angvel.norm(dim=-1), "w: w the size of the angular velocity [rad/s]"),
    ("yaw_rate_bell", lambda robot_body_angvel: robot_body_angvel[:, 2], "w_z: w_z the rate about body z [rad/s]"),
    ("slow", lambda robot_linvel: robot_linvel.norm(dim=-1), "v: v the speed [m/s]"),
    ("load_distance_bell", lambda load_target, load_position: _point_distance(load_target, load_position),
     "d: d the distance of the load to its target [m]"),
    ("payload_distance_bell", lambda target_position, payload_position: _point_distance(target_position, payload_position),
     "d: d the distance of the payload of all vehicles to the target [m]"),
    ("load_slow", lambda load_linvel: load_linvel.norm(dim=-1), "v: v the speed of the load [m/s]"),
))  # fmt: skip
_register_rewards(bell, "the sum of ``height exp(-width {}²)``", (
    ("velocity_bells", lambda robot_linvel: robot_linvel, "v: v the velocity along each axis [m/s], world"),
    ("rates_bells", lambda robot_body_angvel: robot_body_angvel, "w: w the angular velocity about each axis [rad/s], body"),
    ("roll_pitch_bells", lambda robot_euler_angles: robot_euler_angles[:, :2], "angle: of roll and pitch [rad]"),
))  # fmt: skip
_register_rewards(cusp, "``height exp(-width |{}|)``", (
    ("distance_cusp", lambda target_position, robot_position: _point_distance(target_position, robot_position),
     "d: d the distance to the target [m]"),
    ("yaw_cusp", lambda robot_orientation: yaw_from_quat(robot_orientation), "yaw: yaw from -pi to pi [rad]"),
))  # fmt: skip
_register_rewards(dip, "the sum of ``height (exp(-width {}²) - 1)``", (
    ("joint_rates_size", lambda dof_velocity: dof_velocity, "q': q' the rate of each joint [rad/s]"),
    ("all_actions_change", lambda robot_actions, robot_prev_actions: robot_actions - robot_prev_actions,
     "du: du the change of each entry of the command since the last step"),
))  # fmt: skip


@REWARDS.term()
def constant(robot_position: Tensor, *, value: float = 1.0) -> Tensor:
    """Return a constant reward per step, (E,), for staying alive."""
    return torch.full_like(robot_position[:, 0], value)


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
def way_shortened(way_to_target: Tensor, previous_way_to_target: Tensor) -> Tensor:
    """Return the decrease of the length of the way to the target in this step [m], (E,)."""
    return previous_way_to_target - way_to_target


@REWARDS.term(named={"nearest": NEAREST_ONE})
def nearby_vehicles(nearest: Tensor, *, distance: float) -> Tensor:
    """Return ``-max(1 - d / distance, 0)``, d the distance of the nearest other vehicle [m], (E,)."""
    apart = nearest[:, :3].norm(dim=-1)
    return -nearest[:, 6] * (1.0 - apart / distance).clamp_min(0.0)


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
def still(robot_body_angvel: Tensor, *, height: float) -> Tensor:
    """Return ``height / (1 + |w|²)``, w the angular velocity [rad/s], (E,)."""
    return height / (1.0 + (robot_body_angvel * robot_body_angvel).sum(-1))


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
