"""IMU bias: constant errors of accelerometer and gyroscope.

``f_measured = f + (ax, ay, az)``, ``w_measured = w + (gx, gy, gz)``, in body axes.
Source: Titterton, Weston (2004), Strapdown Inertial Navigation Technology, section 12.3 (fixed bias).
"""

from torch import Tensor

from aerial_gym.physics.effects.kinds.sensor import ImuEffect
from aerial_gym.physics.effects.parameter import Parameter


class ImuBias(ImuEffect):
    """Constant errors of the inertial sensors."""

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
