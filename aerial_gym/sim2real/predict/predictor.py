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
from dataclasses import dataclass, field, replace
from itertools import pairwise

import numpy as np
import torch
from numpy.typing import NDArray
from scipy import ndimage
from torch import Tensor

from aerial_gym.config.robot import RobotCfg
from aerial_gym.config.sim import STANDARD_GRAVITY
from aerial_gym.errors import DataError
from aerial_gym.math.quaternion import quat_rotate, quat_rotate_inverse
from aerial_gym.physics import (
    EFFECTS,
    BodyState,
    Vehicle,
    accelerations,
    build_model,
    condition_in,
    vehicle_from_config,
)
from aerial_gym.physics.effects import (
    Condition,
    ImuEffect,
    LearnedResidual,
    LoadEffect,
    RotorEffect,
    RotorSensorEffect,
    WindEffect,
    WrenchEffect,
)
from aerial_gym.physics.effects.arm_joint import ArmJoint
from aerial_gym.physics.effects.learned_residual import felt_inputs
from aerial_gym.physics.model import EffectParams, Model
from aerial_gym.sim2real.logs.checks.conventions import body_rate_of
from aerial_gym.sim2real.logs.flights import Flight
from aerial_gym.sim2real.logs.signals import edge_rows, lowpass
from aerial_gym.sim2real.predict.replay.joint import joint_angles
from aerial_gym.sim2real.predict.replay.load import Link, LoadReplay
from aerial_gym.sim2real.predict.replay.rotors import RotorReplay
from aerial_gym.sim2real.predict.scene import heights, other_at
from aerial_gym.sim2real.predict.tolerances import Tolerances, command_shift, deviate, joint_start, sensor_biases

Array = NDArray[np.float64]

ROWS_PER_BAND = 10.0
"""Rows are evaluated at this many times the bandwidth."""

PREFILTER = 0.35
"""Before, they are low-passed at this share of that rate: 1 - 4e-5 of the amplitude at the bandwidth is left."""

SAMPLES_PER_BAND = 3.0
"""Residuals are kept at this many times the bandwidth."""

HIGHEST_BAND = 0.2
"""The comparison reaches at most to this share of the slowest log's rate."""

FAR_ABOVE = np.array([0.0, 0.0, 1e3])
"""Where a vehicle is taken to be whose log has no position [m], world: away from the ground."""

SETTLE_S = 0.5
"""Dropped at the start where rotor speeds are simulated from commands [s]."""


UNITS = {
    "specific_force": "m/s²",
    "angular_acceleration": "rad/s²",
    "rotor_speed": "rad/s",
    "kinematic_force": "m/s²",
    "kinematic_rate": "rad/s",
}
"""Of each kind of channel, in their order."""

KINEMATIC = ("kinematic_force", "kinematic_rate")
"""Kinds that need no dynamics."""

FORCES = (RotorEffect, WrenchEffect, LoadEffect, ImuEffect)
"""Effects of these kinds change neither vehicle nor wind nor rotor speeds: what others see stays the same."""

ADDED = (RotorEffect, WrenchEffect, WindEffect)
"""Effects of these kinds add thrust, force or wind; at neutral parameters a model is the same without them."""

CONDITIONS = 2
"""Conditions kept: that of the present model, and of one that differs from it."""

MOST_ROWS = 8000
"""Flights are evaluated together up to so many rows: more of them leave the processor's cache, and take longer each."""

PREDICTIONS = 128
"""Predictions kept: a fit begins where a first look at the same effect has been, and both begin at the present model."""


@dataclass(frozen=True, kw_only=True)
class Channel:
    """One compared quantity."""

    kind: str
    """specific_force, angular_acceleration, rotor_speed, kinematic_force or kinematic_rate."""

    axis: str
    """x, y, z, or the number of the rotor."""

    @property
    def unit(self) -> str:
        """SI unit."""
        return UNITS[self.kind]

    @property
    def name(self) -> str:
        """Unique name."""
        return f"{self.kind}.{self.axis}"


