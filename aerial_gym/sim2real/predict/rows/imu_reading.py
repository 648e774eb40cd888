"""Readings of inertial sensors with the errors of a model and the deviations of a log, in every row.

Letters: E rows, T rows kept.
"""

from collections import OrderedDict
from dataclasses import dataclass

import torch
from torch import Tensor

from aerial_gym.math.quaternion import quat_to_matrix
from aerial_gym.math.rows import times
from aerial_gym.physics import Accelerations
from aerial_gym.physics.effects import ImuEffect
from aerial_gym.physics.effects.imu_errors import imu_errors
from aerial_gym.physics.model import Model
from aerial_gym.sim2real.arrays import Array
from aerial_gym.sim2real.predict.rows.band_response import BandResponse, SensorDelays, split_columns
from aerial_gym.sim2real.predict.rows.dataset import Dataset
from aerial_gym.sim2real.predict.tolerances import SensorDeviation

Columns = list[Array]

READINGS = 3  # Number of stored kinematic readings


@dataclass(frozen=True, kw_only=True)
class SensorReading:
    """Reading of a sensor for true vectors: ``turn^T v + offset``."""

    offset: Tensor
    turn: Tensor

    def apply(self, rows: Tensor) -> Tensor:
        """Return the readings for true rows (E, 3)."""
        return times(rows, self.turn) + self.offset


def imu_readings_of_model(model: Model) -> tuple[SensorReading, SensorReading]:
    """Return the readings of accelerometer and gyro under a model's sensor errors, constant in all rows."""
    numbers = imu_errors([(effect, params[:1]) for effect, params in model.effects[ImuEffect]]).view(2, 4, 3)
    accelerometer, gyro = (SensorReading(offset=part[0], turn=part[1:]) for part in numbers)
    return accelerometer, gyro


class ImuReading:
    """Readings of the inertial sensors in the band."""

    def __init__(self, data: Dataset, in_band: BandResponse) -> None:
        self.data, self._in_band = data, in_band
        self._of_kinematics: OrderedDict[tuple[object, ...], dict[str, Columns]] = OrderedDict()

    def delays_on_prediction_clock(self, logged: SensorDeviation) -> list[float]:
        """Return delays of rotor speeds, accelerometer, gyro, attitude and velocity against rotor speeds or commands [s]."""
        late = logged.delays.tolist()
        clock = 0.0 if self.data.simulated else late[0]
        return [one - clock for one in late]

    def delays_by_flight(self, logged: SensorDeviation) -> SensorDelays:
        """Return the delays of force and rotation on that clock; a derived force has the delay of the attitude."""
        _, acc, gyro, attitude, _ = self.delays_on_prediction_clock(logged)
        force = tuple(acc if flight.accelerometer else attitude for flight in self.data.flights)
        return SensorDelays(force=force, gyro=(gyro,) * len(force))

    def read_channels(
        self, model: Model, accelerations: Accelerations, logged: SensorDeviation, seeming: Tensor | None
    ) -> dict[str, Columns]:
        """Return the sensor readings by kind of channel, three columns (T,) each.

        ``accelerations`` have the delays of the log; ``seeming``: apparent angular acceleration by noise [rad/s²], (T, 3),
        or None.
        """
        felt, force, torque = self.data.felt_force_kept, accelerations.specific_force, accelerations.ang_acc
        if logged.imu_place.any():
            late = self.delays_by_flight(logged)
            force = force + felt * self._in_band.lever_arm_acceleration(logged.imu_place, late).T
        if model.effects[ImuEffect]:
            of_force, of_rate = imu_readings_of_model(model)
            force, torque = torch.where(felt, of_force.apply(force), force), times(torque, of_rate.turn)
        if seeming is not None:
            torque = torque + seeming
        turn = quat_to_matrix(logged.attitude_turn) if logged.attitude.any() else None
        if turn is not None:  # a derived force has the axes of the logged attitude
            force = torch.where(felt, force, times(force, turn))
        *_, attitude, velocity = logged.delays.tolist()
        if velocity != attitude:  # a derived force has the velocity's delay in those axes
            _, jerk, _ = self.data.kinematic_readings()
            force = torch.where(felt, force, force - (velocity - attitude) * jerk)
        implied = self._read_kinematic_channels(model, logged, turn)
        if logged.acc_scale.any():
            # The scale acts on the predicted force; on the implied one, noise would bias it.
            more = force * logged.acc_scale * felt
            force = force + more
            pairs = zip(implied["kinematic_force"], split_columns(more), strict=True)
            implied = {**implied, "kinematic_force": [one + other for one, other in pairs]}
        return {
            "specific_force": split_columns(force + logged.acc_bias * felt),
            "angular_acceleration": split_columns(torque),  # a constant error has no derivative
            **implied,
        }

    def _read_kinematic_channels(
        self, model: Model, logged: SensorDeviation, turn: Tensor | None
    ) -> dict[str, Columns]:
        """Return the kinematic channels with sensor errors, cached for all models with equal errors."""
        errs, turns = model.effects[ImuEffect], () if turn is None else (turn.flatten(),)
        own = (logged.acc_bias, logged.gyro_bias, logged.delays)
        numbers = torch.cat((*own, *turns, *(params[0] for _, params in errs))).numpy().tobytes()
        key = (numbers, *(effect.name for effect, _ in errs))
        if key not in self._of_kinematics:
            _, acc, gyro, attitude, velocity = logged.delays.tolist()
            force, jerk, rate = self.data.kinematic_readings(force_late=acc - attitude, rate_late=gyro - attitude)
            if velocity != attitude:
                force = force + (velocity - attitude) * jerk
            if turn is not None:
                force, rate = times(force, turn.T), times(rate, turn.T)
            if errs:
                of_force, of_rate = imu_readings_of_model(model)
                force, rate = of_force.apply(force), of_rate.apply(rate)
            bias = logged.acc_bias * self.data.felt_force_kept
            self._of_kinematics[key] = {
                "kinematic_force": split_columns(force + bias),
                "kinematic_rate": split_columns(rate + logged.gyro_bias),
            }
            while len(self._of_kinematics) > READINGS:
                self._of_kinematics.popitem(last=False)
        self._of_kinematics.move_to_end(key)
        return self._of_kinematics[key]
