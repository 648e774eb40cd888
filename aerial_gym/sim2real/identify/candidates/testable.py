"""Identifiability of effects from a set of flights, and parameters at their bounds."""

from collections.abc import Sequence

import numpy as np

from aerial_gym.config.robot import RobotCfg
from aerial_gym.errors import ConfigError
from aerial_gym.physics import EFFECTS
from aerial_gym.physics.effects import AttitudeSensorEffect, Effect, ImuEffect, VehicleEffect, WindEffect
from aerial_gym.physics.effects.rotor_failures import nominal_lag
from aerial_gym.physics.model import check_effect_on_joints, check_effect_on_rotors
from aerial_gym.sim2real.arrays import Array
from aerial_gym.sim2real.findings import Finding
from aerial_gym.sim2real.logs.checks.rotors import interval_of_thrust_slope
from aerial_gym.sim2real.logs.flights import Flight
from aerial_gym.sim2real.logs.rotor_model import total_rotor_force
from aerial_gym.sim2real.predict.model_params import ModelParams
from aerial_gym.sim2real.predict.scene import finding_on_absent_data

LEAST_VARIATION = 0.01  # Least relative variation of the voltage that is distinguishable from a constant factor


def finding_on_untestable_effect(
    name: str, robot: RobotCfg, train: Sequence[Flight], test: Sequence[Flight] = ()
) -> Finding | None:
    """Return a finding on the reason why robot file or logs cannot show an effect; None if they can."""
    effect, flights = EFFECTS.get(name), [*train, *test]
    if isinstance(effect, ImuEffect | AttitudeSensorEffect) and not any(
        flight.accelerometer or flight.gyro for flight in train
    ):
        return Finding("no_inertial_sensor", name)
    of_one_rotor = any(parameter.kind == "rotor" for parameter in effect.parameters)
    by_forces = effect.shown_by_forces and all(flight.lin_vel is not None for flight in flights)  # else drag is unknown
    by_torques = effect.told_by_torques or (of_one_rotor and not by_forces)
    if by_torques and not all(flight.gyro for flight in flights):
        return Finding("torques_not_compared", name)
    needs = (*effect.logged, *effect.needs)
    if effect.told_by_rotor_speeds:
        needs += ("rotor_speed", "rotor_command")
    if isinstance(effect, WindEffect) or "velocity" in effect.follows:
        needs += ("lin_vel",)  # hub velocities alone would attribute other errors to the air
    reason = finding_on_absent_data(name, needs, flights) or finding_on_steady_voltage(effect, train)
    if (
        reason := reason
        or _finding_on_low_command_rate(effect, robot, train)
        or _finding_on_slope(effect, robot, train)
    ):
        return reason
    return finding_on_refused_effect(name, robot)


def finding_on_refused_effect(name: str, robot: RobotCfg) -> Finding | None:
    """Return a finding on the reason why a robot file cannot have an effect, whatever the logs; None if it can."""
    effect = EFFECTS.get(name)
    try:
        check_effect_on_rotors(effect, robot.rotor_traits)
        check_effect_on_joints(effect, bends=robot.joints is not None)
        effect.check(robot)
    except ConfigError as error:
        return Finding("effect_refused", name, {"error": str(error)})
    return None


def parameters_at_bounds(name: str, params: ModelParams, neutral: Array, robot: RobotCfg) -> list[str]:
    """Return the parameters of an effect at a bound other than neutral: its law fits only as far as it goes."""
    effect, reasons = EFFECTS.get(name), []
    rows = zip(effect.parameters, effect.bounds(robot), params.effects[name], neutral, strict=True)
    for parameter, bounds, value, start in rows:
        near = 1e-3 * parameter.scale
        ends = [bound for bound in bounds if abs(value - bound) <= near]
        if parameter.kind == "number" and ends and abs(start - ends[0]) > near:
            reasons.append(parameter.name)
    return reasons


def finding_on_steady_voltage(effect: Effect, flights: Sequence[Flight]) -> Finding | None:
    """Return a finding if the voltage of all flights varies too little to identify an effect; else None."""
    if "battery" not in effect.logged:
        return None
    voltage = np.concatenate([flight.battery for flight in flights if flight.battery is not None])
    low, middle, high = np.percentile(voltage, (2, 50, 98))
    if high - low >= LEAST_VARIATION * middle:
        return None
    return Finding("voltage_too_steady", effect.name, {"share": float((high - low) / middle)})


def _finding_on_low_command_rate(effect: Effect, robot: RobotCfg, flights: Sequence[Flight]) -> Finding | None:
    """Return a finding if commands are slower than the rotor lag, which would compensate for those between rows."""
    rates = [flight.rate for flight in flights if flight.rotor_command is not None]
    if not isinstance(effect, VehicleEffect) or effect.acts_on != "actuation" or not rates:
        return None
    row, lag = 1.0 / min(rates), min(nominal_lag(robot))
    values = {"row_ms": 1e3 * row, "lag_ms": 1e3 * lag}
    return None if row < lag else Finding("commands_too_coarse", effect.name, values)


def _finding_on_slope(effect: Effect, robot: RobotCfg, flights: Sequence[Flight]) -> Finding | None:
    """Return a finding if commands too slow for torques leave the slope of the thrust open in every flight.

    They miss what the rotors did between samples. So the slope of force on thrust is too small, and the inverse of that of
    thrust on force too large: only an interval of both that excludes the declared slope shows another curve. Commands also rise
    as a battery sags, so the slope is that at constant voltage.
    """
    if effect.name != "thrust_curve" or any(one.torques or one.rotor_speed is not None for one in flights):
        return None
    for one in flights:
        if one.rotor_command is not None and one.specific_force is not None:
            thrust = total_rotor_force(robot, one.rotor_command)
            low, high = interval_of_thrust_slope(one, thrust, one.on_ground, beside=one.battery)
            if not low <= 1.0 <= high:
                return None
    return Finding("thrust_slope_open", effect.name)
