"""Terms of observations: pure functions of tensors of one instant, (E, ...) to (E, W).

Every GTD key and every task buffer is a term by its own name as well, flattened to a vector.
Letters: E environments, W entries.
"""

import torch
from torch import Tensor

from aerial_gym.math.quaternion import euler_from_quat, quat_rotate, quat_rotate_inverse, quat_without_tilt
from aerial_gym.task.terms.gate_path import gate_path_direction
from aerial_gym.task.terms.term import ACTION, Term, TermRegistry
from aerial_gym.task.vehicles.names import NEAREST

OBSERVATIONS = TermRegistry("observation term")  # Terms by the name that a task configuration uses

CELLS = "nearest_in_{rows}x{columns}_cells"
"""Buffer of the smallest distance in each cell of the first range sensor's image, a share of ``LARGEST``, (E, rows columns)."""

LARGEST = "largest_distance"  # Buffer of the largest distance that this sensor measures [m], one number
LATENTS = "image_latents"  # Buffer of the latents of that image by the task's encoder, (E, L)
LEAST_SHARE = 1e-3  # Share of the largest distance below which distances are not resolved: 1 cm of 10 m
TINY = 1e-6  # A distance [m] below which there is no direction


for _name, _width, _inputs, _text in (
    ("attitude", 4, ("robot_orientation",), "the attitude, body to world, xyzw, (E, 4)"),
    ("lin_vel_world", 3, ("robot_linvel",), "the velocity [m/s], world, (E, 3)"),
    ("lin_vel_body", 3, ("robot_body_linvel",), "the velocity [m/s], body, (E, 3)"),
    ("ang_vel_body", 3, ("robot_body_angvel",), "the angular velocity [rad/s], body, (E, 3)"),
    ("last_action", ACTION, ("robot_actions",), "the last command that the controller took, (E, U)"),
    (LATENTS, None, (LATENTS,), "the latents of the first sensor's image by the task's encoder, (E, L)"),
    ("position_error_world", 3, ("target_position", "robot_position"),
     "target minus position [m], world, (E, 3)"),
    ("velocity_error_world", 3, ("target_velocity", "robot_linvel"),
     "velocity of the target minus velocity [m/s], world, (E, 3)"),
    ("following_gate_world", 3, ("following_position", "robot_position"),
     "the centre of the gate after the next one minus position [m], world, (E, 3)"),
    ("load_offset_world", 3, ("load_position", "robot_position"),
     "the load's position relative to the body origin [m], world, (E, 3)"),
    ("payload_error_world", 3, ("target_position", "payload_position"),
     "the target minus the position of the payload of all vehicles [m], world, (E, 3)"),
    ("payload_offset_world", 3, ("payload_position", "robot_position"),
     "the position of the payload of all vehicles relative to the body origin [m], world, (E, 3)"),
    ("load_vel_world", 3, ("load_linvel", "robot_linvel"),
     "the velocity of the load relative to the body origin [m/s], world, (E, 3)"),
):  # fmt: skip
    _value = (lambda tensor: tensor) if len(_inputs) == 1 else (lambda first, second: first - second)
    OBSERVATIONS.register(_name, Term(name=_name, value=_value, width=_width, inputs=_inputs, text=f"Return {_text}."))


@OBSERVATIONS.term(width=3)
def position_error_body(target_position: Tensor, robot_position: Tensor, robot_orientation: Tensor) -> Tensor:
    """Return target minus position [m], body, (E, 3)."""
    return quat_rotate_inverse(robot_orientation, target_position - robot_position)


@OBSERVATIONS.term(width=3)
def direction_vehicle(target_position: Tensor, robot_position: Tensor, robot_orientation: Tensor) -> Tensor:
    """Return the unit vector from the robot to the target, vehicle frame (world turned by the yaw), (E, 3)."""
    error = target_position - robot_position
    return quat_rotate_inverse(
        quat_without_tilt(robot_orientation), error / error.norm(dim=-1, keepdim=True).clamp_min(TINY)
    )


@OBSERVATIONS.term(width=1)
def distance(target_position: Tensor, robot_position: Tensor) -> Tensor:
    """Return the distance to the target [m], (E, 1)."""
    return (target_position - robot_position).norm(dim=-1, keepdim=True)


@OBSERVATIONS.term(width=6)
def rotation_rows(robot_orientation: Tensor) -> Tensor:
    """Return the first two rows of the rotation matrix body to world, (E, 6)."""
    x, y, z, w = robot_orientation.unbind(-1)
    first = (1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y - w * z), 2.0 * (x * z + w * y))
    second = (2.0 * (x * y + w * z), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z - w * x))
    return torch.stack((*first, *second), dim=-1)


@OBSERVATIONS.term(width=3)
def up_body(robot_orientation: Tensor) -> Tensor:
    """Return the world's up axis in the body frame, the third row of the rotation matrix body to world, (E, 3)."""
    x, y, z, w = robot_orientation.unbind(-1)
    return torch.stack((2.0 * (x * z - w * y), 2.0 * (y * z + w * x), 1.0 - 2.0 * (x * x + y * y)), dim=-1)


@OBSERVATIONS.term(width=2)
def roll_pitch(robot_orientation: Tensor) -> Tensor:
    """Return roll and pitch [rad], (E, 2)."""
    return euler_from_quat(robot_orientation)[:, :2]


@OBSERVATIONS.term(width=1)
def zero(robot_position: Tensor) -> Tensor:
    """Return the constant 0, (E, 1)."""
    return torch.zeros_like(robot_position[:, :1])


