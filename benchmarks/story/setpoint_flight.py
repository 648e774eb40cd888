"""Fly a policy that turns rotors from setpoint to setpoint, in the plant of ``benchmarks.undeclared``.

Letters: F flights, T ticks of the plant's 400 Hz, P setpoints of a flight.
"""

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import torch
import yaml

from aerial_gym.rl_training.policies.policy import Policy
from benchmarks.undeclared import effects as hidden_effects
from benchmarks.undeclared.sensors import Bias, PlantNoise, PlantNuisance, PlantSensors, Sample, add_nuisance
from benchmarks.undeclared.simulate import CONTROL_RATE, PlantRecord, fly_references
from benchmarks.undeclared.trajectories import Reference
from benchmarks.undeclared.vehicle import Array, PlantVehicle

POLICY_RATE = 100  # Decisions of the policy in a second, as in its training [Hz]
STAY_S = 4.0  # Time at a setpoint [s], the last second of which is judged
SETPOINTS = 5  # Of a flight, the start included
HEIGHT = 3.0  # Of the middle of the setpoints [m]
LOST_M = 1.5  # Distance at which an episode of the training ends [m]


def draw_setpoints(flights: int, *, seed: int) -> Array:
    """Return points in a cube of 1.2 m, each 0.5 to 1.1 m from the one before, (P, F, 3)."""
    rng = np.random.default_rng(seed)
    points = np.zeros((SETPOINTS, flights, 3))
    for flight in range(flights):
        for place in range(1, SETPOINTS):
            while True:
                point = rng.uniform(-0.6, 0.6, 3)
                if 0.5 <= np.linalg.norm(point - points[place - 1, flight]) <= 1.1:
                    break
            points[place, flight] = point
    return points + np.array([0.0, 0.0, HEIGHT])


class PolicyPilot:
    """Turns samples into speeds of rotors for F flights, as the training task turns observations into thrusts."""

    def __init__(self, policy: Policy, declared: PlantVehicle) -> None:
        self._policy, self._coeff = policy, declared.thrust_coeff
        self._low, self._high = declared.thrust_range
        self._command = np.zeros(0)
        policy.reset()

    def command(self, sample: Sample, ref: Reference, index: int) -> Array:
        """Return the rotor speeds to hold until the next call [rad/s], (F, 4)."""
        if index % (CONTROL_RATE // POLICY_RATE) == 0:
            rows = sample.rotation[:, :2, :].reshape(-1, 6)
            seen = np.concatenate((ref.position[index] - sample.position, rows, sample.velocity, sample.rate), axis=1)
            action = self._policy({"observations": torch.from_numpy(seen).float()}).double().numpy()
            thrust = self._low + 0.5 * (action + 1.0) * (self._high - self._low)
            self._command = np.sqrt(thrust / self._coeff)
        return self._command


def fly_setpoints(
    policy: Policy, *, declared: PlantVehicle, true: PlantVehicle, bias: Bias, points: Array, seed: int
) -> PlantRecord:
    """Return the record of F flights through points (P, F, 3), from rest at the first one."""
    places, flights = points.shape[:2]
    position = np.repeat(points, round(STAY_S * CONTROL_RATE), axis=0)
    ticks, still = places * round(STAY_S * CONTROL_RATE), np.zeros_like(position)
    flat = np.zeros((ticks, flights))
    reference = Reference(
        position=position,
        velocity=still,
        acceleration=still,
        jerk=still,
        yaw=flat,
        yaw_rate=flat,
        excite=np.zeros((ticks, flights, 4)),
    )
    streams = [np.random.default_rng([seed, flight]) for flight in range(flights)]
    sensors = PlantSensors(PlantNoise(), bias, streams, ticks)
    pilot = PolicyPilot(policy, declared)
    return fly_references(true=true, declared=declared, reference=reference, sensors=sensors, pilot=pilot)


@dataclass(frozen=True, kw_only=True)
class Tracking:
    """Tracking errors of some flights about their setpoints."""

    error_m: float  # Mean distance in the last second at a setpoint, of flights that are not lost [m]
    error_p95_m: float  # Its 95th percentile over flights and setpoints [m]
    lost: float  # Share of flights that were further than 1.5 m from their setpoint at a time


def tracking_errors(record: PlantRecord, points: Array) -> Tracking:
    """Return the tracking errors of a record's flights at the setpoints (P, F, 3), and the share of lost flights."""
    away = setpoint_distances(record, points)
    stay = round(STAY_S * CONTROL_RATE)
    judged = away.reshape(len(points), stay, -1)[:, -CONTROL_RATE:].mean(axis=1)
    lost = ~(away < LOST_M).all(axis=0)
    kept = judged[:, ~lost]
    error, high = (float(kept.mean()), float(np.quantile(kept, 0.95))) if kept.size else (float("nan"),) * 2
    return Tracking(error_m=error, error_p95_m=high, lost=float(lost.mean()))


def setpoint_distances(record: PlantRecord, points: Array) -> Array:
    """Return the distance of the body origin to its setpoint [m], (T, F)."""
    wanted = np.repeat(points, round(STAY_S * CONTROL_RATE), axis=0)
    return np.linalg.norm(record.position - wanted, axis=2)


HIDDEN = {"com_offset": {"x": 0.012, "y": -0.008}, "weak_motor": {"motor": 4.0, "scale": 0.92}}
"""What the file does not say: the centre of mass 14 mm beside the middle [m], and a rotor of 8 % less thrust."""


def nominal_vehicle(robot: Path) -> PlantVehicle:
    """Return the plant's numbers of a robot file with a square thrust map, one lag and no drag."""
    document = yaml.safe_load(robot.read_text(encoding="utf-8"))
    body, rotor, layout = document["body"], document["rotor"], document["mounts"]["layout"]
    *lower, coeff = rotor["thrust_map"]
    if any(lower) or document.get("effects"):
        raise ValueError(f"{robot}: has effects or a thrust map that is no square: {rotor['thrust_map']}")
    return PlantVehicle(
        mass=body["mass"],
        inertia=np.array(body["inertia"]),
        com=np.zeros(3),
        rotor_position=np.array([mount["position"] for mount in layout]),
        rotor_axis=np.tile([0.0, 0.0, 1.0], (len(layout), 1)),
        rotor_spin=np.array([float(mount["spin"]) for mount in layout]),
        thrust_coeff=np.full(len(layout), coeff),
        torque_ratio=rotor["torque_ratio"],
        tau_up=rotor["time_constant_up"],
        tau_down=rotor["time_constant_down"],
        thrust_range=tuple(rotor["thrust_range"]),
        linear_drag=np.zeros(3),
        quadratic_drag=np.zeros(3),
        wind_world=np.zeros(3),
    )


def true_vehicle(declared: PlantVehicle, *, seed: int) -> tuple[PlantVehicle, Bias]:
    """Return the true vehicle, with hidden effects and the small errors of a careful declaration, and its sensors' biases."""
    params = hidden_effects.effect_parameters(HIDDEN, declared=declared, seed=seed)
    _, true = hidden_effects.split_vehicles(declared, params)
    return add_nuisance(replace(true), PlantNuisance(), seed=seed, hidden=params)
