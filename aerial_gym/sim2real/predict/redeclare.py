"""Robot files whose declared values are replaced by those that flights ask for, beyond the tolerances.

Letters: R rotors, N tolerances.
"""

from dataclasses import replace

import numpy as np
import torch
from scipy import special

from aerial_gym.config.robot import RobotCfg, Vec3
from aerial_gym.config.rotor import RotorCfg
from aerial_gym.physics.effects.vehicle_errors import add_products
from aerial_gym.sim2real.arrays import Array
from aerial_gym.sim2real.predict.tolerances import STRAINED, Tolerances, split_deviations

OF_VEHICLE = ("mass", "thrust", "inertia", "products", "com", "imu_place", "time_constant", "nominal_voltage")
"""Tolerances of values in a robot file; all others are of the log or its other sensor errors."""

BESIDE_VEHICLE = ("velocity_place",)  # Of the log, but kinematics show only its difference from ``imu_place``
PLACES = ("com", "imu_place")  # Vectors whose direction is arbitrary
SIGNIFICANT_DIGITS = 6  # Significant digits of new values


def deviation_of_vehicle(deviation: Array, robot: RobotCfg) -> Array:
    """Return the deviations (N,) with those at zero that no robot file can have: of the log, its sensors, given thrusts.

    The point of the logged velocity stays, else an accelerometer in its right place would seem to contradict that velocity.
    """
    parts, none = split_deviations(torch.from_numpy(deviation)), {"force": "thrust"}
    absent = {none.get(trait) for trait in robot.rotor_traits}
    names = [name for name in (*OF_VEHICLE, *BESIDE_VEHICLE) if name not in absent]
    return torch.cat([part if name in names else torch.zeros_like(part) for name, part in parts.items()]).numpy()


def deviations_beyond_tolerance(tolerances: Tolerances, deviation: Array, robot: RobotCfg) -> dict[str, float]:
    """Return the deviations of the vehicle beyond ``STRAINED`` standard deviations, by name of the tolerance.

    All components of a place count if it is as improbable: the sum of their squares is chi-squared, as axes are arbitrary.
    """
    off, names = deviation_of_vehicle(deviation, robot), tolerances.names(robot.num_rotors)
    limit = float(special.chdtri(3, special.chdtrc(1, STRAINED**2)))
    parts = split_deviations(torch.from_numpy(off))
    far = {f"{name}_{axis}" for name in PLACES for axis in "xyz" if float(parts[name] @ parts[name]) > limit}
    logged = {f"{name}_{axis}" for name in BESIDE_VEHICLE for axis in "xyz"}
    sizes = {name: size for name, size in zip(names, off.tolist(), strict=True) if name not in logged}
    return {name: size for name, size in sizes.items() if abs(size) > STRAINED or name in far}


def redeclare(robot: RobotCfg, tolerances: Tolerances, deviation: Array, source: str) -> RobotCfg:
    """Return the robot whose simulation is that of ``vehicle_with_deviations``; ``source`` of the new values.

    If thrusts differ, each mount gets a rotor type of its own.
    """
    off = {name: part.numpy() for name, part in split_deviations(torch.from_numpy(deviation)).items()}
    body, slower = robot.body, 1.0 + tolerances.time_constant * float(off["time_constant"][0])
    stretch = np.sqrt(np.maximum(1.0 + tolerances.inertia * off["inertia"], 0.01))
    moments = torch.from_numpy(stretch[:, None] * np.array(body.inertia, dtype=np.float64) * stretch)[None]
    products = torch.from_numpy(tolerances.products * off["products"])[None]
    inertia = _limit_principal_moments(add_products(moments, products)[0].numpy())
    body = replace(
        body, mass=_round_value(body.mass * (1.0 + tolerances.mass * float(off["mass"][0]))),
        inertia=tuple(tuple(_round_value(value) for value in row) for row in inertia.tolist()),
        com=_shift_place(body.com, tolerances.com * off["com"]),
        accelerometer=_shift_place(body.accelerometer, tolerances.imu_place * off["imu_place"]),
        source=f"{body.source}; {source}",
    )  # fmt: skip
    factors = (1.0 + tolerances.thrust * off["thrust"]).tolist()
    types = [
        _scale_rotor(rotor, factor, slower, source) for rotor, factor in zip(robot.rotor_types, factors, strict=True)
    ]
    battery = robot.battery
    if battery is not None:
        nominal = battery.nominal_voltage * (1.0 + tolerances.nominal_voltage * float(off["nominal_voltage"][0]))
        battery = replace(battery, nominal_voltage=_round_value(nominal))
    if robot.rotor is not None and all(other == types[0] for other in types):
        return replace(robot, body=body, rotor=types[0], battery=battery)
    names = [f"rotor_{number}" for number in range(1, len(types) + 1)]
    layout = tuple(replace(mount, rotor=name) for mount, name in zip(robot.mounts.layout, names, strict=True))
    rotors = dict(zip(names, types, strict=True))
    return replace(
        robot, body=body, battery=battery, rotor=None, rotors=rotors, mounts=replace(robot.mounts, layout=layout)
    )


def _limit_principal_moments(inertia: Array) -> Array:
    """Return an inertia (3, 3) whose largest principal moment is at most the sum of the others, as that of any body."""
    moments, axes = np.linalg.eigh(inertia)
    excess = moments[2] - (moments[0] + moments[1]) * (1.0 - 10.0 ** (1 - SIGNIFICANT_DIGITS))
    return inertia - max(float(excess), 0.0) * np.outer(axes[:, 2], axes[:, 2])


def _scale_rotor(rotor: RotorCfg, factor: float, slower: float, source: str) -> RotorCfg:
    """Return a rotor type with thrust and drag torque times ``factor`` and time constants times ``slower``."""
    maps = {
        name: tuple(_round_value(factor * value) for value in values)
        for name in ("thrust_map", "torque_map", "reverse_thrust_map", "reverse_torque_map", "thrust_range")
        if (values := getattr(rotor, name)) is not None
    }
    times = {name: _round_value(slower * getattr(rotor, name)) for name in ("time_constant_up", "time_constant_down")}
    return replace(rotor, **maps, **times, source=f"{rotor.source}; {source}")


def _shift_place(place: Vec3, way: Array) -> Vec3:
    x, y, z = (_round_value(value) for value in (np.array(place) + way).tolist())
    return x, y, z


def _round_value(value: float) -> float:
    return float(f"{value:.{SIGNIFICANT_DIGITS}g}")
