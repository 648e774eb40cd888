"""Fly a vehicle of the undeclared plant for the preflight checks: hover, climbs, yaw turn and rate steps, as one log.

A policy at the rate of its link sends body rates and a thrust; the firmware's rate loop follows them. The log has the commands
where they arrive. Nothing here imports the package. Letters: F flights, T samples, K commands.
"""

import json
from dataclasses import asdict, dataclass, replace
from math import ceil
from pathlib import Path

import numpy as np
import yaml

from benchmarks.preflight.faults import Fault, Link, draw_fault
from benchmarks.undeclared.autopilot import Autopilot
from benchmarks.undeclared.cases import SETTLE_S, PlantFlight, plan_flights
from benchmarks.undeclared.effects import effect_parameters, split_vehicles
from benchmarks.undeclared.loggers import burst_rows
from benchmarks.undeclared.logs import delay_samples, delay_sensors, log_table, robot_document
from benchmarks.undeclared.other_laws import gust_series_by_law
from benchmarks.undeclared.plant_effect import set_extra
from benchmarks.undeclared.sensors import LATE, LOGGED, PlantNoise, PlantSensors, Sample, add_nuisance
from benchmarks.undeclared.simulate import CONTROL_RATE, PlantRecord, fly_references
from benchmarks.undeclared.surroundings import NOMINAL_VOLTAGE, VOLTAGE_NOISE, Battery, PlantSurroundings
from benchmarks.undeclared.trajectories import Reference
from benchmarks.undeclared.vehicle import DECLARED, SOURCE, Array, PlantVehicle

FAMILIES = ("hover", "vertical", "yaw_turn", "rate_steps")
FLIGHT_S = 24.0  # Length of each part of the log [s]
SUBSTEPS = 2  # Runge-Kutta steps of 1.25 ms per tick: a thirtieth of the rotor lag
PAUSE_S = 4.0  # On the ground between parts, which the log leaves out [s]
LAWS = ("rotor_drag/thrust", "quadratic_drag/plate", "gusts/dryden", "gusts/weak_vertical")
"""Laws of the air that the package does not have; one for each vehicle in turn."""
LOST, STAMP_JITTER_S = 0.01, 0.00015  # Share of rows that the logger loses, in bursts; error of its stamps [s]
COMMANDS = ("sp_omega_x", "sp_omega_y", "sp_omega_z", "sp_specific_thrust")


class LinkPilot:
    """A policy that sends body rates and thrust over a link to a rate loop."""

    def __init__(self, declared: PlantVehicle, link: Link, num_samples: int, num_flights: int, seed: int) -> None:
        self._link, rng = link, np.random.default_rng([seed, 71])
        self._policy = Autopilot(declared, num_flights, 1.0 / link.rate)
        self._firmware = Autopilot(declared, num_flights, 1.0 / CONTROL_RATE)
        sent = np.arange(ceil(num_samples / CONTROL_RATE * link.rate)) / link.rate
        self._send = np.ceil(sent * CONTROL_RATE - 1e-9).astype(int)  # (K,)
        delay = np.sqrt(12.0) * link.jitter * rng.uniform(size=(len(sent), num_flights))
        arrival = np.ceil((sent[:, None] + delay) * CONTROL_RATE - 1e-9).astype(int)
        place = np.arange(len(sent))[:, None]  # a link keeps the order, and carries one command a tick
        self._arrival = np.maximum.accumulate(arrival - place, axis=0) + place  # (K, F)
        self.jitter = float(np.std(self._arrival / CONTROL_RATE - sent[:, None]))  # As flown [s]
        self.lost = rng.uniform(size=self._arrival.shape) < link.loss
        self._late = round(link.latency * CONTROL_RATE)
        self.arrived = np.full((num_samples, num_flights, 4), np.nan)  # Commands in the rows in which they arrive
        self._held = np.tile((0.0, 0.0, 0.0, 9.81), (num_flights, 1))
        self._next = 0

    def command(self, sample: Sample, ref: Reference, index: int) -> Array:
        """Return the rotor speeds to hold until the next call [rad/s], (F, 4)."""
        if self._next < len(self._send) and index >= self._send[self._next]:
            rate, along = self._policy.setpoints(sample, ref, index)
            for flight in np.flatnonzero(~self.lost[self._next]):
                row = max(index, self._arrival[self._next, flight])
                if row < len(self.arrived):
                    self.arrived[row, flight] = (*rate[flight], along[flight])
            self._next += 1
        if index >= self._late:
            news = self.arrived[index - self._late]
            self._held = np.where(np.isnan(news), self._held, news)
        return self._firmware.rotor_speeds(sample, self._link.rate_curve * self._held[:, :3], self._held[:, 3])


@dataclass(frozen=True, kw_only=True)
class VehicleFiles:
    """Files of one vehicle."""

    log: Path
    robot: Path
    truth: Path


