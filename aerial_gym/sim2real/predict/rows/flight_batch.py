"""Batched predictions for several flights, with intermediate results cached between models.

Letters: E rows, T rows kept, R rotors, N tolerances.
"""

from collections import OrderedDict
from dataclasses import dataclass, replace

import numpy as np
import torch
from torch import Tensor

from aerial_gym.config.robot import RobotCfg
from aerial_gym.math.quaternion import quat_conjugate, quat_exp, quat_multiply, quat_rotate, quat_rotate_inverse
from aerial_gym.math.rows import sum_slices
from aerial_gym.physics import Accelerations, BodyState, Vehicle, accelerations, build_model, condition_in
from aerial_gym.physics.effect_cache import EffectCache
from aerial_gym.physics.effects import (
    AttitudeSensorEffect,
    Condition,
    Effect,
    ImuEffect,
    LoadEffect,
    RotorSensorEffect,
    SuspensionMotion,
    WindEffect,
    WrenchEffect,
)
from aerial_gym.physics.effects.base import RotorSpeedsOfFlight
from aerial_gym.physics.effects.learned_residual import network_inputs
from aerial_gym.physics.model import Model
from aerial_gym.physics.rigid_body import (
    MOVES_OF_VEHICLE,
    adapt_condition,
    add_fluid_contributions,
    append_memory_to_params,
    condition_at_origin,
    force_breakdown,
    lever_acceleration,
    load_suspension,
    suspension_pull,
)
from aerial_gym.sim2real.arrays import Array
from aerial_gym.sim2real.logs.signals import lowpass
from aerial_gym.sim2real.predict.model_params import ModelParams, expand_effects, params_from_robot
from aerial_gym.sim2real.predict.replay.load import LoadLink, LoadReplay
from aerial_gym.sim2real.predict.replay.rotors import RotorReplay, replay_memory
from aerial_gym.sim2real.predict.rows.band_response import BandResponse, Columns, ImuReading, imu_readings_of_model
from aerial_gym.sim2real.predict.rows.batches import add_known_wind, expand_model
from aerial_gym.sim2real.predict.rows.dataset import Dataset
from aerial_gym.sim2real.predict.rows.spectra import delay_by_quarter_period, torque_gain_uncertainty
from aerial_gym.sim2real.predict.tolerances import (
    SensorErrors,
    Tolerances,
    VehicleForReplay,
    sensor_errors,
    vehicle_for_replay,
)

CONDITIONS = 4  # Number of cached conditions: of the present model, at body and hubs, and of a changed model
REPLAYS = 3  # Number of cached rotor speeds in the band

ERRORS_OF_MOTION = ("rotor_motion", "attitude", "velocity_scale", "velocity_place", "gyro_scale", "delays")
"""Sensor errors that change the predicted motion; the others change only readings."""

ERRORS_OF_ACCELEROMETER = ("acc_bias", "acc_scale", "imu_place")
"""Sensor errors that the initial swing of a load depends on as well: it is found from the measured force."""


@dataclass(frozen=True, kw_only=True)
class _ModelQuery:
    """A model with the inputs of its prediction."""

    model: Model  # One environment
    off: VehicleForReplay  # Vehicle and replay settings of these deviations
    logged: SensorErrors  # Sensor errors of these deviations
    speeds: list[Array | None] | None  # Rotor speeds from commands of each flight [rad/s], (T, R); None if not needed


@dataclass(frozen=True, kw_only=True)
class _LoadQuery:
    """Motion of the load's suspension along the flights, from a model without the load."""

    key: tuple[object, ...]
    speeds: list[Array | None] | None
    attitude: Tensor  # Body to world, xyzw, (E, 4)
    suspension: SuspensionMotion
    missed: list[Array] | None  # Specific force residual [m/s²], world, (rows, 3) per flight, if measured


