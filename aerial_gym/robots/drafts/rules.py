"""A robot from its parts: mass, arm, propeller, motor and battery, and rules of thumb for all other numbers.

Each number has its origin: ``given``, or ``assumed`` with the rule. D: diameter [m], n: speed [1/s], rho: density of air.
Sources, by the names in the file:
- Budinger: Budinger et al. 2020, Scaling laws for the preliminary design of multirotor drones (Aerospace Science and
  Technology 98), regressions of two-bladed propellers of APC: ``T = C_T rho n² D⁴``, ``P = C_P rho n³ D⁵``, mass by D².
- CTU: motor tests of the Multi-robot Systems group, CTU in Prague, eight propellers on three motors: at full command the speed
  is 0.60 to 0.81 of the motor's constant times the voltage, in the median 0.73.
- Quan: Quan 2017, Introduction to Multicopter Design and Control: hubs are 1.05 to 1.2 diameters apart.
- Shi: Shi et al. 2017, A Practical Performance Evaluation Method for Electric Multicopters: 10 mOhm for 3 cells of 5 A h.
"""

import re
from collections.abc import Sequence
from dataclasses import replace
from itertools import combinations
from math import dist, inf, pi, sqrt

import numpy as np

from aerial_gym.config.sim import STANDARD_GRAVITY
from aerial_gym.errors import ConfigError
from aerial_gym.robots.drafts.draft import Array, ValueWithOrigin, VehicleDraft, arm_by_mass, inertia_by_reach
from aerial_gym.robots.drafts.frames import frame_rotors

AIR_DENSITY = 1.225  # At sea level and 15 °C [kg/m³]
INCH = 0.0254  # [m]
LOADED = 0.73  # Speed at full command per speed without load (CTU)
CLEARANCE = 1.2  # Distance of neighbouring hubs per propeller diameter (Quan)
BLADE_MASS = 0.096  # Of one blade per squared diameter [kg/m²]: 15 g at 11 inches with two blades (Budinger)
CELL_VOLTAGE = 3.7  # Nominal, of a lithium-polymer cell [V]
ENERGY = 0.25 * 150.0 * 3600.0  # Of the battery per mass of the vehicle [J/kg]: a quarter of it, with 150 W h/kg
CELL_RESISTANCE = 0.01 / 3.0 * 5.0 * 3600.0  # Of a cell, times its capacity [Ohm A s] (Shi)
PROPELLER = re.compile(r"(\d*\.?\d+)(?:x(\d*\.?\d+))?(?:x([2-8]))?")
BATTERY = re.compile(r"([1-9]\d?)S(\d+)?", re.IGNORECASE)
APART = f"hubs {CLEARANCE:g} diameters apart (Quan)"
Values = dict[str, ValueWithOrigin]


def draft_robot(
    *, mass: float, arm: float | None = None, propeller: str | None = None, motor_kv: float | None = None,
    battery: str | None = None, max_thrust: float | None = None, frame: str = "quad_x",
) -> VehicleDraft:  # fmt: skip
    """Return all numbers of a robot; the arguments are the options of ``aerial-gym new robot``, by their units."""
    places, spins = frame_rotors(frame)
    spacing = min(dist(a, b) for a, b in combinations(places, 2))  # of neighbouring hubs, per arm
    numbers = {"--mass-kg": mass, "--arm-m": arm, "--motor-kv": motor_kv, "--max-thrust-n": max_thrust}
    wrong = {name: number for name, number in numbers.items() if number is not None and not 0.0 < number < inf}
    faults = [f"{name} {number:g}: must be > 0 and finite" for name, number in wrong.items()]
    inches, cells = PROPELLER.fullmatch(propeller or "1"), BATTERY.fullmatch(battery or "1S")
    if inches is None or not float(inches[1]) > 0.0:
        faults.append(
            f"--propeller {propeller}: must be diameter, pitch [inch] and blades, such as 5x4.3x3, or less of it"
        )
    if cells is None:
        faults.append(
            f"--battery {battery}: must be cells and capacity [mA h], such as 6S1300, or cells alone, such as 6S"
        )
    if spacing < 0.1:
        faults.append(f"--frame {frame}: has two rotors on one arm. Give a flat frame, and edit the mounts of the file")
    if faults or inches is None or cells is None:
        raise ConfigError(*faults)
    v = {"mass": _value_by_option(mass, "--mass-kg")} | _sizes(
        mass, arm, spacing, inches.groups() if propeller else (None,) * 3
    )
    volts, hover = CELL_VOLTAGE * int(cells[1]), mass * STANDARD_GRAVITY / len(spins)
    speed = LOADED * motor_kv * volts * 2.0 * pi / 60.0 if motor_kv is not None and battery is not None else None
    v |= _rotor(v, hover, speed, max_thrust) | _inertia(mass, places := places * v["arm"].value)
    if battery is not None:
        by_mass = _value_by_rule(ENERGY * mass / volts, "a quarter of the mass, with 150 W h/kg")
        v["voltage"] = _value_by_option(volts, f"--battery, {CELL_VOLTAGE:g} V per cell")
        v["capacity"] = _value_by_option(3.6 * float(cells[2]), "--battery") if cells[2] else by_mass
        ohms = int(cells[1]) * CELL_RESISTANCE / v["capacity"].value
        v["resistance"] = _value_by_rule(ohms, "17 mOhm A h per cell (Shi)")
    return VehicleDraft(values=v, places=places, spins=spins, layout_origin=f"frame {frame}")


