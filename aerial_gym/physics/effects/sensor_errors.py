"""Errors of the inertial sensors, of the logged attitude and of the rotor speed sensors.

Frames: body is x forward, y left, z up. Letters: E environments, P parameters of an effect.
"""

from collections.abc import Sequence

import torch
from torch import Tensor

from aerial_gym.math.quaternion import quat_from_euler, quat_rotate_inverse
from aerial_gym.physics.effects.base import Parameter
from aerial_gym.physics.effects.kinds import AttitudeSensorEffect, ImuEffect, RotorSensorEffect
from aerial_gym.physics.effects.rotor_failures import ROTOR


class ImuBias(ImuEffect):
    """IMU bias: constant errors of accelerometer and gyroscope.

    ``f_measured = f + (ax, ay, az)``, ``w_measured = w + (gx, gy, gz)``, in body axes.
    Source: Titterton, Weston (2004), Strapdown Inertial Navigation Technology, section 12.3 (fixed bias).
    """

    name = "imu_bias"
    summary = "constant errors of accelerometer and gyroscope"
    parameters = (
        *(Parameter(f"a{axis}", "m/s²", -5.0, 5.0, 0.1, f"accelerometer, body {axis}") for axis in "xyz"),
        *(Parameter(f"g{axis}", "rad/s", -1.0, 1.0, 0.01, f"gyroscope, body {axis}") for axis in "xyz"),
    )
    excitation = "attitude and velocity beside the inertial sensors; attitudes that differ"
    confused_with = ("imu_misalignment", "constant_wind", "com_offset", "motor_tilt")

    def measure(self, specific_force: Tensor, ang_vel: Tensor, params: Tensor) -> tuple[Tensor, Tensor]:
        """Return both with their bias."""
        return specific_force + params[:, :3], ang_vel + params[:, 3:]


class ImuMisalignment(ImuEffect):
    """IMU misalignment: sensor axes rotated against the body, ``f_measured = R^T f``, ``w_measured = R^T w``.

    R turns sensor axes into body axes: roll about x, pitch about y, yaw about z, applied in this order (R = R_z R_y R_x).
    Source: Titterton, Weston (2004), Strapdown Inertial Navigation Technology, section 12.3 (mounting misalignment).
    """

    name = "imu_misalignment"
    summary = "inertial sensors that are rotated against the body"
    parameters = tuple(
        Parameter(name, "rad", -0.8, 0.8, 0.02, f"turn about {axis}")
        for name, axis in (("roll", "x"), ("pitch", "y"), ("yaw", "z"))
    )
    excitation = (
        "attitude and velocity beside the inertial sensors; thrust for roll and pitch, sideways force or turns for yaw"
    )
    confused_with = ("imu_bias", "motor_tilt", "com_offset")

    def measure(self, specific_force: Tensor, ang_vel: Tensor, params: Tensor) -> tuple[Tensor, Tensor]:
        """Return both in the axes of the sensors."""
        turn = quat_from_euler(params).expand(*specific_force.shape[:-1], 4)
        return quat_rotate_inverse(turn, specific_force), quat_rotate_inverse(turn, ang_vel)


class AttitudeBias(AttitudeSensorEffect):
    """Attitude bias: a logged attitude of axes that are turned against the body, as of a tracked body defined by eye.

    ``q_logged = q turn``, with the turn as of ``imu_misalignment``: R turns the logged axes into body axes. The inertial
    sensors keep the axes of the rotors, so that only comparisons with attitude and velocity change.
    Source: Derived: two frames on a rigid body differ by a constant rotation.
    """

    name = "attitude_bias"
    summary = "a logged attitude whose axes are turned against the body"
    parameters = ImuMisalignment.parameters
    excitation = (
        "inertial sensors beside attitude and velocity; thrust for roll and pitch, sideways force or turns for yaw"
    )
    confused_with = ("imu_misalignment", "imu_bias", "constant_wind")
    steady = True

    def turn(self, params: Tensor) -> Tensor:
        """Return the parameters."""
        return params