@OBSERVATIONS.term("nearest_in_cells", named={"cells": CELLS})
def nearest(cells: Tensor, *, rows: int = 8, columns: int = 8) -> Tensor:
    """Return the smallest distance in each cell of the first sensor's image, a share of the largest, (E, rows columns)."""
    del rows, columns  # part of the input's name
    return cells


@OBSERVATIONS.term(named={"cells": CELLS})
def log_nearest_in_cells(cells: Tensor, *, rows: int = 8, columns: int = 8) -> Tensor:
    """Return the natural logarithm of ``nearest_in_cells``, (E, rows columns), which resolves near and far alike."""
    return cells.clamp_min(LEAST_SHARE).log()


@OBSERVATIONS.term(named={"cells": CELLS})
def inverse_nearest(cells: Tensor, largest_distance: Tensor, *, rows: int = 8, columns: int = 8) -> Tensor:
    """Return the inverse of the smallest distance in each of some cells [1/m], (E, rows columns)."""
    return 1.0 / (cells.clamp_min(LEAST_SHARE) * largest_distance)


@OBSERVATIONS.term(named={"nearest": NEAREST})
def nearest_vehicles(nearest: Tensor, *, count: int) -> Tensor:
    """Return offset [m], relative velocity [m/s], vehicle frame, and 1 for each of the nearest other vehicles, (E, 7 count)."""
    del count  # part of the input's name
    return nearest


@OBSERVATIONS.term()
def next_gates(
    target_index: Tensor, gates_seen: Tensor, gate_position: Tensor, gate_orientation: Tensor,
    gate_nominal_position: Tensor, gate_nominal_orientation: Tensor, robot_position: Tensor,
    robot_vehicle_orientation: Tensor, *, count: int,
) -> Tensor:  # fmt: skip
    """Return offset [m] and direction of the next gates at their known poses, vehicle frame, (E, 6 count).

    A gate already seen counts at its true pose, others at their nominal one. The first gate follows the last, as passed
    gates remain obstacles.
    """
    seen = gates_seen.unsqueeze(-1)
    position = torch.where(seen, gate_position, gate_nominal_position)
    x, y, z, w = torch.where(seen, gate_orientation, gate_nominal_orientation).unbind(-1)
    ahead = torch.stack((1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y + w * z), 2.0 * (x * z - w * y)), dim=-1)
    rows = torch.cat((position - robot_position.unsqueeze(1), ahead), dim=-1)  # (E, G, 6)
    number = rows.shape[1]
    values = []
    for k in range(count):
        index = target_index + k % number
        row = rows_at_index(torch.where(index >= number, index - number, index), rows)
        values += [quat_rotate_inverse(robot_vehicle_orientation, part) for part in row.split(3, dim=-1)]
    return torch.cat(values, dim=-1)


@OBSERVATIONS.term(width=6)
def way_ahead(
    target_index: Tensor, gates_seen: Tensor, gate_position: Tensor, gate_orientation: Tensor,
    gate_nominal_position: Tensor, gate_nominal_orientation: Tensor, robot_position: Tensor,
    robot_vehicle_orientation: Tensor,
) -> Tensor:  # fmt: skip
    """Return the path direction through the next gate (vehicle frame) and the robot's position in the gate's frame [m], (E, 6).

    The direction is ``gate_path_direction``. A gate not yet seen counts at its nominal pose.
    """
    seen = gates_seen.unsqueeze(-1)
    position = rows_at_index(target_index, torch.where(seen, gate_position, gate_nominal_position))
    orientation = rows_at_index(target_index, torch.where(seen, gate_orientation, gate_nominal_orientation))
    place = quat_rotate_inverse(orientation, robot_position - position)
    toward = quat_rotate(orientation, gate_path_direction(place))
    return torch.cat((quat_rotate_inverse(robot_vehicle_orientation, toward), place), dim=-1)


@OBSERVATIONS.term()
def nearest_poles(
    poles_seen: Tensor, pole_position: Tensor, pole_nominal_position: Tensor, robot_position: Tensor,
    robot_vehicle_orientation: Tensor, *, count: int,
) -> Tensor:  # fmt: skip
    """Return horizontal offsets [m] of the nearest poles at known positions, vehicle frame, nearest first, (E, 2 count)."""
    known = torch.where(poles_seen.unsqueeze(-1), pole_position, pole_nominal_position) - robot_position.unsqueeze(1)
    rows = [quat_rotate_inverse(robot_vehicle_orientation, away)[:, :2] for away in known.unbind(1)]
    squares = [(row * row).sum(-1) for row in rows]
    for first in range(count):  # a sort by exchanges, which a kernel can do
        for other in range(first + 1, len(rows)):
            swap = squares[other] < squares[first]
            squares[first], squares[other] = (
                torch.where(swap, squares[other], squares[first]),
                torch.where(swap, squares[first], squares[other]),
            )
            rows[first], rows[other] = (
                torch.where(swap.unsqueeze(-1), rows[other], rows[first]),
                torch.where(swap.unsqueeze(-1), rows[first], rows[other]),
            )
    return torch.cat(rows[:count], dim=-1)


def rows_at_index(index: Tensor, rows: Tensor) -> Tensor:
    """Return row ``index``, (E,), of rows (E, G, W), as (E, W); without indexing, to be part of a kernel."""
    first, *rest = rows.unbind(1)
    values = first
    for i, other in enumerate(rest, start=1):
        values = torch.where((index == i).unsqueeze(-1), other, values)
    return values


def tensor_term(name: str) -> Term:
    """Return the term that observes a whole tensor, flattened to (E, W)."""

    def value(tensor: Tensor) -> Tensor:
        entries = tensor.reshape(tensor.shape[0], -1)
        return entries if entries.dtype == torch.float64 else entries.float()

    return Term(name=name, value=value, inputs=(name,))
