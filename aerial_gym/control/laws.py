"""The table of control laws, by their names in controller configurations."""

from collections.abc import Callable
from dataclasses import dataclass

from torch import Tensor

from aerial_gym.control import lee
from aerial_gym.physics.state import BodyState


@dataclass(frozen=True)
class Law:
    """A geometric law and the meaning of its action."""

    wrench: Callable[[BodyState, Tensor, lee.LeeGains], Tensor]  # From state, action and gains: wrench (E, 6), body
    action: tuple[str, ...]  # Meaning and unit of each entry of the action
    trim: str  # Axes of ``control.stability`` that the law controls
    lateral: bool = False  # Whether it commands lateral force, which needs rotors in more than one direction


_PLACE, _VELOCITY, _RATE = ("x [m]", "y [m]", "z [m]"), ("vx [m/s]", "vy [m/s]", "vz [m/s]"), "yaw rate [rad/s]"
_QUATERNION, _ALL = ("q_x [-]", "q_y [-]", "q_z [-]", "q_w [-]"), "x y z roll pitch yaw vx vy vz p q r"
_THRUST = "thrust - 1 [weights]"

LAWS: dict[str, Law] = {
    "position": Law(lee.position_control, (*_PLACE, "yaw [rad]"), _ALL),
    "pose": Law(lee.pose_control, (*_PLACE, *_QUATERNION), _ALL, lateral=True),
    "steering": Law(lee.steering_control, (*_VELOCITY, "yaw [rad]"), "roll pitch yaw vx vy vz p q r"),
    "velocity": Law(lee.velocity_control, (*_VELOCITY, _RATE), "roll pitch vx vy vz p q r"),
    "acceleration": Law(lee.acceleration_control, ("ax [m/s²]", "ay [m/s²]", "az [m/s²]", _RATE), "roll pitch p q r"),
    "attitude": Law(lee.attitude_control, (_THRUST, "roll [rad]", "pitch [rad]", _RATE), "roll pitch p q r"),
    "rates": Law(lee.rates_control, (_THRUST, "p [rad/s]", "q [rad/s]", "r [rad/s]"), "p q r"),
}
"""The geometric laws. ``thrust`` and ``rotor_speed`` pass the action to the rotors instead."""
