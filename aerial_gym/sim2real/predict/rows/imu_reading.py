"""What inertial sensors with constant errors read of what is true.

Letters: E rows.
"""

from dataclasses import dataclass

from torch import Tensor

from aerial_gym.math.rows import times
from aerial_gym.physics.effects import ImuEffect
from aerial_gym.physics.effects.imu_errors import imu_errors
from aerial_gym.physics.model import Model


@dataclass(frozen=True, kw_only=True)
class Reading:
    """What a sensor reads of true vectors: ``turn^T v + offset``."""

    offset: Tensor
    turn: Tensor

    def of(self, rows: Tensor) -> Tensor:
        """Return what is read of rows (E, 3)."""
        return times(rows, self.turn) + self.offset


def imu_of(model: Model) -> tuple[Reading, Reading]:
    """Return what accelerometer and gyroscope read under the errors of a model, which are the same in all rows."""
    numbers = imu_errors([(effect, params[:1]) for effect, params in model.effects[ImuEffect]]).view(2, 4, 3)
    accelerometer, gyro = (Reading(offset=part[0], turn=part[1:]) for part in numbers)
    return accelerometer, gyro