class FlightBatch:
    """Predictions for a batch of flights."""

    def __init__(self, robot: RobotCfg, declared: Vehicle, data: Dataset, tolerances: Tolerances) -> None:
        self.data, self.tolerances, self._declared = data, tolerances, declared
        self._replay = RotorReplay(data.flights)
        self._load_replay = LoadReplay(data.flights, data.row_times)
        self._in_band = BandResponse(data)
        self._nothing = torch.zeros(len(tolerances.names(self._declared.num_rotors)), dtype=torch.float64)
        self._imu = ImuReading(data, self._in_band)
        self._replayed: list[tuple[list[Array | None], float, Columns]] = []
        self._params, self._in_step = params_from_robot(robot), None
        self._accelerometer = torch.tensor(robot.body.accelerometer, dtype=torch.float64)
        self.clear_caches()

    def clear_caches(self) -> None:
        """Free the cached rows of effects, which are large after predictions with many different effects."""
        self._forces, self._memories = EffectCache[Condition](), EffectCache[RotorSpeedsOfFlight]()
        self._conditions: OrderedDict[tuple[object, ...], tuple[object, Condition]] = OrderedDict()
        self._hung: _LoadQuery | None = None
        self._moving: tuple[tuple[object, ...], list[Array | None] | None, Accelerations] | None = None
        self._spinning: tuple[tuple[object, ...], list[Array | None] | None, tuple[Tensor, Tensor]] | None = None
        self._in_band.clear_cache()

    @torch.inference_mode()
    def predict(self, params: ModelParams, off: VehicleForReplay | None = None) -> list[Columns]:
        """Return the predicted channels of each flight; read-only. ``off``: the vehicle with the deviations, if known."""
        asked = self._make_query(params, off)
        kinds = dict.fromkeys(channel.kind for channel in self.data.channels)
        rows = self._imu_prediction(asked) if kinds.keys() - {"rotor_speed"} else {}
        if "rotor_speed" in kinds:
            assert asked.speeds is not None
            rows["rotor_speed"] = self._rotor_speeds_in_band(asked.speeds, float(asked.logged.delays[0]))
        columns = [column for kind in kinds for column in rows[kind]]
        return [[column[span] for column in columns] for span in self.data.kept_spans]

    @torch.inference_mode()
    def residual_inputs(self, params: ModelParams) -> list[Array]:
        """Return the inputs of a learned residual at the rows of each flight, in the band, (rows kept, 7) each."""
        asked = self._make_query(params)
        condition = self._effect_condition(self._model_in_every_row(asked), asked)
        rows = network_inputs(condition.air_velocity, condition.ang_vel, condition.rotor_speed).numpy()
        return [self.data.lowpass_kept_rows(index, rows[span]) for index, span in enumerate(self.data.spans)]

    @torch.inference_mode()
    def load_links(self, params: ModelParams) -> list[LoadLink]:
        """Return the state of the load's link along each flight."""
        asked = self._make_query(params)
        model = self._model_in_every_row(asked)
        condition, remembered = self._effect_condition(model, asked), self._effect_memory(model, asked)
        hanging = self._load_query(model, condition, remembered, asked)
        load = self._load_replay.link_states(model, hanging.missed).numpy()
        rows = self.data.row_times, self.data.spans
        return [LoadLink(time=time, load=load[span]) for time, span in zip(*rows, strict=True)]

    def _make_query(self, params: ModelParams, off: VehicleForReplay | None = None) -> _ModelQuery:
        """Return the model in one environment with its deviations, its scene in every row and the commanded rotor speeds."""
        off = off or vehicle_for_replay(self._declared, self.tolerances, params.deviation)
        deviation = self._nothing if params.deviation is None else torch.from_numpy(params.deviation)
        model = build_model(off.vehicle, expand_effects(params, 1), **self.data.heights, other_position=self.data.other)
        speeds = None
        if self.data.simulated or any(channel.kind == "rotor_speed" for channel in self.data.channels):
            sensors = () if self.data.simulated else model.effects[RotorSensorEffect]
            speeds = self._replay.speeds(model, off.command_shift, sensors, off.command_gain)
        logged = sensor_errors(self.tolerances, deviation)
        turns = [effect.turn(params)[0] for effect, params in model.effects[AttitudeSensorEffect]]
        turn = sum(turns, logged.attitude)
        logged = replace(logged, imu_place=logged.imu_place + self._accelerometer, attitude=turn)
        return _ModelQuery(model=model, off=off, logged=logged, speeds=speeds)

    def _imu_prediction(self, asked: _ModelQuery) -> dict[str, Columns]:
        """Return the inertial sensor readings that a model predicts, in the band: three columns (T,) by kind."""
        model, noise = self._model_in_every_row(asked), asked.logged.answered_noise
        seeming = sum_slices(noise.view(2, 3) * self._torque_noise_std(), 1) if noise.any() else None
        key, before = self._motion_key(asked), self._moving
        if before is None or before[0] != key or before[1] is not asked.speeds:
            self._moving = before = key, asked.speeds, self._accelerations_in_band(model, asked)
            self._forces.drop_unused()
            self._memories.drop_unused()
        return self._imu.read_channels(model, before[2], asked.logged, seeming)

    def _motion_key(self, asked: _ModelQuery, *excluded: type[Effect]) -> tuple[object, ...]:
        """Return a hashable key of the predicted motion without some effects, except commanded rotor speeds."""
        names, effects = ERRORS_OF_MOTION, asked.model.effects
        names = (*names, *ERRORS_OF_ACCELEROMETER) if effects[LoadEffect] else names
        rows = [*asked.model.vehicle.tensors_by_name().values(), *(getattr(asked.logged, name) for name in names)]
        rows += [asked.off.load_place] if effects[LoadEffect] else []
        pairs = ((effect, params.numpy().tobytes()) for effect, params in effects.exclude(*excluded))
        return (asked.off.joint_start, *pairs, *(numbers.numpy().tobytes() for numbers in rows))

    def _accelerations_in_band(self, flown: Model, asked: _ModelQuery) -> Accelerations:
        """Return the accelerations that a model predicts, in the band, with the delays of the log."""
        remembered = self._effect_memory(flown, asked)
        model, hubs = append_memory_to_params(flown, remembered), None
        if any(effect.needs_com for effect, _ in model.effects):
            condition = self._effect_condition(flown, asked)
        else:
            condition = hubs = self._effect_condition(flown, asked, at_origin=True)
            at_hubs = all(effect.at_hubs for effect, _ in model.effects[WrenchEffect])
            if not at_hubs and model.vehicle.com.any():
                condition = self._effect_condition(flown, asked)
        acting = force_breakdown(model, condition, self._forces, apart=True, hubs=hubs)
        acting = add_fluid_contributions(model, condition, acting)
        if model.effects[LoadEffect]:
            hanging = self._load_query(flown, condition, remembered, asked)
            load = self._load_replay.link_states(flown, hanging.missed)
            force, torque, _ = suspension_pull(flown, hanging.attitude, hanging.suspension, load, asked.off.load_place)
            wrench = torch.cat((quat_rotate_inverse(hanging.attitude, force), torque), dim=-1)
            acting.wrenches.append(("load", wrench))
        about = None if hubs is None else hubs.vehicle.com[0]
        late = self._imu.delays_by_flight(asked.logged)
        return self._in_band.accelerations_in_band(model, condition.rotor_speed, acting, about=about, late=late)

    def _torque_noise_std(self) -> Tensor:
        """Return the standard deviation of the apparent angular acceleration by correlated noise [rad/s²], body, (T, 2, 3).

        The first is in phase with the torque, the second a quarter period late.
        """
        if self._in_step is None:
            columns = self._imu_prediction(self._make_query(self._params))["angular_acceleration"]
            turning, parts = np.stack(columns, axis=1), []
            for flight, span in zip(self.data.flights, self.data.kept_spans, strict=True):
                share = torque_gain_uncertainty(flight, self._declared, turning[span], self.data.bandwidth)
                moved = turning[span] - turning[span].mean(axis=0)
                parts.append(share * np.stack((moved, delay_by_quarter_period(moved)), axis=1))
            self._in_step = torch.from_numpy(np.concatenate(parts))
        return self._in_step

    def _load_query(
        self, model: Model, condition: Condition, remembered: dict[str, Tensor], asked: _ModelQuery
    ) -> _LoadQuery:
        """Return the motion of the load's suspension, reused unless another part of the model has changed."""
        key = self._motion_key(asked, LoadEffect)
        if self._hung is not None and self._hung.key == key and self._hung.speeds is asked.speeds:
            return self._hung
        state = BodyState(rotor_speed=condition.rotor_speed, **self._motion_state(asked))
        attitude = state.attitude
        alone = replace(model, effects=model.effects.exclude(LoadEffect))
        results = accelerations(alone, state, remembered=remembered, condition=condition, answers=self._forces)
        missed, force = None, results.specific_force
        acceleration = quat_rotate(attitude, force) - model.gravity * force.new_tensor((0.0, 0.0, 1.0))
        if self.data.force is not None:
            if model.effects[ImuEffect]:
                force = torch.where(self.data.felt_force, imu_readings_of_model(model)[0].apply(force), force)
            felt, logged = self.data.felt_force, asked.logged
            places = torch.where(felt, logged.imu_place, logged.velocity_place)
            force = (force + lever_acceleration(state.ang_vel, results.ang_acc, places)) * (
                1.0 + felt * logged.acc_scale
            )
            force = self.data.force - force - felt * logged.acc_bias
            missed = [quat_rotate(attitude, force).numpy()[span] for span in self.data.spans]
        place = asked.off.load_place.expand_as(force)
        turning = lever_acceleration(state.ang_vel, results.ang_acc, place)
        suspension = load_suspension(model, attitude, acceleration + quat_rotate(attitude, turning), place)
        self._hung = _LoadQuery(key=key, speeds=asked.speeds, attitude=attitude, suspension=suspension, missed=missed)
        return self._hung

    def _effect_memory(self, model: Model, asked: _ModelQuery) -> dict[str, Tensor]:
        """Return the memory of effects on rotors and body in every row, (E, M), by effect, replayed at the log's rate."""
        along = replay_memory(model, self.data.flights, asked.speeds, self._memories, settled=asked.off.joint_start)
        return {
            name: torch.cat([self.data.thin_rows(k, part.numpy()) for k, part in enumerate(parts)])
            for name, parts in along.items()
        }

    def _model_in_every_row(self, asked: _ModelQuery) -> Model:
        """Return the model in every row."""
        model = expand_model(asked.model, self.data.state["attitude"].shape[0])
        return add_known_wind(model, self.data.flights, self.data.flight)

    def _motion_state(self, asked: _ModelQuery) -> dict[str, Tensor]:
        """Return the motion of the body origin in every row on the rotor speeds' clock, without errors of the logged pose."""
        results, logged = dict(self.data.state), asked.logged
        *_, attitude, velocity = self._imu.delays_on_prediction_clock(logged)
        if logged.velocity_scale.any():
            results["lin_vel"] = results["lin_vel"] / (1.0 + logged.velocity_scale)
        if velocity:
            results["lin_vel"] = results["lin_vel"] + velocity * self.data.acceleration
        if attitude:
            results["position"] = results["position"] + attitude * self.data.state["lin_vel"]
            results["attitude"] = quat_multiply(results["attitude"], quat_exp(attitude * results["ang_vel"]))
        if logged.attitude.any():
            back = quat_conjugate(logged.attitude_turn)
            results["attitude"] = quat_multiply(results["attitude"], back.expand_as(results["attitude"]))
        if logged.velocity_place.any():
            place = logged.velocity_place.expand_as(results["ang_vel"])
            results["position"] = results["position"] - quat_rotate(results["attitude"], place)
            turning = torch.linalg.cross(results["ang_vel"], place)
            results["lin_vel"] = results["lin_vel"] - quat_rotate(results["attitude"], turning)
        return results

    def _effect_condition(self, model: Model, asked: _ModelQuery, *, at_origin: bool = False) -> Condition:
        """Return the motion seen by a model's effects in every row; ``at_origin``: at hubs (``condition_at_origin``)."""
        motion = asked.logged.rotor_motion
        speeds = asked.speeds if self.data.speed is None else None
        pose_late = motion.new_tensor(self._imu.delays_on_prediction_clock(asked.logged)[3:])
        errors = (getattr(asked.logged, name) for name in ("attitude", "velocity_scale", "velocity_place"))
        numbers = torch.cat((motion, *errors, pose_late)).numpy().tobytes()
        key = (at_origin, *_condition_key(model, at_origin=at_origin), numbers)
        known = self._conditions.get(key)
        if known is not None and known[0] is speeds:
            self._conditions.move_to_end(key)
            vehicle = replace(model.vehicle, com=known[1].vehicle.com) if at_origin else model.vehicle
            return adapt_condition(vehicle, known[1])
        speed, spin_up = self._rotor_speeds_and_accelerations(model, speeds, motion)
        make = condition_at_origin if at_origin else condition_in
        results = make(model, BodyState(rotor_speed=speed, **self._motion_state(asked)), spin_up)
        self._conditions[key] = speeds, results
        while len(self._conditions) > CONDITIONS:
            self._conditions.popitem(last=False)
        return results

    def _rotor_speeds_and_accelerations(
        self, model: Model, speeds: list[Array | None] | None, motion: Tensor
    ) -> tuple[Tensor, Tensor]:
        """Return true rotor speeds [rad/s], [rad/s²], (E, R); ``motion`` (R,): deviation of each mode in its std.

        The last one is cached: equal tensors need no comparison.
        """
        sensors = model.effects[RotorSensorEffect]
        key = (motion.numpy().tobytes(), *((effect.name, params[0].numpy().tobytes()) for effect, params in sensors))
        if self._spinning is not None and self._spinning[0] == key and self._spinning[1] is speeds:
            return self._spinning[2]
        data = self.data
        if data.speed is None or data.spin_up is None or data.unsure_speed is None or data.unsure_spin_up is None:
            assert speeds is not None
            replayed = [(i, s) for i, s in enumerate(speeds) if s is not None]
            speed = torch.cat([self.data.thin_rows(i, s) for i, s in replayed])
            spin_up = torch.cat([self.data.derivative_at_rows(i, s) for i, s in replayed])
        else:
            speed, spin_up = data.speed, data.spin_up
            if motion.any():
                speed = speed + torch.tensordot(motion, data.unsure_speed, dims=1)
                spin_up = spin_up + torch.tensordot(motion, data.unsure_spin_up, dims=1)
            for effect, params in sensors:
                speed, spin_up = effect.true_speed(speed, params), effect.true_speed(spin_up, params)
        self._spinning = key, speeds, (speed, spin_up)
        return speed, spin_up

    def _rotor_speeds_in_band(self, speeds: list[Array | None], late: float) -> Columns:
        """Return the rotor speeds of all flights in the band with a delay [s]."""
        for place, (before, seconds, results) in enumerate(self._replayed):
            if before is speeds and seconds == late:
                self._replayed.insert(0, self._replayed.pop(place))
                return results
        parts = []
        for flight, kept, speed in zip(self.data.flights, self.data.kept, speeds, strict=True):
            assert speed is not None
            parts.append(lowpass(speed, flight.rate, self.data.bandwidth, late=late)[kept])
        results = list(np.concatenate(parts).T.copy())
        self._replayed.insert(0, (speeds, late, results))
        del self._replayed[REPLAYS:]
        return results


def _condition_key(model: Model, *, at_origin: bool) -> tuple[object, ...]:
    """Return a hashable key of the model parts that change the motion seen by effects, except commanded rotor speeds."""
    names = [name for name in MOVES_OF_VEHICLE if not at_origin or name != "com"]
    of_vehicle = [getattr(model.vehicle, name)[0].numpy().tobytes() for name in names]
    effects = [*model.effects[WindEffect], *model.effects[RotorSensorEffect]]
    return (*of_vehicle, *((effect.name, params[0].numpy().tobytes()) for effect, params in effects))
