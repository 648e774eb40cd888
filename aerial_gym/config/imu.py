"""Files of inertial measurement units: placement and errors.

Frames: body is x forward, y left, z up; the IMU's own axes are the body's, turned by ``euler``. Accelerometers measure specific
force: +9.81 m/s² on z at hover.
Noise is given as a density sigma: an average over dt has the standard deviation ``sigma / sqrt(dt)``, at every rate. It is the
two-sided density, the Allan deviation at 1 s (N of IEEE Std 952-1997). A bias walks by ``sigma_b sqrt(dt)`` in dt.
"""

from dataclasses import dataclass
from pathlib import Path

from aerial_gym.config.checks import Vec3, require, require_choice, require_not_negative, require_positive
from aerial_gym.config.loader import load
from aerial_gym.config.sensor_mount import PlacementCfg

MOST_MISALIGNMENT_DEG = 45.0  # Largest misalignment; use `euler` for larger rotations of the axes


@dataclass(frozen=True, kw_only=True)
class ImuCfg(PlacementCfg):
    """Three accelerometers and three gyros at one point of the body."""

    model: str = "imu"  # Name of this model in a sensor file; an IMU's own file may leave it out
    summary: str  # One line for people who choose a sensor

    misalignment_deg: Vec3 = (0.0, 0.0, 0.0)
    """Each reset turns the IMU further, about its own axes (ZYX), by roll, pitch, yaw drawn uniformly within +- these [deg],
    0 to 45."""

    accel_noise_density: Vec3  # White noise of each accelerometer [m/s²/sqrt(Hz)], >= 0
    gyro_noise_density: Vec3  # White noise of each gyro [rad/s/sqrt(Hz)], >= 0
    accel_bias_walk: Vec3  # Random walk of each accelerometer's bias [m/s²/sqrt(s)], >= 0
    gyro_bias_walk: Vec3  # Random walk of each gyro's bias [rad/s/sqrt(s)], >= 0
    accel_initial_bias: Vec3  # Each reset draws the bias of each accelerometer uniformly within +- these [m/s²], >= 0
    gyro_initial_bias: Vec3  # Each reset draws the bias of each gyro uniformly within +- these [rad/s], >= 0
    accel_range: float  # Accelerometers saturate at +- this [m/s²], > 0
    gyro_range: float  # Gyros saturate at +- this [rad/s], > 0

    rate_hz: float | None = None
    """Measurements per second of simulated time [Hz], > 0 and at most one per environment step, between which the last one
    stays; each is the mean over its own period. None: one at every step."""

    latency_s: float = 0.0  # Age of a measurement when it appears [s], >= 0, rounded to whole environment steps
    source: str  # Source of the numbers

    def __post_init__(self) -> None:
        require_choice(self, "model", ("imu",))
        require_positive(self, "rate_hz", "accel_range", "gyro_range")
        self.check_placement()
        errors = ("noise_density", "bias_walk", "initial_bias")
        require_not_negative(self, "latency_s", *(f"{kind}_{name}" for kind in ("accel", "gyro") for name in errors))
        holds = all(0.0 <= angle <= MOST_MISALIGNMENT_DEG for angle in self.misalignment_deg)
        require(self, "misalignment_deg", holds, f"must lie within 0 and {MOST_MISALIGNMENT_DEG:g} degrees")


def load_imu(path: str | Path) -> ImuCfg:
    """Return the IMU in a YAML file; those that come with the package are registered in ``aerial_gym.sensors.IMUS``."""
    return load(ImuCfg, path)
