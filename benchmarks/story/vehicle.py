"""The declared vehicle for the independent plant, and the undeclared effects of the true one."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import yaml

from benchmarks.undeclared import effects as hidden_effects
from benchmarks.undeclared.nuisance import Bias, PlantNuisance, add_nuisance
from benchmarks.undeclared.vehicle import PlantVehicle

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