@dataclass(frozen=True, kw_only=True)
class ModelParams:
    """Parameters of a model: effects with theirs, and deviations within the tolerances."""

    effects: dict[str, Array] = field(default_factory=dict)
    """Parameters by effect name, each (P,); an effect that is not here is not in the model."""

    deviation: Array | None = None
    """In standard deviations of the tolerances, (N,); None: exactly as declared."""

    learned: LearnedResidual | None = None
    """What flights have taught beyond the effects."""

    def with_effect(self, name: str, params: Array) -> "ModelParams":
        """Return the point with one effect added or replaced."""
        return replace(self, effects={**self.effects, name: params})


def declared_params(robot: RobotCfg) -> ModelParams:
    """Return the model that the robot file declares, without what is random."""
    kept = {name: values for name, values in robot.effects.items() if not EFFECTS.get(name).random}
    return ModelParams(
        effects={name: np.array(EFFECTS.get(name).params_from(values)) for name, values in kept.items()},
        learned=None if robot.learned_residual is None else LearnedResidual(robot.learned_residual),
    )


def effects_at(point: ModelParams, rows: int) -> list[EffectParams]:
    """Return the effects of a point with their parameters in every row, (E, P)."""
    found: list[EffectParams] = [
        (EFFECTS.get(name), torch.from_numpy(np.asarray(params, dtype=float)).expand(rows, -1))
        for name, params in point.effects.items()
    ]
    if point.learned is not None:
        found.append((point.learned, torch.ones(rows, 1, dtype=torch.float64)))
    return found


def comparison_band(flights: Sequence[Flight], bandwidth: float) -> float:
    """Return below which frequency measured and predicted are compared [Hz]: the one asked for, as far as the logs reach."""
    return min(bandwidth, HIGHEST_BAND * min(flight.rate for flight in flights))


def find_channels(flights: Sequence[Flight]) -> tuple[Channel, ...]:
    """Return the channels that every flight has.

    Raises:
        DataError: If there are none.
    """
    found: list[Channel] = []
    if all(flight.specific_force is not None for flight in flights):
        found += [Channel(kind="specific_force", axis=axis) for axis in "xyz"]
    if all(flight.gyro for flight in flights):
        found += [Channel(kind="angular_acceleration", axis=axis) for axis in "xyz"]
    if all(flight.rotor_speed is not None and flight.rotor_command is not None for flight in flights):
        found += [Channel(kind="rotor_speed", axis=str(n + 1)) for n in range(flights[0].num_rotors)]
    if not found:
        raise DataError("the flights have no quantity in common that can be compared; log acc or omega in all of them")
    if all(flight.accelerometer and flight.lin_vel is not None for flight in flights):
        found += [Channel(kind="kinematic_force", axis=axis) for axis in "xyz"]
    if all(flight.gyro and not flight.attitude_integrated for flight in flights):
        found += [Channel(kind="kinematic_rate", axis=axis) for axis in "xyz"]
    return tuple(found)


def expand_rows(vehicle: Vehicle, rows: int) -> Vehicle:
    """Return the vehicle of one environment in every row, without copies."""
    return vehicle.map_rows(lambda values: values.expand(rows, *values.shape[1:]))


def one_row(vehicle: Vehicle, row: int) -> Vehicle:
    """Return the vehicle of one of several environments."""
    return vehicle.map_rows(lambda values: values[row : row + 1])


def expand_model(model: Model, rows: int) -> Model:
    """Return the model of one environment in every row, without copies."""
    return replace(
        model,
        vehicle=expand_rows(model.vehicle, rows),
        inertia_inverse=model.inertia_inverse.expand(rows, 3, 3),
        effects=model.effects.with_params(lambda _, params: params.expand(rows, -1)),
    )


def with_known_wind(model: Model, flights: Sequence[Flight], flight: NDArray[np.int64]) -> Model:
    """Return the model in the wind that was known in the flight of each row, on top of its own; ``flight`` is (E,)."""
    if all(f.wind is None for f in flights):
        return model
    known = torch.tensor([f.wind or (0.0, 0.0, 0.0) for f in flights], dtype=torch.float64)
    steady = EFFECTS.get("constant_wind")
    return replace(model, effects=model.effects.plus(steady, known[torch.from_numpy(flight)]))