WIDTH = 24  # Numbers per environment: offset and matrix columns, 4 x 3, of specific force, then of angular velocity


def imu_errors(effects: Sequence[tuple[ImuEffect, Tensor]]) -> Tensor:
    """Return offset b and columns of A of ``measured = A true + b``, (E, 24), for effects in their order.

    Args:
        effects: At least one, with parameters (E, P).

    Returns:
        ``b, A e_x, A e_y, A e_z`` of the specific force [m/s²], then of the angular velocity [rad/s], body.

    Source:
        Derived: b is the measurement of zero, and a column of A is the measurement of a unit vector minus b.
    """
    first = effects[0][1]
    zero = torch.zeros_like(first[:, :1])
    one = zero + 1.0
    force, ang_vel = [], []
    for axis in (None, 0, 1, 2):
        true = torch.cat([one if k == axis else zero for k in range(3)], dim=1)
        measured = (true, true)
        for effect, params in effects:
            measured = effect.measure(*measured, params)
        force.append(measured[0])
        ang_vel.append(measured[1])
    return torch.cat([rows for outputs in (force, ang_vel) for rows in _subtract_offset(outputs)], dim=1)


def _subtract_offset(outputs: list[Tensor]) -> list[Tensor]:
    return [outputs[0], *(rows - outputs[0] for rows in outputs[1:])]


class RotorSpeedScale(RotorSensorEffect):
    """Rotor speed scale: a factor on logged rotor speeds, from a wrong number of magnet poles or marks, or a wrong unit.

    ``w_measured = k w``; the flight itself is unchanged.
    Source: Derived: a tachometer counts k times as many events per turn as assumed.
    """

    name = "rotor_speed_scale"
    summary = "measured rotor speeds that are off by a factor"
    parameters = (Parameter("scale", "-", 0.05, 20.0, 0.05, "measured per true speed", neutral=1.0),)
    excitation = "measured speeds beside commands; without commands a thrust coefficient looks the same"
    confused_with = ("thrust_coefficient", "battery_sag")
    rotors = ("reversible", "slew", "dead_band")

    def measure(self, rotor_speed: Tensor, params: Tensor) -> Tensor:
        """Return ``k w``."""
        return params[:, :1] * rotor_speed

    def true_speed(self, measured: Tensor, params: Tensor) -> Tensor:
        """Return ``w_measured / k``."""
        return measured / params[:, :1]


class TachometerScale(RotorSensorEffect):
    """Tachometer scale: a factor on the logged speed of one rotor, from a wrong number of its magnet poles or marks.

    ``w_measured = k w`` for that rotor. Without commands, a thrust ``1 / k²`` times the declared one looks the same.
    Source: Derived: a tachometer counts k times as many events per turn as assumed.
    """

    name = "tachometer_scale"
    summary = "a measured speed of one rotor that is off by a factor"
    parameters = (ROTOR, Parameter("scale", "-", 0.05, 20.0, 0.02, "measured per true speed", neutral=1.0))
    excitation = "measured speeds beside commands; without commands a weak motor looks the same"
    confused_with = ("weak_motor", "com_offset", "rotor_speed_scale")
    told_by_torques = True
    rotors = ("reversible", "slew", "dead_band")

    def measure(self, rotor_speed: Tensor, params: Tensor) -> Tensor:
        """Return ``k w`` for that rotor."""
        return self._factors(rotor_speed, params) * rotor_speed

    def true_speed(self, measured: Tensor, params: Tensor) -> Tensor:
        """Return ``w_measured / k`` for that rotor."""
        return measured / self._factors(measured, params)

    @staticmethod
    def _factors(speed: Tensor, params: Tensor) -> Tensor:
        """Return k for one rotor and 1 for the others, (E, R)."""
        numbers = torch.arange(1, speed.shape[-1] + 1, device=speed.device)
        return torch.where(numbers == params[:, :1].round(), params[:, 1:2], 1.0)
