"""What a model predicts for every row of a flight, beside what was measured, both in the same band.

Each row is one environment of the simulator: the specific force and angular acceleration of a measured state come from
``physics.accelerations``, the rotor speeds from the commands (``RotorReplay``). One thing is measured where the
simulator would predict it: the angular acceleration in the lever arm of the accelerometer.
Two kinds of channel hold without any dynamics, and so show errors of the inertial sensors alone: the specific force and the
angular velocity that velocity and attitude imply by kinematics, against what the sensors read.
Channels: specific force x, y, z; angular acceleration x, y, z; speed of each rotor; kinematic force x, y, z; kinematic
rate x, y, z. Letters: E rows, C channels, R rotors.
"""

from collections import OrderedDict
from collections.abc import Sequence
from dataclasses import replace
from functools import partial

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from aerial_gym.config.robot import RobotCfg
from aerial_gym.errors import DataError
from aerial_gym.math.quaternion import quat_rotate
from aerial_gym.math.rows import times
from aerial_gym.physics import (
    EFFECTS,
    BodyState,
    Vehicle,
    accelerations,
    build_model,
    condition_in,
    vehicle_from_config,
)
from aerial_gym.physics.answers import Answers
from aerial_gym.physics.effects import (
    Condition,
    ImuEffect,
    LoadEffect,
    RotorEffect,
    RotorSensorEffect,
    VehicleEffect,
    WindEffect,
    WrenchEffect,
)
from aerial_gym.physics.effects.learned_residual import felt_inputs
from aerial_gym.physics.effects.track import Track
from aerial_gym.physics.model import Model
from aerial_gym.physics.rigid_body import SEEN_OF_VEHICLE
from aerial_gym.sim2real.logs.flights import Flight
from aerial_gym.sim2real.logs.signals import lowpass
from aerial_gym.sim2real.predict.channels import KINEMATIC, Channel
from aerial_gym.sim2real.predict.dataset import Dataset, thinned
from aerial_gym.sim2real.predict.imu_reading import imu_of
from aerial_gym.sim2real.predict.model_params import ModelParams, effects_at, key_of
from aerial_gym.sim2real.predict.replay.load import Link, LoadReplay
from aerial_gym.sim2real.predict.replay.memory import remembered_along
from aerial_gym.sim2real.predict.replay.rotors import RotorReplay
from aerial_gym.sim2real.predict.rotor_estimate import RotorEstimate, estimate_rotors
from aerial_gym.sim2real.predict.rows import expand_model, together, with_known_wind
from aerial_gym.sim2real.predict.slow_columns import SlowColumns
from aerial_gym.sim2real.predict.tolerances import (
    Tolerances,
    command_shift,
    deviate,
    deviated,
    joint_start,
    rotor_motion,
    sensor_biases,
)

Array = NDArray[np.float64]
Columns = list[Array]
"""Channels of one flight, each (rows kept,): predictions that differ in some share the others."""

ADDED = (RotorEffect, WrenchEffect, WindEffect)
"""Effects of these kinds add thrust, force or wind; at neutral parameters a model is the same without them."""

CONDITIONS = 2
"""Conditions kept: that of the present model, and of one that differs from it."""

REPLAYS = 3
"""Rotor speeds that are kept in the band."""


KEPT_BYTES = 3e8
"""Predictions are kept as long as they would take no more [bytes] if they had nothing in common: a fit begins where a first
look at the same effect has been, and both begin at the present model."""


