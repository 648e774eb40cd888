"""The keys under which a robot stands in the Global Tensor Dictionary, and the states derived from its motion.

All states belong to the same instant: ``refresh_derived`` runs once, after the physics.
Letters: E environments, R rotors, U entries of an action.
"""

from dataclasses import dataclass

from torch import Tensor

from aerial_gym.math.quaternion import euler_from_quat, quat_rotate, quat_rotate_inverse, quat_yaw
from aerial_gym.physics import BodyState
from aerial_gym.registry import GlobalTensorDictionary, TensorSpec


@dataclass(frozen=True, kw_only=True)
class RobotTensors:
    """The robot's tensors in the GTD."""

    state: BodyState
    """Written by the physics."""

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
    """Declare every key of a robot; ``root_state`` is its row (E, 13) of ``vec_root_tensor``."""
    view, new = gtd.declare, gtd.declare
    view(
        _spec(
            "robot_state_tensor",
            13,
            "m, -, m/s, rad/s",
            "world",
            "physics",
            "position, xyzw, velocity, angular velocity",
        ),
        view=root_state,
    )
    position = view(_spec("robot_position", 3, "m", "world", "physics", "body origin"), view=root_state[:, 0:3])
    attitude = view(
        _spec("robot_orientation", 4, "-", "world", "physics", "body to world, xyzw"), view=root_state[:, 3:7]
    )
    lin_vel = view(
        _spec("robot_linvel", 3, "m/s", "world", "physics", "velocity of the origin"), view=root_state[:, 7:10]
    )
    world = view(_spec("robot_angvel", 3, "rad/s", "world", "robot", "angular velocity"), view=root_state[:, 10:13])
    attitude[:, 3] = 1.0
    state = BodyState(
        position=position,
        attitude=attitude,
        lin_vel=lin_vel,
        ang_vel=new(_spec("robot_body_angvel", 3, "rad/s", "body", "physics", "angular velocity")),
        rotor_speed=new(_spec("rotor_speed", "R", "rad/s", "-", "physics", "speed of each rotor")),
    )
    return RobotTensors(
        state=state,
        ang_vel_world=world,
        lin_vel_body=new(_spec("robot_body_linvel", 3, "m/s", "body", "robot", "velocity of the origin")),
        vehicle_attitude=new(_spec("robot_vehicle_orientation", 4, "-", "world", "robot", "yaw alone, xyzw")),
        vehicle_lin_vel=new(_spec("robot_vehicle_linvel", 3, "m/s", "vehicle", "robot", "velocity of the origin")),
        euler=new(_spec("robot_euler_angles", 3, "rad", "-", "robot", "ZYX roll, pitch, yaw in (-pi, pi]")),
        actions=new(_spec("robot_actions", "U", "see controller", "-", "robot", "last action")),
        prev_actions=new(
            _spec("robot_prev_actions", "U", "see controller", "-", "robot", "action before, at the step rate")
        ),
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
