"""Estimation of a battery from flights, for a robot file without one, sufficient to simulate its voltage sag.

Letters: F flights, B blocks of time of all flights.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import torch
from scipy.optimize import lsq_linear

from aerial_gym.config.robot import BatteryCfg, RobotCfg
from aerial_gym.physics import EFFECTS, build_model, vehicle_from_config
from aerial_gym.sim2real.arrays import Array, Flags
from aerial_gym.sim2real.identify.candidates.testable import finding_on_steady_voltage
from aerial_gym.sim2real.logs.flights import Flight
from aerial_gym.sim2real.logs.rotor_model import rotor_drag_torques
from aerial_gym.sim2real.predict.replay.rotors import RotorReplay
from aerial_gym.sim2real.predict.tolerances import are_scaled_by_thrust
from aerial_gym.sim2real.statistics import fit_line

BLOCK_S = 0.5  # Averaging time [s]
SURE = 1e-3  # Largest p-value of a significant slope of speed over voltage

SIGNIFICANT_DIGITS = 6

PASSES = 3  # Number of replays with the last sag estimate, so that speed and voltage means include the same lag
FARTHEST = 1.2  # Largest ratio of the nominal voltage to the range of measured voltages


def robot_with_estimated_battery(robot: RobotCfg, flights: Sequence[Flight]) -> RobotCfg:
    """Return the robot with a battery estimated from flights; unchanged if its file has one or the flights show none.

    Charge and load are fitted by ``V = E_f - k q - r I`` with ``I = P / V``, the rotors' mechanical power P, and the charge
    q since the start. Full voltage is the highest E, empty the lowest open-circuit voltage. Nominal is the voltage at which
    the fitted ratio of measured to replayed rotor speed is 1. Commands that the mean thrust scales reach their speed at the
    mean voltage. Otherwise, and without a significant slope, it is the highest measured voltage.
    """
    sag = EFFECTS.get("battery_sag")
    if robot.battery is not None or any(f.battery is None or f.rotor_command is None for f in flights):
        return robot
    if finding_on_steady_voltage(sag, flights):
        return robot
    nominal, how = _voltage_at_commanded_speed(robot, flights)
    numbers = {"nominal_voltage": nominal, **_fit_discharge(robot, flights)}
    source = f"estimated by aerial-gym close-loop from the flights {', '.join(flight.name for flight in flights)}"
    rounded = {name: float(f"{value:.{SIGNIFICANT_DIGITS}g}") for name, value in numbers.items()}
    return replace(robot, battery=BatteryCfg(**rounded, source=f"{source}; nominal voltage: {how}"))


def _airborne_blocks(flight: Flight) -> Flags:
    """Return the blocks without rows on the ground, (blocks,)."""
    stood = np.zeros(flight.num_rows) if flight.on_ground is None else flight.on_ground.astype(np.float64)
    return _block_means(stood, flight.rate)[:, 0] == 0.0


def _block_means(values: Array, rate: float) -> Array:
    """Return the means over complete time blocks, (blocks, any)."""
    length = max(1, round(BLOCK_S * rate))
    count = len(values) // length
    return values[: count * length].reshape(count, length, -1).mean(axis=1)


def _voltage(flight: Flight) -> Array:
    assert flight.battery is not None
    return flight.battery


def _fit_discharge(robot: RobotCfg, flights: Sequence[Flight]) -> dict[str, float]:
    """Return full and empty voltage, internal resistance and capacity, fitted to charge and load."""
    tables = []
    for number, flight in enumerate(flights):
        current = _rotor_power(robot, flight) / _voltage(flight)
        charge = np.cumsum(current) / flight.rate
        mean = _block_means(np.stack((_voltage(flight), charge, current), axis=1), flight.rate)
        tables.append((mean, np.full(len(mean), number)))
    mean, owner = (np.concatenate(part) for part in zip(*tables, strict=True))
    count = len(flights)
    columns = np.hstack((np.eye(count)[owner], -mean[:, 1:]))
    coefficients = lsq_linear(columns, mean[:, 0], bounds=(np.zeros(count + 2), np.full(count + 2, np.inf))).x
    start, slope, resistance = coefficients[:count], float(coefficients[count]), float(coefficients[count + 1])
    drawn = np.array([mean[owner == number, 1].max() for number in range(count)])
    full, empty = float(start.max()), float((start - slope * drawn).min())
    return {
        "full_voltage": full,
        "empty_voltage": empty,
        "internal_resistance": resistance,
        "capacity": (full - empty) / slope if slope > 0.0 else float(drawn.max()),
    }


def _rotor_power(robot: RobotCfg, flight: Flight) -> Array:
    """Return the mechanical rotor power [W], (T,), at measured or else commanded speeds."""
    rotor = flight.rotor_command if flight.rotor_speed is None else flight.rotor_speed
    assert rotor is not None
    return (rotor_drag_torques(robot, rotor) * rotor).sum(axis=1)


def _voltage_at_commanded_speed(robot: RobotCfg, flights: Sequence[Flight]) -> tuple[float, str]:
    """Return the voltage at which rotors reach the commanded speeds [V], and its source in words."""
    highest = max(float(_block_means(_voltage(flight), flight.rate).max()) for flight in flights)
    guess = highest, "the highest voltage seen"
    if are_scaled_by_thrust(flights):
        return float(
            np.mean([_voltage(flight).mean() for flight in flights])
        ), "mean, as the mean thrust scales the commands"
    if any(flight.rotor_speed is None for flight in flights):
        return guess
    gain, nominal = 0.0, highest
    for _ in range(PASSES):
        voltage, ratio = _voltage_and_speed_ratio(robot, flights, gain, nominal)
        slope, intercept, probability = fit_line(voltage, ratio * (1.0 - gain * (1.0 - voltage / nominal)))
        if not (slope > 0.0 and probability < SURE):
            return guess
        nominal = (1.0 - intercept) / slope
        gain = slope * nominal
        if not voltage.min() / FARTHEST < nominal < FARTHEST * voltage.max():
            return guess
    return nominal, "where rotors reach the commanded speeds"


def _voltage_and_speed_ratio(
    robot: RobotCfg, flights: Sequence[Flight], gain: float, nominal: float
) -> tuple[Array, Array]:
    """Return block means of voltage [V] and of measured over replayed rotor speed with a given sag, (B,) each."""
    vehicle = vehicle_from_config(robot, num_envs=1, dtype=torch.float64)
    vehicle = replace(vehicle, battery=torch.full_like(vehicle.battery, nominal))  # a sag needs no other number
    model = build_model(vehicle, [(EFFECTS.get("battery_sag"), torch.tensor([[gain]], dtype=torch.float64))])
    means = []
    for flight, speed in zip(flights, RotorReplay(flights).speeds(model, 0.0), strict=True):
        assert flight.rotor_speed is not None
        assert speed is not None
        sums = np.stack((_voltage(flight), flight.rotor_speed.sum(axis=1), speed.sum(axis=1)), axis=1)
        means.append(
            _block_means(sums, flight.rate)[_airborne_blocks(flight)][1:]
        )  # the first block starts at a noisy measured speed
    voltage, measured, replayed = np.concatenate(means).T
    return voltage, measured / replayed
