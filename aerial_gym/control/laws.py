"""The table of control laws, by their names in controller configurations."""

from collections.abc import Callable
from dataclasses import dataclass

from torch import Tensor

from aerial_gym.control.lee import (
    LeeGains,
    acceleration_control,
    attitude_control,
    pose_control,
    position_control,
    rates_control,
    steering_control,
    velocity_control,
)
from aerial_gym.physics.state import BodyState


@dataclass(frozen=True, kw_only=True)
class Law:
    """A geometric law and the meaning of its action."""

    wrench: Callable[[BodyState, Tensor, LeeGains], Tensor]
    """State, action (E, 4) and gains to the wanted wrench (E, 6), body."""

    action: tuple[str, ...]  # Meaning and unit of each entry of the action
    lateral: bool = False  # Whether it commands lateral force, which needs rotors in more than one direction
    trim: str  # Axes of ``control.stability`` that the law controls


LAWS: dict[str, Law] = {
    "position": Law(
        wrench=position_control,
        action=("x [m]", "y [m]", "z [m]", "yaw [rad]"),
        trim="x y z roll pitch yaw vx vy vz p q r",
    ),
    "pose": Law(
        wrench=pose_control,
        action=("x [m]", "y [m]", "z [m]", "q_x [-]", "q_y [-]", "q_z [-]", "q_w [-]"),
        lateral=True,
        trim="x y z roll pitch yaw vx vy vz p q r",
    ),
    "steering": Law(
        wrench=steering_control,
        action=("vx [m/s]", "vy [m/s]", "vz [m/s]", "yaw [rad]"),
        trim="roll pitch yaw vx vy vz p q r",
    ),
    "velocity": Law(
        wrench=velocity_control,
        action=("vx [m/s]", "vy [m/s]", "vz [m/s]", "yaw rate [rad/s]"),
        trim="roll pitch vx vy vz p q r",
    ),
    "acceleration": Law(
        wrench=acceleration_control,
        action=("ax [m/s²]", "ay [m/s²]", "az [m/s²]", "yaw rate [rad/s]"),
        trim="roll pitch p q r",
    ),
    "attitude": Law(
        wrench=attitude_control,
        action=("thrust - 1 [weights]", "roll [rad]", "pitch [rad]", "yaw rate [rad/s]"),
        trim="roll pitch p q r",
    ),
    "rates": Law(
        wrench=rates_control,
        action=("thrust - 1 [weights]", "p [rad/s]", "q [rad/s]", "r [rad/s]"),
        trim="p q r",
    ),
}
"""The geometric laws. ``thrust`` and ``rotor_speed`` pass the action to the rotors instead."""
