"""Identifiability of effects from a set of flights, and parameters at their bounds."""

from collections.abc import Sequence

from aerial_gym.config.robot import RobotCfg
from aerial_gym.errors import ConfigError
from aerial_gym.physics import EFFECTS
from aerial_gym.physics.effects import ImuEffect
from aerial_gym.physics.model import check_joints, check_rotors
from aerial_gym.sim2real.arrays import Array
from aerial_gym.sim2real.findings import Finding
from aerial_gym.sim2real.logs.flights import Flight
from aerial_gym.sim2real.predict.model_params import ModelParams
from aerial_gym.sim2real.predict.replay.rotor_commands import (
    finding_on_absent_quantity,
    finding_on_slow_commands,
    finding_on_steady_voltage,
)
from aerial_gym.sim2real.predict.scene import finding_on_absent_scene, finding_on_absent_velocity


def finding_on_untestable_effect(
    name: str, robot: RobotCfg, train: Sequence[Flight], test: Sequence[Flight] = ()
) -> Finding | None:
    """Return a finding on the reason why robot file or logs cannot show an effect; None if they can."""
    effect, flights = EFFECTS.get(name), [*train, *test]
    if isinstance(effect, ImuEffect) and not any(flight.accelerometer or flight.gyro for flight in train):
        return Finding("no_inertial_sensor", name)
    if effect.told_by_torques and not all(flight.gyro for flight in flights):
        return Finding("torques_not_compared", name)
    if (
        reason := finding_on_absent_quantity(effect, flights)
        or finding_on_absent_scene(name, flights)
        or finding_on_absent_velocity(name, flights)
    ):
        return reason
    if reason := finding_on_steady_voltage(effect, train) or finding_on_slow_commands(effect, robot, train):
        return reason
    try:
        check_rotors(effect, robot.rotor_traits)
        check_joints(effect, bends=robot.joints is not None)
        effect.check(robot)
    except ConfigError as error:
        return Finding("effect_refused", name, {"error": str(error)})
    return None


def parameters_at_bounds(name: str, params: ModelParams, neutral: Array, robot: RobotCfg) -> list[str]:
    """Return the parameters of an effect at a bound other than neutral, a sign of another cause."""
    effect, reasons = EFFECTS.get(name), []
    rows = zip(effect.parameters, effect.bounds(robot), params.effects[name], neutral, strict=True)
    for parameter, bounds, value, start in rows:
        near = 1e-3 * parameter.scale
        ends = [bound for bound in bounds if abs(value - bound) <= near]
        if parameter.kind == "number" and ends and abs(start - ends[0]) > near:
            reasons.append(parameter.name)
    return reasons