class _Together:
    """Predictions for flights whose rows are evaluated at once."""

    def __init__(self, robot: RobotCfg, data: Dataset, tolerances: Tolerances) -> None:
        self.data, self.tolerances = data, tolerances
        self._declared = vehicle_from_config(robot, num_envs=1, dtype=torch.float64)
        self._replay = RotorReplay(data.flights)
        self._load_replay = LoadReplay(data.flights)
        self._forces, self._memories = Answers[Condition](), Answers[Track]()
        self._slow = [SlowColumns(partial(data.slow, index)) for index in range(len(data.flights))]
        self._biased: dict[tuple[int, str], tuple[Array, Columns]] = {}
        self._replayed: list[tuple[list[Array | None], list[Columns]]] = []
        self._conditions: OrderedDict[tuple[object, ...], tuple[object, Condition]] = OrderedDict()

    def predict(self, point: ModelParams) -> list[Columns]:
        """Return the predicted channels of each flight; not to be written to."""
        vehicle, deviation = self._vehicle(point)
        speeds = self._speeds(point, vehicle, deviation)
        rows = self._rows(point, vehicle, deviation, speeds)
        biases = (bias.numpy() for bias in sensor_biases(self.tolerances, deviation))
        implied: dict[str, Array] = dict(zip(KINEMATIC, biases, strict=True))
        return [self._band(index, rows, speeds, implied) for index in range(len(self.data.flights))]

    def felt(self, point: ModelParams) -> list[Array]:
        """Return the inputs of a learned residual at the rows of each flight, in the band, (rows kept, 7) each."""
        vehicle, deviation = self._vehicle(point)
        _, condition = self._flown(point, vehicle, self._speeds(point, vehicle, deviation), deviation)
        rows = felt_inputs(condition.air_velocity, condition.ang_vel, condition.rotor_speed).numpy()
        return [self.data.slow(index, rows[span]) for index, span in enumerate(self.data.spans)]

    def links(self, point: ModelParams) -> list[Link]:
        """Return how the load swings along each flight."""
        vehicle, deviation = self._vehicle(point)
        speeds = self._speeds(point, vehicle, deviation)
        model, condition = self._flown(point, vehicle, speeds, deviation)
        state = BodyState(rotor_speed=condition.rotor_speed, **self.data.state)
        load = self._swing(model, state, condition, self._remembered(model, speeds, deviation), deviation).numpy()
        return [
            Link(time=time, load=load[span]) for time, span in zip(self.data.row_times, self.data.spans, strict=True)
        ]

    def _speeds(self, point: ModelParams, vehicle: Vehicle, deviation: Tensor) -> list[Array | None] | None:
        """Return the rotor speeds that commands lead to, where they are needed."""
        if not self.data.simulated and all(channel.kind != "rotor_speed" for channel in self.data.channels):
            return None
        one = self._model(point, vehicle)
        sensors = () if self.data.simulated else one.effects[RotorSensorEffect]
        return self._replay.speeds(one, command_shift(self.tolerances, deviation), sensors)

    def _vehicle(self, point: ModelParams) -> tuple[Vehicle, Tensor]:
        if point.deviation is None:
            names = self.tolerances.names(self._declared.num_rotors)
            return self._declared, torch.zeros(len(names), dtype=torch.float64)
        deviation = torch.from_numpy(point.deviation)
        return deviate(self._declared, self.tolerances, deviation), deviation

    def _model(self, point: ModelParams, vehicle: Vehicle) -> Model:
        """Return the model of one environment, with what stands around it in every row."""
        return build_model(vehicle, effects_at(point, 1), **self.data.heights, other_position=self.data.other)

    def _rows(
        self, point: ModelParams, vehicle: Vehicle, deviation: Tensor, speeds: list[Array | None] | None
    ) -> dict[str, Array]:
        """Return what the inertial sensors would read in every row, (E, 3) by kind; kinematic ones if their errors vary."""
        kinds = {channel.kind for channel in self.data.channels} - {"rotor_speed"}
        if not kinds:
            return {}
        model, condition = self._flown(point, vehicle, speeds, deviation)
        state = BodyState(rotor_speed=condition.rotor_speed, **self.data.state)
        remembered = self._remembered(model, speeds, deviation)
        load = self._swing(model, state, condition, remembered, deviation) if model.effects[LoadEffect] else None
        found = accelerations(model, state, load=load, remembered=remembered, condition=condition, answers=self._forces)
        # The lever of the accelerometer turns as measured: an error of the torque model stays out of the forces.
        force = found.specific_force + torch.linalg.cross(found.ang_acc - self.data.ang_acc, model.vehicle.com)
        force_bias, rate_bias = sensor_biases(self.tolerances, deviation)
        force_bias = force_bias * self.data.felt_force  # (E, 3)
        if not model.effects[ImuEffect]:
            return {"specific_force": (force + force_bias).numpy(), "angular_acceleration": found.ang_acc.numpy()}
        of_force, of_rate = imu_of(model)
        return {
            "specific_force": (torch.where(self.data.felt_force, of_force.of(force), force) + force_bias).numpy(),
            "angular_acceleration": times(found.ang_acc, of_rate.turn).numpy(),  # a constant error has no derivative
            "kinematic_force": (of_force.of(self.data.kinematic_force) + force_bias).numpy(),
            "kinematic_rate": (of_rate.of(self.data.kinematic_rate) + rate_bias).numpy(),
        }

    def _swing(
        self, model: Model, state: BodyState, condition: Condition, remembered: dict[str, Tensor], deviation: Tensor
    ) -> Tensor:
        """Return the link of the load in every row, (E, 6), begun as the measured specific force says where there is one."""
        if self.data.force is None:
            return self._load_replay.loads(model, self.data.row_times)
        found = accelerations(
            replace(model, effects=model.effects.without(LoadEffect)),
            state,
            remembered=remembered,
            condition=condition,
            answers=self._forces,
        )
        force = found.specific_force
        if model.effects[ImuEffect]:
            force = torch.where(self.data.felt_force, imu_of(model)[0].of(force), force)
        force = self.data.force - force - sensor_biases(self.tolerances, deviation)[0] * self.data.felt_force
        missed = quat_rotate(self.data.state["attitude"], force).numpy()
        return self._load_replay.loads(model, self.data.row_times, [missed[span] for span in self.data.spans])

    def _remembered(self, model: Model, speeds: list[Array | None] | None, deviation: Tensor) -> dict[str, Tensor]:
        """Return what effects on rotors and body remember in every row, (E, M), by effect, followed at the rate of the log."""
        settled = joint_start(self.tolerances, deviation)
        along = remembered_along(model, self.data.flights, speeds, self._memories, settled=settled)
        return {
            name: torch.cat([self.data.thinned(k, part.numpy()) for k, part in enumerate(parts)])
            for name, parts in along.items()
        }

    def _flown(
        self, point: ModelParams, vehicle: Vehicle, speeds: list[Array | None] | None, deviation: Tensor
    ) -> tuple[Model, Condition]:
        """Return the model in every row, and what its effects see there."""
        model = expand_model(self._model(point, vehicle), self.data.state["attitude"].shape[0])
        model = with_known_wind(model, self.data.flights, self.data.flight)
        motion = rotor_motion(deviation)
        key = (*_seen_by_condition(model), motion.numpy().tobytes())
        known = self._conditions.get(key)
        if known is None or known[0] is not speeds:
            speed, spin_up = self._turning(model, speeds, motion)
            known = speeds, condition_in(model, BodyState(rotor_speed=speed, **self.data.state), spin_up)
            self._conditions[key] = known
            while len(self._conditions) > CONDITIONS:
                self._conditions.popitem(last=False)
        self._conditions.move_to_end(key)
        return model, known[1].of_vehicle(model.vehicle)

    def _turning(self, model: Model, speeds: list[Array | None] | None, motion: Tensor) -> tuple[Tensor, Tensor]:
        """Return true rotor speeds [rad/s] and their accelerations [rad/s²] in every row, (E, R).

        ``motion`` (R,): how many standard deviations more than expected the rotors moved in each mode.
        """
        data = self.data
        if data.speed is None or data.spin_up is None or data.unsure_speed is None or data.unsure_spin_up is None:
            assert speeds is not None
            replayed = [(i, s) for i, s in enumerate(speeds) if s is not None]
            speed = torch.cat([self.data.thinned(i, s) for i, s in replayed])
            spin_up = torch.cat([self.data.derivative_of(i, s) for i, s in replayed])
        else:
            speed, spin_up = data.speed, data.spin_up
            if motion.any():
                speed = speed + torch.tensordot(motion, data.unsure_speed, dims=1)
                spin_up = spin_up + torch.tensordot(motion, data.unsure_spin_up, dims=1)
            for effect, params in model.effects[RotorSensorEffect]:
                speed, spin_up = effect.true_speed(speed, params), effect.true_speed(spin_up, params)
        return speed, spin_up

    def _band(
        self, index: int, rows: dict[str, Array], speeds: list[Array | None] | None, biases: dict[str, Array]
    ) -> Columns:
        """Return the predicted channels of a flight in the band.

        ``biases`` are errors (3,) of kinematic channels, for those that are not among the ``rows``.
        """
        kinds = dict.fromkeys(channel.kind for channel in self.data.channels)
        parts = {
            kind: self._off_by(index, kind, biases[kind]) for kind in kinds if kind in KINEMATIC and kind not in rows
        }
        thin = [kind for kind in kinds if kind in rows]
        if thin:
            own = np.concatenate([rows[kind][self.data.spans[index]] for kind in thin], axis=1)
            slow = self._slow[index].of(own)
            parts |= {kind: slow[3 * place : 3 * place + 3] for place, kind in enumerate(thin)}
        if "rotor_speed" in kinds:
            assert speeds is not None
            parts["rotor_speed"] = self._slow_speeds(speeds)[index]
        return [column for kind in kinds for column in parts[kind]]

    def _off_by(self, index: int, kind: str, bias: Array) -> Columns:
        """Return what kinematics imply for the sensors of a flight, off by a bias (3,)."""
        known = self._biased.get((index, kind))
        if known is None or not np.array_equal(known[0], bias):
            known = self._biased[index, kind] = bias, list((self.data.implied[index][kind] + bias).T.copy())
        return known[1]

    def _slow_speeds(self, speeds: list[Array | None]) -> list[Columns]:
        """Return the rotor speeds of each flight in the band."""
        for place, (before, found) in enumerate(self._replayed):
            if before is speeds:
                self._replayed.insert(0, self._replayed.pop(place))
                return found
        found = []
        for flight, kept, speed in zip(self.data.flights, self.data.kept, speeds, strict=True):
            assert speed is not None
            found.append(list(lowpass(speed, flight.rate, self.data.bandwidth)[kept].T.copy()))
        self._replayed.insert(0, (speeds, found))
        del self._replayed[REPLAYS:]
        return found


