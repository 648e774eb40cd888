"""IMU misalignment: sensor axes rotated against the body, ``f_measured = R^T f``, ``w_measured = R^T w``.

R turns sensor axes into body axes: roll about x, pitch about y, yaw about z, applied in this order (R = R_z R_y R_x).
Source: Titterton, Weston (2004), Strapdown Inertial Navigation Technology, section 12.3 (mounting misalignment).
"""

from torch import Tensor

from aerial_gym.math.quaternion import quat_from_euler, quat_rotate_inverse
from aerial_gym.physics.effects.kinds.sensor import ImuEffect
from aerial_gym.physics.effects.parameter import Parameter


class ImuMisalignment(ImuEffect):
    """Rotation of the inertial sensors' mount."""

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
