"""One-step predictions of a model for every row of a flight, and the measured channels in the same band.

``physics.accelerations`` predicts specific force and angular acceleration from the measured state, ``RotorReplay`` the
rotor speeds from the commands. The accelerometer's lever arm uses the measured rotation. The kinematic channels need no
dynamics: they compare inertial sensors with the specific force and angular velocity that velocity and attitude imply.
Letters: E rows (environments of the simulator), C channels, R rotors.
"""

from collections import OrderedDict
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import torch

from aerial_gym.config.robot import RobotCfg
from aerial_gym.errors import DataError
from aerial_gym.interop import map_in_threads
from aerial_gym.physics import EFFECTS, build_model, vehicle_from_config
from aerial_gym.physics.effects import LoadEffect, VehicleEffect
from aerial_gym.sim2real.arrays import Array
from aerial_gym.sim2real.logs.flights import Flight
from aerial_gym.sim2real.memory import give_back_memory
from aerial_gym.sim2real.predict.channels import Channel
from aerial_gym.sim2real.predict.model_params import ModelParams, expand_effects, params_key
from aerial_gym.sim2real.predict.replay.load import LoadLink
from aerial_gym.sim2real.predict.rows.batches import group_flights
from aerial_gym.sim2real.predict.rows.dataset import Dataset, row_stride
from aerial_gym.sim2real.predict.rows.flight_batch import Columns, FlightBatch
from aerial_gym.sim2real.predict.rows.rotor_estimate import RotorEstimate, estimate_rotors
from aerial_gym.sim2real.predict.tolerances import Tolerances, VehicleForReplay, sensor_errors, vehicle_for_replay

KEPT_BYTES = 2e7  # Memory for stored predictions [bytes], as if they shared nothing; fits often return to one
MOST_TOLD = 512  # Number of models whose prediction keys are stored


class Predictor:
    """Measured channels of flights, and predictions of any model for them."""

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
        """Load flights; ``every_row``: without thinning; ``rotors``: rotor speeds of the prediction, None: expected ones."""
        self.robot, self.flights, self.bandwidth = robot, tuple(flights), bandwidth
        self.channels, self.tolerances = tuple(channels), tolerances
        simulated = [flight.rotor_speed is None for flight in flights]
        if any(simulated) and not all(simulated):
            without = ", ".join(flight.name for flight in flights if flight.rotor_speed is None)
            raise DataError(
                f"{without}: without measured rotor speeds, but other flights have them and no commands; leave out either kind"
            )
        turning = estimate_rotors(robot, flights, bandwidth) if rotors is None else rotors
        rows = [flight.num_rows // (1 if every_row else row_stride(flight, bandwidth)) for flight in flights]
        self._declared = vehicle_from_config(robot, num_envs=1, dtype=torch.float64)

        def make_batch(part: slice) -> FlightBatch:
            settings = {"bandwidth": bandwidth, "channels": channels, "every_row": every_row}
            return FlightBatch(
                robot, self._declared, Dataset(self.flights[part], rotors=turning[part], **settings), tolerances
            )

        self._parts = [make_batch(part) for part in group_flights(rows)]
        self.measured = [np.asfortranarray(measured) for part in self._parts for measured in part.data.measured]
        self.times = [time for part in self._parts for time in part.data.times]
        self._predictions: OrderedDict[tuple[object, ...], list[Columns]] = OrderedDict()
        self._told: dict[tuple[object, ...], tuple[object, ...]] = {}
        self._off: tuple[bytes | None, VehicleForReplay] | None = None

    @property
    def num_tolerances(self) -> int:
        """Number N of tolerances."""
        return len(self.tolerances.names(self.robot.num_rotors))

    def predict(self, params: ModelParams) -> list[Array]:
        """Return the predicted channels of each flight, (rows kept, C)."""
        effects = [(EFFECTS.get(name), values) for name, values in params.effects.items()]
        changing = {e.name: v for e, v in effects if not (e.additive and np.array_equal(v, e.neutral(self.robot)))}
        params = replace(params, effects=changing)
        numbers = (params.learned, *params_key(params))
        if numbers not in self._told:
            self._told[numbers] = self._prediction_key(params)
            if len(self._told) > MOST_TOLD:
                del self._told[next(iter(self._told))]
        key = self._told[numbers]
        if key not in self._predictions:
            off = self._vehicle_for_replay(params)
            of_parts = map_in_threads(lambda part: part.predict(params, off), self._parts)
            self._predictions[key] = [prediction for of_part in of_parts for prediction in of_part]
            if len(self._predictions) * sum(part.nbytes for part in self.measured) > KEPT_BYTES:
                self._predictions.popitem(last=False)
        self._predictions.move_to_end(key)
        return [np.stack(columns).T for columns in self._predictions[key]]

    def clear_caches(self) -> None:
        """Free the cached rows of effects, but not the predictions."""
        for part in self._parts:
            part.clear_caches()
        give_back_memory()

    def residuals(self, params: ModelParams) -> list[Array]:
        """Return measured minus predicted channels of each flight, (rows kept, C)."""
        return [m - p for m, p in zip(self.measured, self.predict(params), strict=True)]

    def residual_inputs(self, params: ModelParams) -> list[Array]:
        """Return the inputs of a learned residual at the rows of each flight, in the band, (rows kept, 7) each."""
        return [felt for part in self._parts for felt in part.residual_inputs(params)]

    def load_links(self, params: ModelParams) -> list[LoadLink] | None:
        """Return the load's link along each flight from its initial state; None for a model without a load."""
        if not any(isinstance(EFFECTS.get(name), LoadEffect) for name in params.effects):
            return None
        return [link for part in self._parts for link in part.load_links(params)]

    def _vehicle_for_replay(self, params: ModelParams) -> VehicleForReplay:
        """Return the vehicle with a model's deviations; the last one is cached."""
        key = None if params.deviation is None else params.deviation.tobytes()
        if self._off is None or self._off[0] != key:
            self._off = key, vehicle_for_replay(self._declared, self.tolerances, params.deviation)
        return self._off[1]

    def _prediction_key(self, params: ModelParams) -> tuple[object, ...]:
        """Return a key of a model's predictions: the resulting vehicle, and all other parameters in order."""
        on_vehicle = {
            name: values for name, values in params.effects.items() if isinstance(EFFECTS.get(name), VehicleEffect)
        }
        remaining = {name: values for name, values in params.effects.items() if name not in on_vehicle}
        off = self._vehicle_for_replay(params)
        vehicle = build_model(off.vehicle, expand_effects(ModelParams(effects=on_vehicle), 1)).vehicle
        deviation = None if params.deviation is None else torch.from_numpy(params.deviation)
        logged = b"" if deviation is None else sensor_errors(self.tolerances, deviation).key
        numbers = [rows.numpy().tobytes() for rows in vehicle.tensors_by_name().values()]
        others_key = params_key(ModelParams(effects=remaining))
        loaded = any(isinstance(EFFECTS.get(name), LoadEffect) for name in remaining)
        hook = off.load_place.numpy().tobytes() if loaded else b""
        settings = (off.command_shift, off.command_gain, off.joint_start, hook)
        return (*numbers, logged, *settings, others_key, params.learned)
