"""The keys under which a robot stands in the Global Tensor Dictionary, and the states derived from its motion.

All states belong to the same instant: ``refresh_derived`` runs once, after the physics.
Letters: E environments, R rotors, U entries of an action.
"""

from dataclasses import dataclass

import torch
from torch import Tensor

from aerial_gym.math.quaternion import euler_from_quat, quat_rotate, quat_rotate_inverse, quat_yaw
from aerial_gym.physics import BodyState
from aerial_gym.registry import GlobalTensorDictionary, TensorSpec


@dataclass(frozen=True, kw_only=True)
class RobotTensors:
    """The robot's tensors in the GTD."""

    state: BodyState
    """Written by the physics."""

    root_state: Tensor
    """(E, 13)."""

    ang_vel_world: Tensor
    """(E, 3)."""

    lin_vel_body: Tensor
    """(E, 3)."""

    vehicle_attitude: Tensor
    """(E, 4)."""

    vehicle_lin_vel: Tensor
    """(E, 3)."""

    euler: Tensor
    """(E, 3)."""

    actions: Tensor
    """(E, U)."""

    prev_actions: Tensor
    """(E, U)."""


def _spec(key: str, width: int | str, unit: str, frame: str, owner: str, meaning: str) -> TensorSpec:
    return TensorSpec(key=key, shape=("E", width), unit=unit, frame=frame, owner=owner, meaning=meaning)


def declare_robot_tensors(gtd: GlobalTensorDictionary, root_state: Tensor) -> RobotTensors:
    """Declare every key of a robot; ``root_state`` is its row (E, 13) of ``vec_root_tensor``.

    The physics works on tensors of its own for each quantity: rows of 13 numbers would halve its speed on a GPU, where
    neighbouring threads then touch memory 52 bytes apart (``docs/results/performance.md``).
    """

    def new(key: str, width: int | str, unit: str, frame: str, owner: str, meaning: str) -> Tensor:
        return gtd.declare(_spec(key, width, unit, frame, owner, meaning))

    rows = "copy of position, xyzw, velocity, angular velocity; row 0 of vec_root_tensor"
    gtd.declare(_spec("robot_state_tensor", 13, "m, -, m/s, rad/s", "world", "robot", rows), view=root_state)
    state = BodyState(
        position=new("robot_position", 3, "m", "world", "physics", "body origin"),
        attitude=new("robot_orientation", 4, "-", "world", "physics", "body to world, xyzw"),
        lin_vel=new("robot_linvel", 3, "m/s", "world", "physics", "velocity of the origin"),
        ang_vel=new("robot_body_angvel", 3, "rad/s", "body", "physics", "angular velocity"),
        rotor_speed=new("rotor_speed", "R", "rad/s", "-", "physics", "speed of each rotor"),
    )
    state.attitude[:, 3] = 1.0
    return RobotTensors(
        state=state,
        root_state=root_state,
        ang_vel_world=new("robot_angvel", 3, "rad/s", "world", "robot", "angular velocity"),
        lin_vel_body=new("robot_body_linvel", 3, "m/s", "body", "robot", "velocity of the origin"),
        vehicle_attitude=new("robot_vehicle_orientation", 4, "-", "world", "robot", "yaw alone, xyzw"),
        vehicle_lin_vel=new("robot_vehicle_linvel", 3, "m/s", "vehicle", "robot", "velocity of the origin"),
        euler=new("robot_euler_angles", 3, "rad", "-", "robot", "ZYX roll, pitch, yaw in (-pi, pi]"),
        actions=new("robot_actions", "U", "see controller", "-", "robot", "last action"),
        prev_actions=new("robot_prev_actions", "U", "see controller", "-", "robot", "action before, at the step rate"),
    )


def refresh_derived(tensors: RobotTensors) -> None:
    """Write the states that follow from position, attitude and velocities of this instant."""
    state = tensors.state
    tensors.ang_vel_world.copy_(quat_rotate(state.attitude, state.ang_vel))
    tensors.lin_vel_body.copy_(quat_rotate_inverse(state.attitude, state.lin_vel))
    vehicle = quat_yaw(state.attitude)
    tensors.vehicle_attitude.copy_(vehicle)
    tensors.vehicle_lin_vel.copy_(quat_rotate_inverse(vehicle, state.lin_vel))
    tensors.euler.copy_(euler_from_quat(state.attitude))
    tensors.root_state.copy_(torch.cat((state.position, state.attitude, state.lin_vel, tensors.ang_vel_world), dim=-1))