def _value_by_option(value: float, option: str) -> ValueWithOrigin:
    return ValueWithOrigin(value=value, origin=f"given: {option}")


def _value_by_rule(value: float, rule: str) -> ValueWithOrigin:
    return ValueWithOrigin(value=float(f"{value:.5g}"), origin=f"assumed: {rule}")


def _sizes(mass: float, arm: float | None, spacing: float, inches: Sequence[str | None]) -> Values:
    """Return arm, propeller radius [m], pitch per diameter and blades; ``inches``: the texts of diameter, pitch and blades."""
    diameter, pitch, blades = (None if text is None else float(text) for text in inches)
    length = arm_by_mass(mass) if arm is None else _value_by_option(arm, "--arm-m")
    if diameter is None:
        radius = _value_by_rule(0.5 * length.value * spacing / CLEARANCE, APART)
    else:
        radius = _value_by_option(0.5 * diameter * INCH, "--propeller")
        length = _value_by_rule(CLEARANCE * diameter * INCH / spacing, APART) if arm is None else length
    ratio = (
        _value_by_rule(0.45, "as of 10x4.5 inches")
        if not pitch or not diameter
        else _value_by_option(pitch / diameter, "--propeller")
    )
    number = _value_by_rule(2.0, "the usual number") if blades is None else _value_by_option(blades, "--propeller")
    return {"arm": length, "radius": radius, "pitch_ratio": ratio, "blades": number}


def _rotor(v: Values, hover: float, speed: float | None, max_thrust: float | None) -> Values:
    """Return thrust per squared speed, torque ratio, thrust at full command and lag; ``speed`` [rad/s] at full command.

    Momentum theory: power is thrust to the power of 1.5. Blade elements: thrust grows less than the number of blades.
    Lag: ``J dw/dt = K (u - w) - c w²`` about hover. K follows from full command, at which ``w = LOADED u``.
    """
    diameter, pitch, more = 2.0 * v["radius"].value, v["pitch_ratio"].value, v["blades"].value / 2.0
    c_t, c_p = (0.0427 + 0.144 * pitch) * more**0.6, max(-0.00148 + 0.0972 * pitch, 0.005) * more**0.9
    thrust, ratio = c_t * AIR_DENSITY * diameter**4 / (2.0 * pi) ** 2, c_p / c_t * diameter / (2.0 * pi)
    most = _value_by_rule(2.0 * hover, "twice the weight; give --motor-kv and --battery, or --max-thrust-n")
    if speed is not None:
        most = _value_by_rule(thrust * speed**2, f"at {LOADED:g} times motor and battery (CTU), +- 30 %")
    if max_thrust is not None:
        most = _value_by_option(max_thrust, "--max-thrust-n")
    if most.value <= hover:
        raise ConfigError(
            f"each rotor gives {most.value:.3g} N at most, and carries {hover:.3g} N at hover: check --mass-kg, --propeller, "
            "--motor-kv, --battery and --max-thrust-n"
        )
    damping = ratio * (sqrt(thrust * most.value) * LOADED / (1.0 - LOADED) + 2.0 * sqrt(thrust * hover))
    rod = (
        BLADE_MASS * v["blades"].value * diameter**4 / 12.0
    )  # [kg m²]; the excess over a blade is for the motor's bell
    return {
        "thrust": _value_by_rule(thrust, "pitch, blades and diameter (Budinger), +- 40 %"),
        "torque_ratio": _value_by_rule(ratio, "power per thrust and speed (Budinger), +- 30 %"),
        "largest_thrust": most,
        "lag": _value_by_rule(rod / damping, "DC motor about hover, propeller as a rod (Budinger, CTU), +- 50 %"),
    }


def _inertia(mass: float, places: Array) -> Values:
    """Return the moments about x, y and z of a flat body."""
    about = [inertia_by_reach(mass, float(np.sqrt((places[:, axis] ** 2).mean()))) for axis in (1, 0)]
    x, y = (replace(each, value=float(f"{each.value:.5g}")) for each in about)
    flat = ValueWithOrigin(value=x.value + y.value, origin="assumed: flat body, x + y")  # no body has more
    return {"inertia_x": x, "inertia_y": y, "inertia_z": flat}