def _seen_by_condition(model: Model) -> tuple[object, ...]:
    """Return what of a model changes what its effects see, rotor speeds that follow commands aside."""
    of_vehicle = [getattr(model.vehicle, name)[0].numpy().tobytes() for name in SEEN_OF_VEHICLE]
    effects = [*model.effects[WindEffect], *model.effects[RotorSensorEffect]]
    return (*of_vehicle, *((effect.name, params[0].numpy().tobytes()) for effect, params in effects))


class Predictor:
    """Measured channels of some flights, and the predictions of any model for them."""

    def __init__(
        self,
        robot: RobotCfg,
        flights: Sequence[Flight],
        *,
        bandwidth: float,
        channels: Sequence[Channel],
        tolerances: Tolerances,
        every_row: bool = False,
        rotors: Sequence[RotorEstimate | None] | None = None,
    ) -> None:
        """Take the flights.

        Args:
            robot: As declared.
            flights: With what was measured.
            bandwidth: Of the comparison [Hz].
            channels: What is compared.
            tolerances: How well the robot is declared.
            every_row: Whether all rows of the log are kept instead of thinning them to the band.
            rotors: Rotor speeds from which is predicted; None: what is expected in this band.
        """
        self.robot, self.flights, self.bandwidth = robot, tuple(flights), bandwidth
        self.channels, self.tolerances = tuple(channels), tolerances
        simulated = [flight.rotor_speed is None for flight in flights]
        if any(simulated) and not all(simulated):
            raise DataError("some flights have measured rotor speeds and some have not; give flights of one kind")
        turning = estimate_rotors(robot, flights, bandwidth) if rotors is None else rotors
        rows = [flight.num_rows // (1 if every_row else thinned(flight, bandwidth)) for flight in flights]
        self._parts = [
            _Together(
                robot,
                Dataset(
                    self.flights[part],
                    rotors=turning[part],
                    bandwidth=bandwidth,
                    channels=channels,
                    every_row=every_row,
                ),
                tolerances,
            )
            for part in together(rows)
        ]
        self.measured = [measured for part in self._parts for measured in part.data.measured]
        self.times = [time for part in self._parts for time in part.data.times]
        self._declared = vehicle_from_config(robot, num_envs=1, dtype=torch.float64)
        self._predictions: OrderedDict[tuple[object, ...], list[Columns]] = OrderedDict()

    @property
    def num_tolerances(self) -> int:
        """Number N of tolerances."""
        return len(self.tolerances.names(self.robot.num_rotors))

    def predict(self, point: ModelParams) -> list[Array]:
        """Return the predicted channels of each flight, (rows kept, C)."""
        changing = {name: params for name, params in point.effects.items() if not self._adds_nothing(name, params)}
        point = replace(point, effects=changing)
        key = self._told_apart(point)
        if key not in self._predictions:
            self._predictions[key] = [found for part in self._parts for found in part.predict(point)]
            if len(self._predictions) * sum(part.nbytes for part in self.measured) > KEPT_BYTES:
                self._predictions.popitem(last=False)
        self._predictions.move_to_end(key)
        return [np.stack(columns, axis=1) for columns in self._predictions[key]]

    def residuals(self, point: ModelParams) -> list[Array]:
        """Return measured minus predicted channels of each flight, (rows kept, C)."""
        return [m - p for m, p in zip(self.measured, self.predict(point), strict=True)]

    def felt(self, point: ModelParams) -> list[Array]:
        """Return the inputs of a learned residual at the rows of each flight, in the band, (rows kept, 7) each."""
        return [felt for part in self._parts for felt in part.felt(point)]

    def links(self, point: ModelParams) -> list[Link] | None:
        """Return how the load of a model swings along each flight, begun as its log says; None for a model without one."""
        if not any(EFFECTS.get(name).kind is LoadEffect for name in point.effects):
            return None
        return [link for part in self._parts for link in part.links(point)]

    def _told_apart(self, point: ModelParams) -> tuple[object, ...]:
        """Return what tells the predictions of a model from those of others: the vehicle that comes out, and all else in order.

        An effect on the vehicle that changes nothing, or the same as a deviation or another effect, is no other model.
        """
        effects = {name: EFFECTS.get(name).kind for name in point.effects}
        on_vehicle = {name: params for name, params in point.effects.items() if effects[name] is VehicleEffect}
        others = {name: params for name, params in point.effects.items() if name not in on_vehicle}
        off = deviated(self._declared, self.tolerances, point.deviation)
        vehicle = build_model(off.vehicle, effects_at(ModelParams(effects=on_vehicle), 1)).vehicle
        biases = () if point.deviation is None else sensor_biases(self.tolerances, torch.from_numpy(point.deviation))
        sensors = [(place, bias.numpy().tobytes()) for place, bias in enumerate(biases) if bias.any()]
        numbers = [rows.numpy().tobytes() for rows in vehicle.rows().values()]
        if point.deviation is not None and (motion := rotor_motion(torch.from_numpy(point.deviation))).any():
            sensors.append((len(biases), motion.numpy().tobytes()))
        others_key = key_of(ModelParams(effects=others))
        return (*numbers, *sensors, off.command_shift, off.joint_start, others_key, point.learned)

    def _adds_nothing(self, name: str, params: Array) -> bool:
        effect = EFFECTS.get(name)
        return effect.kind in ADDED and np.array_equal(params, effect.neutral(self.robot))