def fly_vehicle(out: Path, kind: str, seed: int) -> VehicleFiles:
    """Fly a vehicle with a fault of a kind (empty: none), and write its log, its robot file and the truth."""
    fault, num_flights = draw_fault(kind, seed), len(FAMILIES)
    law = LAWS[seed % len(LAWS)]
    params = effect_parameters({law: "moderate"}, declared=DECLARED, seed=seed)
    declared, true = split_vehicles(DECLARED, params)
    true, bias = add_nuisance(fault.vehicle(true), LOGGED, seed=seed, hidden=params, num_flights=num_flights)
    true = set_extra(true, battery_gain=1.0)
    flights = [PlantFlight(f"part_{i + 1}", family, (3, i)) for i, family in enumerate(FAMILIES)]
    reference = plan_flights(flights, seed=seed, duration_s=FLIGHT_S)
    streams = [np.random.default_rng([seed, 13, i]) for i in range(num_flights)]
    sensors = PlantSensors(PlantNoise(), bias, streams, len(reference.yaw), extra=true.extra)
    surroundings, rng = PlantSurroundings(rate=CONTROL_RATE), np.random.default_rng([seed, 72])
    if true.extra.gust_law:
        gusts = [gust_series_by_law(true.extra.gust_law, len(reference.yaw), CONTROL_RATE, rng) for _ in flights]
        surroundings = replace(surroundings, gust=np.stack(gusts, axis=1))
    battery = Battery(true, rng.uniform(0.0, 300.0) + 300.0 * np.arange(num_flights))
    pilot = LinkPilot(declared, fault.link(), *reference.yaw.shape, seed)
    record = fly_references(
        true=true, declared=declared, reference=reference, sensors=sensors, surroundings=surroundings, battery=battery,
        pilot=pilot, substeps=SUBSTEPS,
    )  # fmt: skip
    record = delay_sensors(record, bias.delay)
    if kind == "state_latency":
        record = _late_state(record, fault.values["delay"])
    voltage = record.voltage + VOLTAGE_NOISE * rng.standard_normal(record.voltage.shape)
    out.mkdir(parents=True, exist_ok=True)
    files = VehicleFiles(log=out / "log.csv", robot=out / "robot.yaml", truth=out / "truth.json")
    _write_log(files.log, replace(record, voltage=voltage), pilot.arrived, fault, rng)
    document = fault.robot(_robot_document(declared))
    files.robot.write_text(yaml.safe_dump(document, sort_keys=False, default_flow_style=None, width=120))
    truth = {"seed": seed, "law": law, "kind": kind, "values": dict(fault.values), "link": asdict(fault.link())}
    ratio = (true.thrust_coeff.mean() / true.mass) / (declared.thrust_coeff.mean() / declared.mass)
    truth |= {"thrust_per_weight": float(ratio), "acc_scale": float(1.0 + bias.acc_scale[2]), "jitter_s": pilot.jitter}
    truth |= {"loss": float(pilot.lost.mean())}
    truth["delay_s"] = dict(zip(LATE, bias.delay.tolist(), strict=True))
    files.truth.write_text(json.dumps(truth, indent=1) + "\n")
    return files


def _late_state(record: PlantRecord, seconds: float) -> PlantRecord:
    """Return the record with position, velocity and attitude so late [s]."""
    late = {name: delay_samples(record.measured[name], seconds * CONTROL_RATE) for name in
            ("position", "velocity", "rotation")}  # fmt: skip
    return replace(record, measured=record.measured | late)


def _robot_document(declared: PlantVehicle) -> dict:
    """Return the robot file with the battery, and motors whose speeds follow its voltage."""
    document = robot_document(declared)
    document["effects"]["battery_sag"] = {"gain": 1.0}  # type: ignore[index]
    numbers = {"nominal_voltage": NOMINAL_VOLTAGE, "full_voltage": 16.7, "empty_voltage": 14.0}
    document["battery"] = numbers | {"internal_resistance": 0.03, "capacity": 4680.0, "source": SOURCE}
    return document


def _write_log(path: Path, record: PlantRecord, arrived: Array, fault: Fault, rng: np.random.Generator) -> None:
    """Write all flights into one file, without the rows that the logger loses."""
    first, tables, start = round(SETTLE_S * CONTROL_RATE), [], 0.0
    for flight in range(arrived.shape[1]):
        names, digits, values = log_table(record, flight, slice(first, None))
        values = np.hstack((values, arrived[first:, flight]))
        names, digits = [*names, *COMMANDS], [*digits, *["%.6f"] * len(COMMANDS)]
        fault.log(dict(zip(names, values.T, strict=True)))
        values[:, 0] += start + STAMP_JITTER_S * rng.standard_normal(len(values))
        start += FLIGHT_S + PAUSE_S
        tables.append(values[~burst_rows(len(values), LOST, rng)])
    np.savetxt(path, np.concatenate(tables), fmt=digits, delimiter=",", header=",".join(names), comments="")
