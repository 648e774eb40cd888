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
        *(
            Parameter(
                name=f"a{axis}", unit="m/s²", low=-5.0, high=5.0, scale=0.1, meaning=f"accelerometer, body {axis}"
            )
            for axis in "xyz"
        ),
        *(
            Parameter(name=f"g{axis}", unit="rad/s", low=-1.0, high=1.0, scale=0.01, meaning=f"gyroscope, body {axis}")
            for axis in "xyz"
        ),
    )
    excitation = "attitude and velocity beside the inertial sensors; attitudes that differ"
    confused_with = ("imu_misalignment", "constant_wind", "com_offset", "motor_tilt")

    def measure(self, specific_force: Tensor, ang_vel: Tensor, params: Tensor) -> tuple[Tensor, Tensor]:
        """Return both with their bias."""
        return specific_force + params[:, :3], ang_vel + params[:, 3:]
