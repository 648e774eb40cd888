"""Terms of terminations: pure functions of tensors of one instant, (E, ...) to bool (E,).

The task defines the kind of an end (crash, success, time-out) and its consequence. Letters: E environments.
"""

import torch
from torch import Tensor

from aerial_gym.task.terms.rewards import body_up_component
from aerial_gym.task.terms.term import TermRegistry

TERMINATIONS = TermRegistry("termination term")  # Terms by the name that a task configuration uses


def has_contact_force(robot_contact_force: Tensor) -> Tensor:
    """Return whether the robot had contact with ground or obstacles in this step, (E,)."""
    return (robot_contact_force * robot_contact_force).sum(-1) > 0.0


@TERMINATIONS.term()
def contact(crashes: Tensor) -> Tensor:
    """Return whether the robot touched something (``crashes`` of the GTD), (E,)."""
    return crashes.clone()


@TERMINATIONS.term()
def vehicle_collision(vehicle_collisions: Tensor) -> Tensor:
    """Return whether the robot touched another vehicle, (E,)."""
    return vehicle_collisions.clone()


@TERMINATIONS.term()
def obstacle_contact(crashes: Tensor, vehicle_collisions: Tensor) -> Tensor:
    """Return whether the robot touched something that is no other vehicle, (E,)."""
    return crashes & ~vehicle_collisions


@TERMINATIONS.term()
def far_from_target(target_position: Tensor, robot_position: Tensor, *, distance: float) -> Tensor:
    """Return whether the robot is further than a distance [m] from its target, (E,)."""
    return (target_position - robot_position).norm(dim=-1) > distance


@TERMINATIONS.term()
def at_target(target_position: Tensor, robot_position: Tensor, *, radius: float) -> Tensor:
    """Return whether the robot is closer than a radius [m] to its target, (E,)."""
    return (target_position - robot_position).norm(dim=-1) < radius


@TERMINATIONS.term()
def at_rest_at_target(
    target_position: Tensor, robot_position: Tensor, robot_linvel: Tensor, *, radius: float, speed: float
) -> Tensor:
    """Return whether the robot is closer than a radius [m] to its target and slower than a speed [m/s], (E,)."""
    return ((target_position - robot_position).norm(dim=-1) < radius) & (robot_linvel.norm(dim=-1) < speed)


@TERMINATIONS.term()
def load_at_rest(
    load_target: Tensor, load_position: Tensor, load_linvel: Tensor, *, distance: float, speed: float
) -> Tensor:
    """Return whether the load is closer than a distance [m] to its target and slower than a speed [m/s], (E,)."""
    return ((load_target - load_position).norm(dim=-1) < distance) & (load_linvel.norm(dim=-1) < speed)


@TERMINATIONS.term()
def payload_at_rest(
    target_position: Tensor, payload_position: Tensor, payload_linvel: Tensor, *, distance: float, speed: float
) -> Tensor:
    """Return whether the payload is closer than a distance [m] to the target and slower than a speed [m/s], (E,)."""
    return at_rest_at_target(target_position, payload_position, payload_linvel, radius=distance, speed=speed)


@TERMINATIONS.term()
def touchdown(
    robot_contact_force: Tensor, target_position: Tensor, robot_position: Tensor, previous_relative_velocity: Tensor,
    *, radius: float, speed: float,
) -> Tensor:  # fmt: skip
    """Return whether the robot has contact within a radius [m] of its target, after an approach below a speed [m/s].

    The speed [m/s] is that relative to the target one step before: the push has changed the present one.
    """
    near = at_target(target_position, robot_position, radius=radius)
    return has_contact_force(robot_contact_force) & near & (previous_relative_velocity.norm(dim=-1) < speed)


@TERMINATIONS.term()
def missed_touchdown(
    robot_contact_force: Tensor, target_position: Tensor, robot_position: Tensor, previous_relative_velocity: Tensor,
    *, radius: float, speed: float,
) -> Tensor:  # fmt: skip
    """Return whether the robot has a contact that is no ``touchdown``, (E,)."""
    landed = touchdown(
        robot_contact_force, target_position, robot_position, previous_relative_velocity, radius=radius, speed=speed
    )
    return has_contact_force(robot_contact_force) & ~landed


@TERMINATIONS.term()
def tilted(robot_orientation: Tensor, *, angle: float) -> Tensor:
    """Return whether the body's z axis is further than an angle [rad] from the world's, (E,)."""
    return body_up_component(robot_orientation).clamp(-1.0, 1.0) < torch.cos(
        torch.full_like(robot_orientation[:, 0], angle)
    )


@TERMINATIONS.term()
def leaning(robot_euler_angles: Tensor, *, angle: float) -> Tensor:
    """Return whether roll or pitch exceeds an angle [rad], (E,)."""
    return (robot_euler_angles[:, :2].abs() > angle).any(dim=-1)


@TERMINATIONS.term()
def spinning(robot_body_angvel: Tensor, *, rate: float) -> Tensor:
    """Return whether the angular rate about any axis exceeds a limit [rad/s], (E,)."""
    return robot_body_angvel.norm(dim=-1) > rate


@TERMINATIONS.term()
def outside_bounds(robot_position: Tensor, env_bounds_min: Tensor, env_bounds_max: Tensor) -> Tensor:
    """Return whether the robot is outside the bounds of its environment, (E,)."""
    return ((robot_position < env_bounds_min) | (robot_position > env_bounds_max)).any(dim=-1)


@TERMINATIONS.term()
def left_arena(
    robot_position: Tensor, env_bounds_min: Tensor, env_bounds_max: Tensor, sim_steps: Tensor, *, lift_off_steps: int
) -> Tensor:
    """Return whether the robot is outside its environment's bounds, (E,); the floor counts only after ``lift_off_steps``."""
    low, high = (robot_position < env_bounds_min), (robot_position > env_bounds_max).any(dim=-1)
    return low[:, :2].any(dim=-1) | high | (low[:, 2] & (sim_steps > lift_off_steps))


@TERMINATIONS.term()
def sequence_done(sequence_done: Tensor) -> Tensor:
    """Return whether the last point of a sequence, or the last gate, is passed, (E,)."""
    return sequence_done.clone()


@TERMINATIONS.term()
def gate_missed(gate_missed: Tensor) -> Tensor:
    """Return whether the robot crossed its gate's plane outside the opening in this step, (E,)."""
    return gate_missed.clone()
