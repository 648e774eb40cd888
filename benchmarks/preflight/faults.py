"""The faults of the benchmark: kinds, sizes, and their place: the flown vehicle, its robot file, its link, or its log.

Nothing here imports the package. Rotors are counted from 1 on.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from benchmarks.undeclared.plant_effect import set_extra
from benchmarks.undeclared.vehicle import PlantVehicle

POLICY_HZ = 100.0  # Rate of the commands in training [Hz]
SOUND_JITTER_S = 0.0005  # Standard deviation of the delay of commands on a sound link [s]

Draw = Callable[[np.random.Generator], dict[str, float]]


@dataclass(frozen=True, kw_only=True)
class Link:
    """Link that carries the commands of a policy to the vehicle, and the firmware that takes them."""

    rate: float = POLICY_HZ  # Commands sent per second [Hz]
    jitter: float = SOUND_JITTER_S  # Standard deviation of the delay of a command, which is uniform [s]
    loss: float = 0.0  # Share of commands that never arrive
    latency: float = 0.0  # Time between the stamp of a command in the log and its use [s]
    rate_curve: float = 1.0  # Flown per commanded body rate


@dataclass(frozen=True, kw_only=True)
class Fault:
    """One fault with its numbers; ``kind`` is empty for a vehicle without one."""

    kind: str = ""
    values: Mapping[str, float] = field(default_factory=dict)

    def vehicle(self, vehicle: PlantVehicle) -> PlantVehicle:
        """Return the vehicle that flies."""
        return VEHICLES[self.kind](vehicle, self.values) if self.kind in VEHICLES else vehicle

    def link(self) -> Link:
        """Return the link of the flights."""
        names = {"rate_curve": "scale", "command_latency": "delay"}
        if self.kind in names:
            name = {"command_latency": "latency"}.get(self.kind, self.kind)
            return replace(Link(), **{name: self.values[names[self.kind]]})
        return replace(Link(), **self.values) if self.kind in ("link", "packet_loss") else Link()

    def robot(self, document: dict[str, Any]) -> dict[str, Any]:
        """Return the robot file."""
        if self.kind == "nominal_voltage":
            document["battery"]["nominal_voltage"] *= self.values["scale"]
        layout = document["mounts"]["layout"]
        if self.kind == "rotor_order":
            a, b = (int(self.values[name]) - 1 for name in ("first", "second"))
            layout[a], layout[b] = layout[b], layout[a]
        if self.kind in ("spins_reversed", "spin_of_one"):
            rotors = range(1, 5) if self.kind == "spins_reversed" else (int(self.values["rotor"]),)
            for rotor in rotors:
                layout[rotor - 1]["spin"] *= -1
        return document

    def log(self, columns: dict[str, np.ndarray]) -> None:
        """Change the columns of the log in place."""
        axis = "xyz"[int(self.values.get("axis", 0))]
        if self.kind == "gyro_scale":
            columns[f"omega_{axis}"] *= self.values["scale"]
        if self.kind == "gyro_sign":
            columns[f"omega_{axis}"] *= -1.0
        if self.kind == "acc_scale":
            for name in "xyz":
                columns[f"acc_{name}"] *= self.values["scale"]
        if self.kind == "voltage_reading":
            columns["vbat"] += self.values["offset"]


def _of_sign(rng: np.random.Generator) -> float:
    return float(rng.choice((-1.0, 1.0)))


def _of_axis(rng: np.random.Generator) -> float:
    return float(rng.integers(3))


def _of_pair(rng: np.random.Generator) -> dict[str, float]:
    first, second = sorted(rng.choice(4, 2, replace=False).tolist())
    return {"first": first + 1.0, "second": second + 1.0}


DRAWS: dict[str, Draw] = {
    "gyro_scale": lambda rng: {"axis": _of_axis(rng), "scale": 1.0 + 0.03 * _of_sign(rng)},
    "gyro_sign": lambda rng: {"axis": _of_axis(rng)},
    "acc_scale": lambda rng: {"scale": 1.0 + 0.03 * _of_sign(rng)},
    "rotor_order": _of_pair,
    "spins_reversed": lambda _: {},
    "spin_of_one": lambda rng: {"rotor": rng.integers(1, 5) * 1.0},
    "thrust": lambda rng: {"scale": 1.0 + 0.1 * _of_sign(rng)},
    "thrust_curve": lambda rng: {"k": 0.2 * _of_sign(rng)},
    "rate_curve": lambda rng: {"scale": 1.0 + 0.15 * _of_sign(rng)},
    "command_latency": lambda rng: {"delay": float(rng.choice((0.02, 0.05)))},
    "motor_latency": lambda _: {"delay": 0.02},
    "state_latency": lambda _: {"delay": 0.04},
    "link": lambda _: {"rate": 40.0, "jitter": 0.01},
    "packet_loss": lambda _: {"loss": 0.05},
    "mass": lambda rng: {"scale": 1.0 + 0.08 * _of_sign(rng)},
    "nominal_voltage": lambda rng: {"scale": 1.0 + 0.1 * _of_sign(rng)},
    "voltage_reading": lambda rng: {"offset": 0.05 * _of_sign(rng)},
    "torque_ratio": lambda rng: {"scale": 1.0 + 0.25 * _of_sign(rng)},
}
"""Values of each kind."""

VEHICLES: dict[str, Callable[[PlantVehicle, Mapping[str, float]], PlantVehicle]] = {
    "thrust": lambda v, p: replace(v, thrust_coeff=p["scale"] * v.thrust_coeff),
    "thrust_curve": lambda v, p: set_extra(v, thrust_curve=p["k"]),
    "motor_latency": lambda v, p: set_extra(v, delay=p["delay"]),
    "mass": lambda v, p: replace(v, mass=p["scale"] * v.mass),
    "torque_ratio": lambda v, p: replace(v, torque_ratio=p["scale"] * v.torque_ratio),
}
"""Vehicles with a fault of a kind."""


def draw_fault(kind: str, seed: int) -> Fault:
    """Return a fault of a kind, or none for an empty kind."""
    rng = np.random.default_rng([seed, 70])
    return Fault(kind=kind, values=DRAWS[kind](rng)) if kind else Fault()
