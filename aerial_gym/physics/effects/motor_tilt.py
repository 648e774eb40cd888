"""Motor tilt: the axis of one rotor differs from the declared one, as with a bent arm or a skewed mount.

The axis a is rotated by a roll about body x, then by a pitch about body y: ``a' = R_y(pitch) R_x(roll) a``.
Source: Derived: rotation of a vector, e.g. Siciliano et al. (2009), Robotics, section 2.2.
"""

from dataclasses import replace

import torch
from torch import Tensor

from aerial_gym.physics.effects.base import ANY_ROTOR
from aerial_gym.physics.effects.kinds.vehicle import VehicleEffect
from aerial_gym.physics.effects.one_rotor import ROTOR, rotor_mask
from aerial_gym.physics.effects.parameter import Parameter
from aerial_gym.physics.vehicle import Vehicle


class MotorTilt(VehicleEffect):
    """Rotation of the axis of one rotor."""

    name = "motor_tilt"
    summary = "the axis of one rotor is turned from its declared direction"
    acts_on = "rotor"
    parameters = (
        ROTOR,
        Parameter("roll", "rad", -1.0, 1.0, 0.03, "turn about body x"),
        Parameter("pitch", "rad", -1.0, 1.0, 0.03, "then about body y"),
    )
    excitation = "thrust of that rotor that varies; yaw tells it from a shifted centre of mass"
    confused_with = ("com_offset", "weak_motor", "imu_misalignment", "torque_ratio")
    told_by_torques = True
    rotors = ANY_ROTOR

    def adjust(self, vehicle: Vehicle, params: Tensor) -> Vehicle:
        """Return the vehicle with one axis rotated."""
        chosen = rotor_mask(vehicle, params[:, 0])
        roll, pitch = (chosen * params[:, k : k + 1] for k in (1, 2))
        x, y, z = vehicle.rotor_axis.unbind(-1)
        y, z = roll.cos() * y - roll.sin() * z, roll.sin() * y + roll.cos() * z
        x, z = pitch.cos() * x + pitch.sin() * z, pitch.cos() * z - pitch.sin() * x
        return replace(vehicle, rotor_axis=torch.stack((x, y, z), dim=-1))
