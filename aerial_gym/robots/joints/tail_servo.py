"""Servo angle of a tail rotor, with which a tricopter holds its heading.

Controllers command rotors; drives of joints are further entries of the action, which the pilot or policy gives.
Frames: body is x forward, y left, z up. Letters: E environments.
"""

from dataclasses import dataclass
from math import atan, sin

from torch import Tensor

from aerial_gym.config.robot import RobotCfg
from aerial_gym.config.sim import STANDARD_GRAVITY
from aerial_gym.control.gains import frequency_and_damping
from aerial_gym.errors import ConfigError
from aerial_gym.math.quaternion import wrap_angle, yaw_from_quat
from aerial_gym.physics.rotor_maps import rotor_loads, rotor_state_for_thrust


@dataclass(frozen=True, kw_only=True)
class TailServo:
    """``angle = trim + heading (yaw - psi) - rate r`` within the range of the servo."""

    trim: float  # At which the thrust of the tail holds the drag torque of its rotor [rad]: `tan = s k / L`
    heading: float  # Angle per error of the heading [-]; errors count up to 1 rad
    rate: float  # Angle per yaw rate [s]
    limits: tuple[float, float]  # Of the servo [rad]

    def command_angle(self, attitude: Tensor, ang_vel: Tensor, yaw: Tensor) -> Tensor:
        """Return the tail's command [rad], (E,), from attitude (E, 4), body rates [rad/s] (E, 3), wanted yaw [rad] (E,)."""
        error = wrap_angle(yaw - yaw_from_quat(attitude)).clamp(-1.0, 1.0)
        return (self.trim + self.heading * error - self.rate * ang_vel[:, 2]).clamp(*self.limits)


def derive_tail_servo(robot: RobotCfg, *, dt: float, gravity: float = STANDARD_GRAVITY) -> TailServo:
    """Return the servo law of a tricopter: one tail rotor on a joint about body x, behind the centre of mass.

    With the tail at the distance L behind it, its share T of the weight and the moment of inertia J, ``J r' = L T angle`` about
    the trim. The servo's lag (damping over stiffness) and the time step limit the bandwidth. In addition an error of 1 rad
    must not command more than the servo's range beyond the trim: as in ``control.gains.derive_gains``.
    """
    number = tail_rotor(robot)
    mount, rotor = robot.mounts.layout[number], robot.rotor_types[number]
    assert robot.joints is not None
    joint = next(joint for joint in robot.joints.layout if joint.name == mount.link)
    assert joint.drive is not None
    arm = robot.body.com[0] - mount.position[0]
    thrust = robot.body.mass * gravity / robot.num_rotors
    _, torque = rotor_loads(rotor, rotor_state_for_thrust(rotor, thrust))
    trim = atan(mount.spin * torque / (thrust * arm))
    low, high = joint.drive.command_range
    turn = arm * thrust / robot.body.inertia[2][2]
    quickest, damping = frequency_and_damping(
        joint.drive.damping / joint.drive.stiffness + dt, robot.control.phase_margin
    )
    frequency = min(quickest, (turn * sin(min(high - trim, trim - low))) ** 0.5)
    return TailServo(trim=trim, heading=frequency**2 / turn, rate=2.0 * damping * frequency / turn, limits=(low, high))


def tail_rotor(robot: RobotCfg) -> int:
    """Return the number from 0 of the only rotor that a servo leans sideways; raise ``ConfigError`` without one."""
    joints = {} if robot.joints is None else {joint.name: joint for joint in robot.joints.layout}
    matches = [
        (number, mount, joint)
        for number, mount in enumerate(robot.mounts.layout)
        if (joint := joints.get(mount.link or "")) is not None
        and joint.drive is not None
        and joint.drive.mode == "position"
    ]
    if len(matches) != 1 or matches[0][2].axis != (1.0, 0.0, 0.0) or matches[0][1].position[0] >= robot.body.com[0]:
        raise ConfigError(
            "a tail servo needs one rotor on a joint about body x that a drive holds to an angle, behind the centre of mass"
        )
    return matches[0][0]
