"""Expected and actual output of each rotor per time block, relative to hover: speeds, and the thrusts that the motion
requires.

*speed*: measured, against the commands with the declared lag. *thrust*: ``A⁺ w`` against ``A⁺ A T``, with the wrench w of
the measured motion, the allocation matrix A and declared thrusts T. The block torque is ``J (w(end) - w(start)) / length +
mean(w x J w)``. Frames: body is x forward, y left, z up. Letters: T rows, K blocks, R rotors, Q columns.
"""

from dataclasses import dataclass, replace

import numpy as np
import torch
from scipy.spatial.transform import Rotation

from aerial_gym.config.robot import RobotCfg
from aerial_gym.config.sim import STANDARD_GRAVITY
from aerial_gym.control.effectiveness import allocation_matrix, pseudo_inverse
from aerial_gym.physics.effects import RotorSensorEffect
from aerial_gym.physics.rotors import hover_speed, rotor_thrust
from aerial_gym.sim2real.arrays import Array, Flags
from aerial_gym.sim2real.logs.flights import Flight
from aerial_gym.sim2real.logs.rotor_model import mean_time_constant
from aerial_gym.sim2real.predict.replay.rotors import RotorReplay
from aerial_gym.sim2real.predict.rows.rotor_estimate import rotor_response_model

BLOCK_S = 0.1  # Length of a block [s], several motor time constants
FASTEST = 5.0  # Scale of the airspeed columns [m/s]: airspeed at which thrust may be wrong by its hover value


@dataclass(frozen=True, kw_only=True)
class RotorOutput:
    """One quantity of all rotors in every block, relative to hover."""

    quantity: str  # speed or thrust
    driven_by: str  # Source of the expectation: command or speed
    time: Array  # Start of each block [s], (K,)
    length: float  # Length of a block [s]
    lag: float  # Lag behind a change of the command [s]; 0 if speeds are the source
    done: Array  # Actual output, (K, R)
    expected: Array  # Expected output, (K, R)
    own: Array  # Part of the expectation that the rotor itself causes, (K, R)
    error_columns: Array  # Columns of possible errors of the expectation, (K, R, Q)

    def select_blocks(self, chosen: slice | Flags) -> "RotorOutput":
        """Return the selected blocks."""
        return replace(self, **{name: getattr(self, name)[chosen] for name in OF_BLOCKS})

    def append_blocks(self, other: "RotorOutput") -> "RotorOutput":
        """Return these blocks followed by those of a later part of the flight."""
        return replace(self, **{n: np.concatenate((getattr(self, n), getattr(other, n))) for n in OF_BLOCKS})


OF_BLOCKS = ("time", "done", "expected", "own", "error_columns")  # Fields of ``RotorOutput`` with one row per block


class RotorOutputModel:
    """Computes the rotor outputs of a declared robot along flights."""

    def __init__(self, robot: RobotCfg) -> None:
        self._model = rotor_response_model(robot)
        vehicle = self._model.vehicle
        made = allocation_matrix(vehicle, STANDARD_GRAVITY)[0]
        self._inverse = pseudo_inverse(made).numpy()
        self._share = self._inverse @ made.numpy()
        self._mass, self._inertia = float(vehicle.mass[0]), vehicle.inertia[0].numpy()
        self._hover = hover_speed(vehicle, STANDARD_GRAVITY).numpy()
        self._hover_thrust = rotor_thrust(vehicle, torch.from_numpy(self._hover)[None])[0].numpy()
        self._lag = mean_time_constant(robot)

    def outputs_of_flight(self, flight: Flight, *, volts: float | None = None) -> list[RotorOutput]:
        """Return the quantities of a flight's log in complete blocks; ``volts``: reference voltage [V], None: its mean."""
        size = max(1, round(BLOCK_S * flight.rate))
        count = (flight.num_rows - 1) // size
        if count < 1:
            return []
        led = RotorReplay([flight]).speeds(self._model, 0.0, self._model.effects[RotorSensorEffect])[0]
        works = list[RotorOutput]()
        if led is not None and flight.rotor_speed is not None:
            works.append(self._speed_output(flight, led, size, count, volts))
        state = led if flight.rotor_speed is None else flight.rotor_speed
        if state is not None and flight.gyro and flight.specific_force is not None:
            works.append(self._thrust_output(flight, flight.specific_force, state, size, count))
        excluded = flight.rows_without_comparison(0)
        if excluded is None:
            return works
        stands = excluded[: count * size].reshape(count, size).any(axis=1)
        return [work.select_blocks(~stands) for work in works]

    def _speed_output(self, flight: Flight, led: Array, size: int, count: int, about: float | None) -> RotorOutput:
        assert flight.rotor_speed is not None
        done, expected = (_block_means(rows / self._hover, size, count) for rows in (flight.rotor_speed, led))
        change = np.diff(led[::size][: count + 1], axis=0) / self._hover * self._lag / (size / flight.rate)
        columns = [expected, change]
        if flight.battery is not None:
            volts = _block_means(flight.battery[:, None], size, count)
            columns.append(expected * (volts / (about or volts.mean()) - 1.0))
        return RotorOutput(
            quantity="speed",
            driven_by="command",
            time=flight.time[: count * size : size],
            length=size / flight.rate,
            lag=self._lag,
            done=done,
            expected=expected,
            own=expected,
            error_columns=np.stack(columns, axis=-1),
        )

    def _thrust_output(self, flight: Flight, force: Array, state: Array, size: int, count: int) -> RotorOutput:
        length = size / flight.rate
        given = rotor_thrust(self._model.vehicle, torch.from_numpy(np.ascontiguousarray(state))).numpy()
        given = _block_means(given, size, count)
        edges, turning = flight.ang_vel[::size][: count + 1], flight.ang_vel
        torque = np.diff(edges, axis=0) / length @ self._inertia
        torque += _block_means(np.cross(turning, turning @ self._inertia), size, count)
        wrench = np.concatenate((self._mass * _block_means(force, size, count), torque), axis=1)
        expected, own = given @ self._share.T, given * np.diag(self._share)
        hover = self._hover_thrust
        whole = np.broadcast_to(given.sum(axis=1, keepdims=True), given.shape) / hover.sum()
        columns = [expected / hover, np.ones_like(expected), whole]
        if flight.lin_vel is not None:
            speed = Rotation.from_quat(flight.attitude).apply(flight.lin_vel, inverse=True)
            speed = _block_means(speed, size, count) / FASTEST
            columns += [np.broadcast_to(speed[:, k : k + 1], given.shape) for k in range(3)]
        measured = flight.rotor_speed is not None
        return RotorOutput(
            quantity="thrust",
            driven_by="speed" if measured else "command",
            time=flight.time[: count * size : size],
            length=length,
            lag=0.0 if measured else self._lag,
            done=wrench @ self._inverse.T / hover,
            expected=expected / hover,
            own=own / hover,
            error_columns=np.stack(columns, axis=-1),
        )


def _block_means(rows: Array, size: int, count: int) -> Array:
    """Return the trapezoidal mean over each block of rows (T, any), up to the next block's first row, (K, any)."""
    between = 0.5 * (rows[:-1] + rows[1:])
    return between[: count * size].reshape(count, size, -1).mean(axis=1)