def thinned(flight: Flight, bandwidth: float) -> int:
    """Return how many rows of a log are one row that is evaluated."""
    return max(1, int(flight.rate / (ROWS_PER_BAND * bandwidth)))


def _key(point: ModelParams) -> tuple[object, ...]:
    """Return what tells effects and deviations of a point from those of others, their order included."""
    effects = [(name, np.asarray(params, dtype=float).tobytes()) for name, params in point.effects.items()]
    return (None if point.deviation is None else point.deviation.tobytes(), *effects)


class _Together:
    """Flights whose rows are evaluated at once."""

    def __init__(
        self,
        robot: RobotCfg,
        flights: Sequence[Flight],
        *,
        bandwidth: float,
        channels: Sequence[Channel],
        tolerances: Tolerances,
        every_row: bool,
    ) -> None:
        self.flights, self.bandwidth = tuple(flights), bandwidth
        self.channels, self.tolerances = tuple(channels), tolerances
        self._declared = vehicle_from_config(robot, num_envs=1, dtype=torch.float64)
        self._replay = RotorReplay(flights)
        self._load_replay = LoadReplay(flights)
        self._stride = [1 if every_row else thinned(f, bandwidth) for f in flights]
        self._kept = [self._kept_rows(f, s, every_row) for f, s in zip(flights, self._stride, strict=True)]
        self.measured = [self._measure(index) for index in range(len(flights))]
        self.times = [flight.time[kept] for flight, kept in zip(flights, self._kept, strict=True)]
        states = [self._state_rows(index) for index in range(len(flights))]
        self._state = {name: torch.cat([state[name] for state in states]) for name in states[0]}
        ends = np.cumsum([0, *(state["attitude"].shape[0] for state in states)])
        self._spans = [slice(int(a), int(b)) for a, b in pairwise(ends)]
        self._flight = np.repeat(np.arange(len(flights)), np.diff(ends))
        self._row_times = [flight.time[::stride] for flight, stride in zip(flights, self._stride, strict=True)]
        others = [other_at(f, np.arange(0, f.num_rows, s)) for f, s in zip(flights, self._stride, strict=True)]
        rows = [state["attitude"].shape[0] for state in states]
        self._heights, self._other = heights(flights, rows), torch.cat(others)
        self._simulated = all(flight.rotor_speed is None for flight in flights)
        self._measured_speed = (
            None if self._simulated else torch.cat([self._thin(i, "rotor_speed") for i in range(len(flights))])
        )

        accelerometers = all(flight.specific_force is not None for flight in flights)
        self._measured_force = (
            torch.cat([self._thin(i, "specific_force") for i in range(len(flights))]) if accelerometers else None
        )
        felt = torch.tensor(
            [flight.accelerometer for flight in flights]
        )  # else derived from the velocity, without its errors
        self._felt_force = felt[torch.from_numpy(self._flight)].unsqueeze(1)
        self._measured_ang_acc = torch.cat([self._derivative(i, "ang_vel") for i in range(len(flights))])
        self._measured_spin_up = (
            None if self._simulated else torch.cat([self._derivative(i, "rotor_speed") for i in range(len(flights))])
        )
        self._kinematic_force, self._kinematic_rate = (
            torch.cat([of(i) for i in range(len(flights))]) for of in (self._implied_force, self._implied_rate)
        )
        implied = {"kinematic_force": self._kinematic_force.numpy(), "kinematic_rate": self._kinematic_rate.numpy()}
        self._implied = [
            {kind: self._slow(i, rows[self._spans[i]]) for kind, rows in implied.items()} for i in range(len(flights))
        ]
        self._conditions: OrderedDict[tuple[object, ...], Condition] = OrderedDict()

    def predict(self, point: ModelParams) -> list[Array]:
        """Return the predicted channels of each flight, (rows kept, C)."""
        vehicle, deviation = self._vehicle(point)
        speeds = self._speeds(point, vehicle, deviation)
        rows = self._rows(point, vehicle, deviation, speeds)
        biases = (bias.numpy() for bias in sensor_biases(self.tolerances, deviation))
        implied: dict[str, Array] = dict(zip(KINEMATIC, biases, strict=True))
        return [self._band(index, rows, speeds, implied) for index in range(len(self.flights))]

    def felt(self, point: ModelParams) -> list[Array]:
        """Return the inputs of a learned residual at the rows of each flight, in the band, (rows kept, 7) each."""
        vehicle, deviation = self._vehicle(point)
        _, condition = self._flown(point, vehicle, self._speeds(point, vehicle, deviation))
        rows = felt_inputs(condition.air_velocity, condition.ang_vel, condition.rotor_speed).numpy()
        return [self._slow(index, rows[span]) for index, span in enumerate(self._spans)]

    def links(self, point: ModelParams) -> list[Link]:
        """Return how the load swings along each flight."""
        vehicle, deviation = self._vehicle(point)
        model, condition = self._flown(point, vehicle, self._speeds(point, vehicle, deviation))
        state = BodyState(rotor_speed=condition.rotor_speed, **self._state)
        load = self._swing(model, state, condition, deviation).numpy()
        return [Link(time=time, load=load[span]) for time, span in zip(self._row_times, self._spans, strict=True)]

    def _speeds(self, point: ModelParams, vehicle: Vehicle, deviation: Tensor) -> list[Array | None] | None:
        """Return the rotor speeds that commands lead to, where they are needed."""
        if not self._simulated and all(channel.kind != "rotor_speed" for channel in self.channels):
            return None
        one = self._model(point, vehicle)
        sensors = () if self._simulated else one.effects[RotorSensorEffect]
        return self._replay.speeds(one, command_shift(self.tolerances, deviation), sensors)

    def _vehicle(self, point: ModelParams) -> tuple[Vehicle, Tensor]:
        if point.deviation is None:
            names = self.tolerances.names(self._declared.num_rotors)
            return self._declared, torch.zeros(len(names), dtype=torch.float64)
        deviation = torch.from_numpy(point.deviation)
        return deviate(self._declared, self.tolerances, deviation), deviation

    def _model(self, point: ModelParams, vehicle: Vehicle) -> Model:
        """Return the model of one environment, with what stands around it in every row."""
        return build_model(vehicle, effects_at(point, 1), **self._heights, other_position=self._other)

    def _rows(
        self, point: ModelParams, vehicle: Vehicle, deviation: Tensor, speeds: list[Array | None] | None
    ) -> dict[str, Array]:
        """Return what the inertial sensors would read in every row, (E, 3) by kind; kinematic ones if their errors vary."""
        kinds = {channel.kind for channel in self.channels} - {"rotor_speed"}
        if not kinds:
            return {}
        model, condition = self._flown(point, vehicle, speeds)
        state = BodyState(rotor_speed=condition.rotor_speed, **self._state)
        load = self._swing(model, state, condition, deviation) if model.effects[LoadEffect] else None
        angles = self._angles(model, condition, deviation)
        found = accelerations(model, state, load=load, remembered=angles, condition=condition)
        # The lever of the accelerometer turns as measured: an error of the torque model stays out of the forces.
        force = found.specific_force + torch.linalg.cross(found.ang_acc - self._measured_ang_acc, model.vehicle.com)
        force_bias, rate_bias = sensor_biases(self.tolerances, deviation)
        force_bias = force_bias * self._felt_force  # (E, 3)
        if not model.effects[ImuEffect]:
            return {"specific_force": (force + force_bias).numpy(), "angular_acceleration": found.ang_acc.numpy()}
        turning, rate, still = found.ang_acc, self._kinematic_rate, torch.zeros_like(force)
        kinematic_force = self._kinematic_force
        for effect, params in model.effects[ImuEffect]:
            read, rate = effect.measure(force, rate, params)
            force = torch.where(self._felt_force, read, force)
            kinematic_force, moved = effect.measure(kinematic_force, turning, params)
            turning = moved - effect.measure(still, still, params)[1]  # a constant error has no derivative
        return {
            "specific_force": (force + force_bias).numpy(),
            "angular_acceleration": turning.numpy(),
            "kinematic_force": (kinematic_force + force_bias).numpy(),
            "kinematic_rate": (rate + rate_bias).numpy(),
        }

    def _swing(self, model: Model, state: BodyState, condition: Condition, deviation: Tensor) -> Tensor:
        """Return the link of the load in every row, (E, 6), begun as the measured specific force says where there is one."""
        if self._measured_force is None:
            return self._load_replay.loads(model, self._row_times)
        remembered = self._angles(model, condition, deviation)
        found = accelerations(
            replace(model, effects=model.effects.without(LoadEffect)), state, remembered=remembered, condition=condition
        )
        force = found.specific_force
        for effect, params in model.effects[ImuEffect]:
            read, _ = effect.measure(force, self._kinematic_rate, params)
            force = torch.where(self._felt_force, read, force)
        force = self._measured_force - force - sensor_biases(self.tolerances, deviation)[0] * self._felt_force
        missed = quat_rotate(self._state["attitude"], force).numpy()
        return self._load_replay.loads(model, self._row_times, [missed[span] for span in self._spans])

    def _angles(self, model: Model, condition: Condition, deviation: Tensor) -> dict[str, Tensor]:
        """Return the angles of soft arms in every row [rad], (E, R), by effect; empty where they are rigid."""
        found: dict[str, Tensor] = {}
        share = joint_start(self.tolerances, deviation)
        for effect, params in model.effects[WrenchEffect]:
            if isinstance(effect, ArmJoint):
                vehicle = one_row(model.vehicle, 0)
                parts = [
                    joint_angles(
                        effect,
                        vehicle,
                        params[:1],
                        flight,
                        condition.rotor_speed[span],
                        stride / flight.rate,
                        share=share,
                    )
                    for span, stride, flight in zip(self._spans, self._stride, self.flights, strict=True)
                ]
                found[effect.name] = torch.cat(parts)
        return found

    def _flown(
        self, point: ModelParams, vehicle: Vehicle, speeds: list[Array | None] | None
    ) -> tuple[Model, Condition]:
        """Return the model in every row, and what its effects see there."""
        model = expand_model(self._model(point, vehicle), self._state["attitude"].shape[0])
        model = with_known_wind(model, self.flights, self._flight)
        seen = {name: params for name, params in point.effects.items() if EFFECTS.get(name).kind not in FORCES}
        key = _key(replace(point, effects=seen))
        if key not in self._conditions:
            speed, spin_up = self._turning(model, speeds)
            self._conditions[key] = condition_in(model, BodyState(rotor_speed=speed, **self._state), spin_up)
            while len(self._conditions) > CONDITIONS:
                self._conditions.popitem(last=False)
        self._conditions.move_to_end(key)
        return model, self._conditions[key]

    def _turning(self, model: Model, speeds: list[Array | None] | None) -> tuple[Tensor, Tensor]:
        """Return true rotor speeds [rad/s] and their accelerations [rad/s²] in every row, (E, R)."""
        if self._measured_speed is None or self._measured_spin_up is None:
            assert speeds is not None
            replayed = [(i, s) for i, s in enumerate(speeds) if s is not None]
            speed = torch.cat([self._thin_values(i, s) for i, s in replayed])
            spin_up = torch.cat([self._derivative_of(i, s) for i, s in replayed])
        else:
            speed, spin_up = self._measured_speed, self._measured_spin_up
            for effect, params in model.effects[RotorSensorEffect]:
                speed, spin_up = effect.true_speed(speed, params), effect.true_speed(spin_up, params)
        return speed, spin_up

    def _band(
        self, index: int, rows: dict[str, Array], speeds: list[Array | None] | None, implied: dict[str, Array]
    ) -> Array:
        """Return the predicted channels of a flight in the band, (rows kept, C).

        ``implied`` has the errors (3,) of kinematic channels, for those that are not among the ``rows``.
        """
        flight = self.flights[index]
        kinds = dict.fromkeys(channel.kind for channel in self.channels)
        parts = {kind: self._implied[index][kind] + implied[kind] for kind in kinds if kind in KINEMATIC}
        thin = [kind for kind in kinds if kind in rows]
        if thin:
            slow = self._slow(index, np.concatenate([rows[kind][self._spans[index]] for kind in thin], axis=1))
            parts |= dict(zip(thin, np.split(slow, len(thin), axis=1), strict=True))
        if "rotor_speed" in kinds:
            assert speeds is not None
            speed = speeds[index]
            assert speed is not None
            parts["rotor_speed"] = lowpass(speed, flight.rate, self.bandwidth)[self._kept[index]]
        return np.concatenate([parts[kind] for kind in kinds], axis=1)

    def _slow(self, index: int, rows: Array) -> Array:
        """Return values at the rows of a flight (E, any) in the band, (rows kept, any)."""
        stride = self._stride[index]
        return lowpass(rows, self.flights[index].rate / stride, self.bandwidth)[self._kept[index] // stride]

    def _measure(self, index: int) -> Array:
        """Return the measured channels of a flight in the band, (rows kept, C)."""
        flight = self.flights[index]
        sources = {
            "specific_force": (flight.specific_force, False),
            "angular_acceleration": (flight.ang_vel, True),
            "rotor_speed": (flight.rotor_speed, False),
            "kinematic_force": (flight.specific_force, False),
            "kinematic_rate": (flight.ang_vel, False),
        }
        parts = []
        for kind in dict.fromkeys(channel.kind for channel in self.channels):
            values, derivative = sources[kind]
            assert values is not None
            parts.append(lowpass(values, flight.rate, self.bandwidth, derivative=derivative)[self._kept[index]])
        return np.concatenate(parts, axis=1)

    def _kept_rows(self, flight: Flight, stride: int, every_row: bool) -> NDArray[np.int64]:
        """Return the rows of the log at which residuals are kept: multiples of the stride, without the ends."""
        edge = edge_rows(flight.rate, self.bandwidth)
        start = edge if flight.rotor_command is None else max(edge, round(SETTLE_S * flight.rate))
        step = 1 if every_row else stride * max(1, int(flight.rate / stride / (SAMPLES_PER_BAND * self.bandwidth)))
        rows = np.arange(-(-start // step) * step, flight.num_rows - edge, step)
        if flight.on_ground is None or every_row:  # a spectrum needs all of them
            return rows
        near = edge_rows(flight.rate, self.bandwidth)  # the low-pass spreads the jolt of a touch as it spreads an end
        touched = np.asarray(ndimage.maximum_filter1d(flight.on_ground, 2 * near + 1), dtype=bool)
        return rows[np.logical_not(touched[rows])]

    def _state_rows(self, index: int) -> dict[str, Tensor]:
        attitude = self._thin(index, "attitude")
        return {
            "position": self._thin(index, "position"),
            "attitude": attitude / attitude.norm(dim=1, keepdim=True),
            "lin_vel": self._thin(index, "lin_vel"),
            "ang_vel": self._thin(index, "ang_vel"),
        }

    def _thin(self, index: int, name: str) -> Tensor:
        values = getattr(self.flights[index], name)
        if values is None:
            unknown = FAR_ABOVE if name == "position" else np.zeros(3)
            values = np.tile(unknown, (self.flights[index].num_rows, 1))
        return self._thin_values(index, values)

    def _derivative(self, index: int, name: str) -> Tensor:
        """Return the derivative of a quantity at the rows of a flight, (E, any); zeros where the log lacks it."""
        values = getattr(self.flights[index], name)
        return self._derivative_of(index, np.zeros((self.flights[index].num_rows, 3)) if values is None else values)

    def _derivative_of(self, index: int, values: Array) -> Tensor:
        slow = lowpass(values, self.flights[index].rate, self._wide(index), derivative=True)
        return torch.from_numpy(np.ascontiguousarray(slow[:: self._stride[index]]))

    def _wide(self, index: int) -> float:
        """Return the band of derivatives [Hz]: wider than the comparison, unless the angular velocity is itself derived."""
        flight = self.flights[index]
        return PREFILTER * flight.rate / self._stride[index] if flight.gyro else self.bandwidth

    def _implied_force(self, index: int) -> Tensor:
        """Return ``R^T (v' + g e_z)`` [m/s²], body, (E, 3): what an accelerometer without errors reads."""
        acceleration = self._derivative(index, "lin_vel")
        acceleration[:, 2] += STANDARD_GRAVITY
        attitude = self._thin(index, "attitude")
        return quat_rotate_inverse(attitude / attitude.norm(dim=1, keepdim=True), acceleration)

    def _implied_rate(self, index: int) -> Tensor:
        """Return the angular velocity that the attitude implies [rad/s], body, (E, 3)."""
        flight = self.flights[index]
        rate = body_rate_of(flight.attitude, flight.rate, self._wide(index))
        return torch.from_numpy(np.ascontiguousarray(rate[:: self._stride[index]]))

    def _thin_values(self, index: int, values: Array) -> Tensor:
        """Return every n-th row of values that were low-passed below half of that rate."""
        stride = self._stride[index]
        if stride > 1:
            values = lowpass(values, self.flights[index].rate, PREFILTER * self.flights[index].rate / stride)[::stride]
        return torch.from_numpy(np.ascontiguousarray(values))


def together(rows: Sequence[int]) -> list[slice]:
    """Return which neighbouring flights are evaluated together, given the rows of each: MOST_ROWS, or a longer one alone."""
    ends = [0]
    for index in range(1, len(rows)):
        if sum(rows[ends[-1] : index + 1]) > MOST_ROWS:
            ends.append(index)
    return [slice(a, b) for a, b in pairwise([*ends, len(rows)])]


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
    ) -> None:
        """Take the flights; ``every_row`` keeps all rows of the log instead of thinning them to the band."""
        self.robot, self.flights, self.bandwidth = robot, tuple(flights), bandwidth
        self.channels, self.tolerances = tuple(channels), tolerances
        simulated = [flight.rotor_speed is None for flight in flights]
        if any(simulated) and not all(simulated):
            raise DataError("some flights have measured rotor speeds and some have not; give flights of one kind")
        rows = [flight.num_rows // (1 if every_row else thinned(flight, bandwidth)) for flight in flights]
        self._parts = [
            _Together(
                robot,
                self.flights[part],
                bandwidth=bandwidth,
                channels=channels,
                tolerances=tolerances,
                every_row=every_row,
            )
            for part in together(rows)
        ]
        self.measured = [measured for part in self._parts for measured in part.measured]
        self.times = [time for part in self._parts for time in part.times]
        self._predictions: OrderedDict[tuple[object, ...], list[Array]] = OrderedDict()

    @property
    def num_tolerances(self) -> int:
        """Number N of tolerances."""
        return len(self.tolerances.names(self.robot.num_rotors))

    def predict(self, point: ModelParams) -> list[Array]:
        """Return the predicted channels of each flight, (rows kept, C); not to be written to."""
        changing = {name: params for name, params in point.effects.items() if not self._adds_nothing(name, params)}
        point = replace(point, effects=changing)
        key = (*_key(point), point.learned)
        if key not in self._predictions:
            self._predictions[key] = [found for part in self._parts for found in part.predict(point)]
            if len(self._predictions) > PREDICTIONS:
                self._predictions.popitem(last=False)
        self._predictions.move_to_end(key)
        return self._predictions[key]

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

    def _adds_nothing(self, name: str, params: Array) -> bool:
        effect = EFFECTS.get(name)
        return effect.kind in ADDED and np.array_equal(params, effect.neutral(self.robot))
