"""The inertial measurement units of a robot and their measurements in the Global Tensor Dictionary.

Letters: E environments.
"""

from collections.abc import Mapping
from typing import TYPE_CHECKING

from torch import Tensor

from aerial_gym.config.sensor import ImuCfg
from aerial_gym.interop import with_usual_settings
from aerial_gym.math.random import Randomness
from aerial_gym.registry import GlobalTensorDictionary, TensorSpec
from aerial_gym.registry.state import add_prefix
from aerial_gym.sensors.mounts import Carrier, RobotSensor

if TYPE_CHECKING:
    from aerial_gym.sensors.imu import Imu


@with_usual_settings
class ImuSet:
    """Owner of the IMU measurements. The first IMU has the plain key, the keys of others are prefixed by their names."""

    imus: "dict[str, Imu]"

    def __init__(
        self, mounted: Mapping[str, RobotSensor[ImuCfg]], gtd: GlobalTensorDictionary, body: Carrier, *, dt: float,
        gravity: float, random: Randomness, errors: Tensor | None = None,
        carriers: Mapping[str, Carrier] | None = None,
    ) -> None:  # fmt: skip
        """Declare the measurements and make an ``Imu`` for each.

        Args:
            gtd: Receives ``imu_measurement`` (E, 6), and for further ones ``<name>_imu_measurement``.
            dt: Time between two calls of ``measure`` [s]: the environment step.
            errors: IMU errors by effects of the robot, (E, 24); None without such effects.
            carriers: Links that carry IMUs, by the names of these; the others sit on the body.
        """
        self.imus = {}
        for name, given in mounted.items():
            from aerial_gym.sensors.imu import Imu  # only where a robot has one: an import of Warp functions takes long

            measurement = gtd.declare(TensorSpec(
                key="imu_measurement" if not self.imus else f"{name}_imu_measurement",
                shape=("E", 6), unit="m/s², rad/s", frame="imu", owner="SensorManager",
                meaning=_measurement_meaning(given.cfg),
            ))  # fmt: skip
            self.imus[name] = Imu(
                given.cfg, (carriers or {}).get(name, body), pose=given.pose, measurement_out=measurement, dt=dt,
                gravity=gravity, random=random, number=len(self.imus), errors=errors,
            )  # fmt: skip

    def state_tensors(self) -> dict[str, Tensor]:
        """Return the tensors of a saved state, by name."""
        return {name: t for key, imu in self.imus.items() for name, t in add_prefix(key, imu.state_tensors()).items()}

    def draws(self) -> dict[str, Tensor]:
        """Return the poses of IMUs with random placement: position [m], body, (E, 3); attitude, IMU to body, (E, 4)."""
        poses = {}
        for name, imu in self.imus.items():
            if imu.is_drawn:
                poses[f"sensors.{name}.position"] = imu.mount_position
                poses[f"sensors.{name}.attitude"] = imu.mount_attitude
        return poses

    def measure(self) -> None:
        """Write the samples of the step that has just ended; launched on torch's current stream, not waited for."""
        for imu in self.imus.values():
            imu.measure()

    def reset(self, mask: Tensor) -> None:
        """Restart in the environments of ``mask``, bool (E,), from their present state; others stay bit for bit."""
        for imu in self.imus.values():
            imu.reset(mask)


def _measurement_meaning(cfg: ImuCfg) -> str:
    """Return the line of meaning of an IMU's measurement."""
    period = "the step" if cfg.rate_hz is None else f"its period of {1.0 / cfg.rate_hz:g} s"
    late = f", {cfg.latency_s:g} s late" if cfg.latency_s else ""
    return f"mean specific force over {period}, angular velocity at its end, with bias and noise{late}"
