"""Fly several references with one true vehicle in one batch, and record the sensor readings.

Letters: F flights, T samples (one per autopilot tick).
"""

from dataclasses import dataclass, fields
from typing import Protocol

import numpy as np

from benchmarks.undeclared.autopilot import Autopilot
from benchmarks.undeclared.dynamics import ROTOR, STATE_SIZE, orthonormalise, rest_state
from benchmarks.undeclared.full_dynamics import make_plant
from benchmarks.undeclared.sensors import PlantSensors, Sample
from benchmarks.undeclared.surroundings import NOMINAL_VOLTAGE, Battery, PlantSurroundings
from benchmarks.undeclared.trajectories import Reference
from benchmarks.undeclared.vehicle import Array, PlantVehicle

CONTROL_RATE = 400  # Rate of the autopilot, and the highest rate of a log [Hz]
SUBSTEPS = 5  # Runge-Kutta steps per autopilot tick: the plant runs at 2000 Hz


class PlantPilot(Protocol):
    """Interface of an autopilot or policy that flies the plant."""

    def command(self, sample: Sample, ref: Reference, index: int) -> Array:
        """Return the rotor speeds to hold until the next call [rad/s], (F, 4)."""
        ...


@dataclass(frozen=True, kw_only=True)
class PlantRecord:
    """Record of flights; the first axis is time."""

    measured: dict[str, Array]  # Fields of Sample by name, each (T, F, ...)
    command: Array  # Rotor speeds held from each instant on [rad/s], (T, F, 4)
    state: Array  # True states, as in dynamics.py, (T, F, 22), with more behind them as in full_dynamics.py
    position: Array  # True position of the body origin [m], world, (T, F, 3)
    voltage: Array  # True battery voltage [V], (T, F); the nominal one without a battery
    surroundings: PlantSurroundings  # As given to `fly`


def fly_references(
    *,
    true: PlantVehicle,
    declared: PlantVehicle,
    reference: Reference,
    sensors: PlantSensors,
    surroundings: PlantSurroundings | None = None,
    battery: Battery | None = None,
    pilot: PlantPilot | None = None,
    substeps: int | None = None,
) -> PlantRecord:
    """Return the record of all flights of ``reference``; the autopilot, if no pilot is given, is built from ``declared`` alone.

    ``substeps``: Runge-Kutta steps per autopilot tick, by default ``SUBSTEPS``. A delay of the true vehicle is rounded to whole
    steps of the plant; before the first command arrives it holds.
    """
    substeps = substeps or SUBSTEPS  # read at the call: tests set it
    num_samples, num_flights = reference.yaw.shape
    surroundings = surroundings or PlantSurroundings()
    plant, dt = make_plant(true, surroundings), 1.0 / CONTROL_RATE
    late = round(true.extra.delay * CONTROL_RATE * substeps)
    autopilot = pilot or Autopilot(declared, num_flights, dt)
    state = plant.states_at_rest(rest_state(declared, reference.position[0], reference.yaw[0]))
    samples: list[Sample] = []
    command = np.empty((num_samples, num_flights, 4))
    states = np.empty((num_samples, *state.shape))
    voltage = np.full((num_samples, num_flights), NOMINAL_VOLTAGE)
    for index in range(num_samples):
        if battery is not None:
            voltage[index] = battery.discharge(state[:, ROTOR], dt)
        plant.begin_sample(index, voltage[index])
        sample = sensors.sample(index, plant, state)
        samples.append(sample)
        states[index] = state
        command[index] = autopilot.command(sample, reference, index)
        for step in range(index * substeps, (index + 1) * substeps):
            state = plant.step(state, command[max(0, step - late) // substeps], dt / substeps)
        orthonormalise(state)
    measured = {f.name: np.stack([getattr(s, f.name) for s in samples]) for f in fields(Sample)}
    rows = states[:, :, :STATE_SIZE].reshape(-1, STATE_SIZE)
    position = plant.origin_position(rows).reshape(num_samples, num_flights, 3)
    return PlantRecord(
        measured=measured, command=command, state=states, position=position, voltage=voltage, surroundings=surroundings
    )


@dataclass(frozen=True, kw_only=True)
class Summary:
    """Tracking quality of one flight over its logged part."""

    rms_position_error: float  # Root mean square of the distance to the reference [m]
    top_speed: float  # [m/s]
    top_tilt: float  # [rad]
    saturated_share: float  # Share of rotor commands at a limit


def summarise(record: PlantRecord, reference: Reference, *, declared: PlantVehicle, first: int) -> list[Summary]:
    """Return one summary per flight, from sample ``first`` on."""
    low, high = declared.speed_range()
    error = np.linalg.norm(record.position - reference.position, axis=2)[first:]
    speed = np.linalg.norm(record.state[first:, :, 3:6], axis=2)
    tilt = np.arccos(np.clip(record.state[first:, :, 14], -1.0, 1.0))
    at_limit = (record.command[first:] <= low * 1.0001) | (record.command[first:] >= high * 0.9999)
    return [
        Summary(
            rms_position_error=float(np.sqrt((error[:, i] ** 2).mean())),
            top_speed=float(speed[:, i].max()),
            top_tilt=float(tilt[:, i].max()),
            saturated_share=float(at_limit[:, i].mean()),
        )
        for i in range(error.shape[1])
    ]
