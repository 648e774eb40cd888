"""Order, spins, thrust, drag torque, lag and voltage of the rotors, by the estimators of ``robot from-log``.

Letters: T rows, R rotors.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from aerial_gym.config.robot import RobotCfg
from aerial_gym.sim2real.arrays import Array
from aerial_gym.sim2real.findings import Finding
from aerial_gym.sim2real.logs.clock_offset import with_rotors_on_sensor_clock
from aerial_gym.sim2real.logs.recording import FlightLog, sample_rate, take_rows
from aerial_gym.sim2real.logs.rotor_model import (
    LineBehindLag,
    fit_line_behind_lag,
    mean_time_constant,
    rotor_drag_torques,
    rotor_thrusts,
    simulate_lag,
)
from aerial_gym.sim2real.logs.signals import IN_BAND, lowpass
from aerial_gym.sim2real.predict.tolerances import are_scaled_by_thrust
from aerial_gym.sim2real.preflight.constants import CONTRADICTED, Constant
from aerial_gym.sim2real.statistics import Estimate, student_quantile
from aerial_gym.sim2real.teststand.command_curve import fit_thrust_power
from aerial_gym.sim2real.teststand.effectiveness import (
    FEWEST_FLIGHTS,
    Effectiveness,
    FlightRows,
    fit_effectiveness,
    mean_force_per_input,
    rows_of_flight,
)
from aerial_gym.sim2real.teststand.log_geometry import layout_of_robot
from aerial_gym.sim2real.teststand.vehicle_from_log import flights_in_air, quotient_by_estimate, scale_estimate

AXES = ("roll", "pitch", "yaw")
ROWS_HZ = 125.0  # Rows of the regressions, whose band ends at 20 Hz
CLOCK_HZ = 10.0  # Band in which forces show the clock of the rotor columns, as in ``close_loop``
LARGEST_READING_ERROR = (
    0.02  # Relative error of a logged voltage: dividers of 1 % resistors; a nominal voltage is chosen
)


@dataclass(frozen=True, kw_only=True)
class RotorStage:
    """Constants and findings on the rotors, and the robot with the order and spins that the log shows."""

    robot: RobotCfg
    constants: tuple[Constant, ...]
    findings: tuple[Finding, ...]


def check_rotors(logs: Sequence[FlightLog], robot: RobotCfg) -> RotorStage:
    """Return the constants of the rotors by logs with correct sensors."""
    logs = with_rotors_on_sensor_clock(logs, robot, CLOCK_HZ, len(logs))
    lag_and_gain, scaled_commands = _lag_and_gain(logs, robot), are_scaled_by_thrust(logs)
    fast, has_speeds = (
        all(each) for each in zip(*((log.torques, log.rotor_speed is not None) for log in logs), strict=True)
    )
    logs = [_with_fewer_rows(replace(log, rotor_speed=_rotor_speeds(log, robot))) for log in logs]
    flights = [rows_of_flight(log, lambda log: rotor_thrusts(robot, _speed(log))) for log in logs]
    flights = flights_in_air(logs[0].path, flights)
    robot, findings = _with_layout_of_log(flights, robot) if fast else (robot, [Finding("rotor_layout_assumed")])
    hover = np.concatenate([_speed(log) for log in logs]).mean(axis=0)
    thrust = _thrust_per_weight(flights, robot, has_speeds=has_speeds)
    effect = fit_effectiveness(flights, layout_of_robot(robot).weights) if fast else None
    turning = _inertia_and_torque(effect, robot, thrust, hover)
    forces = [thrust, _thrust_exponent(logs, robot, hover)]
    if scaled_commands:
        forces, turning = (
            [replace(one, estimate=None, reason="commands_scaled") for one in part] for part in (forces, turning)
        )
    constants = (*forces, *turning, *lag_and_gain)
    return RotorStage(robot=robot, constants=constants, findings=tuple(findings))


def _speed(log: FlightLog) -> Array:
    assert log.rotor_speed is not None
    return log.rotor_speed


def _with_fewer_rows(log: FlightLog) -> FlightLog:
    """Return the log with about ``ROWS_HZ`` rows a second, without higher frequencies."""
    rate = sample_rate(log)
    step = max(1, int(rate / ROWS_HZ))
    if step == 1:
        return log
    slow = {
        name: lowpass(values, rate, 0.4 * rate / step) for name in IN_BAND if (values := getattr(log, name)) is not None
    }
    return take_rows(replace(log, **slow), slice(None, None, step))


def _rotor_speeds(log: FlightLog, robot: RobotCfg) -> Array:
    """Return the measured speeds, or the commands behind the declared voltage and lag, (T, R)."""
    if log.rotor_speed is not None:
        return log.rotor_speed
    assert log.rotor_command is not None
    return simulate_lag(robot, _command_at_voltage(log, robot), sample_rate(log))


def effect_parameter(robot: RobotCfg, effect: str, parameter: str, neutral: float) -> float:
    """Return a parameter of an effect of the robot file; the neutral value without the effect."""
    return float(robot.effects.get(effect, {}).get(parameter, neutral))


def _command_at_voltage(log: FlightLog, robot: RobotCfg) -> Array:
    """Return the speeds that the file expects of the commands at the logged voltage [rad/s], (T, R)."""
    assert log.rotor_command is not None
    factor = _speed_factor(log, robot)
    return log.rotor_command if factor is None else log.rotor_command * factor[:, None]


def _speed_factor(log: FlightLog, robot: RobotCfg) -> Array | None:
    """Return the reached per commanded speed by the voltage, (T,); None if the file declares no sag."""
    gain = effect_parameter(robot, "battery_sag", "gain", 0.0)
    if gain == 0.0 or log.battery is None or robot.battery is None:
        return None
    return 1.0 - gain * (1.0 - log.battery / robot.battery.nominal_voltage)


def _with_layout_of_log(flights: Sequence[FlightRows], robot: RobotCfg) -> tuple[RobotCfg, list[Finding]]:
    """Return the robot with the mounts and spins that the flights show, and findings on the differences."""
    declared = layout_of_robot(robot).weights
    shown = fit_effectiveness(flights, None)
    every_sign = (np.abs(shown.weights) == 1.0).all()  # of each rotor about each axis
    if declared is None or not every_sign or not (declared != 0.0).all():
        return robot, [Finding("rotor_layout_assumed")]
    signs, own = np.sign(shown.weights), np.sign(declared)
    places = [[j for j in range(robot.num_rotors) if (own[:2, j] == signs[:2, i]).all()] for i in range(signs.shape[1])]
    if any(len(each) != 1 for each in places) or len({each[0] for each in places}) < robot.num_rotors:
        return robot, [Finding("rotor_layout_assumed")]
    order, findings = [each[0] for each in places], list[Finding]()
    layout = [robot.mounts.layout[j] for j in order]
    moved = [i + 1 for i, j in enumerate(order) if i != j]
    if moved:
        findings.append(Finding("rotor_order_contradicted", "", {"rotors": moved, "order": [j + 1 for j in order]}))
    turned = [i for i, j in enumerate(order) if own[2, j] != signs[2, i]]
    layout = [replace(one, spin=-one.spin) if i in turned else one for i, one in enumerate(layout)]
    if turned:
        every = len(turned) == robot.num_rotors
        findings.append(Finding("spins_contradicted", "", {"rotors": [i + 1 for i in turned], "all": every}))
    robot = replace(robot, mounts=replace(robot.mounts, layout=tuple(layout)))
    return robot, findings or [Finding("rotor_layout_measured")]


def _thrust_per_weight(flights: Sequence[FlightRows], robot: RobotCfg, *, has_speeds: bool) -> Constant:
    """Return the thrust of the log over that of the file, for the declared mass; speeds may follow from commands."""
    ratio = scale_estimate(mean_force_per_input(flights).mean, robot.body.mass)
    scale = effect_parameter(robot, "thrust_coefficient", "scale", 1.0)
    return Constant(
        name="thrust_per_weight", kind="thrust_per_weight", declared=scale, estimate=ratio,
        setting="effects.thrust_coefficient.scale", new=ratio.value, remedy="weigh",
        tied=("mass",) if has_speeds else ("mass", "speed_per_command"),
    )  # fmt: skip


def _thrust_exponent(logs: Sequence[FlightLog], robot: RobotCfg, hover: Array) -> Constant:
    """Return the exponent of the rotor speed in the thrust at hover."""
    ends = [float(rotor_thrusts(robot, factor * hover[None]).sum()) for factor in (0.999, 1.001)]
    slope = float(np.log(ends[1] / ends[0]) / np.log(1.001 / 0.999))
    declared = slope + effect_parameter(robot, "thrust_curve", "k", 0.0)
    fit = fit_thrust_power([replace(log, rotor_command=log.rotor_speed) for log in logs])
    power = None if fit is None else fit[0]
    return Constant(
        name="thrust_exponent", kind="thrust_exponent", declared=declared, estimate=power, reason="little_thrust",
        setting="effects.thrust_curve.k", new=None if power is None else power.value - slope,
    )  # fmt: skip


def _inertia_and_torque(
    effect: Effectiveness | None, robot: RobotCfg, thrust: Constant, hover: Array
) -> list[Constant]:
    """Return moments of inertia about roll and pitch, and the torque ratio, for declared arms.

    A wrong thrust scales all three, a wrong mass none. A value that one of both explains is no contradiction.
    """
    mounts, moments = robot.mounts.layout, np.diag(np.array(robot.body.inertia))
    drag, lift = (float(law(robot, hover[None]).mean()) for law in (rotor_drag_torques, rotor_thrusts))
    reach = np.abs(np.cross([one.position for one in mounts], [one.axis for one in mounts])).max(axis=0)
    levers = (float(reach[0]), float(reach[1]), drag / lift)
    causes = [1.0, thrust.estimate.value] if thrust.estimate and thrust.state == CONTRADICTED else [1.0]
    constants = []
    for axis, (lever, moment) in enumerate(zip(levers, moments, strict=True)):
        turn = axis == 2
        kind, declared = ("torque_ratio", lever) if turn else ("inertia", float(moment))
        estimate = None
        if effect is not None and effect.known[axis] and effect.sizes[axis].low > 0.0:
            size = effect.sizes[axis]  # angular acceleration per thrust of the file
            cause = min(causes, key=lambda one, ratio=size.value * moment / lever: abs(np.log(ratio / one)))
            estimate = scale_estimate(size, moment / cause) if turn else quotient_by_estimate(size, lever * cause)
        constants.append(Constant(
            name="torque_ratio" if turn else f"inertia_{AXES[axis]}", kind=kind, declared=declared,
            unit="m" if turn else "kg m²", estimate=estimate,
            reason="slow_commands" if effect is None else "little_turning",
            setting="rotor.torque_ratio" if turn else f"body.inertia[{axis}][{axis}]",
            new=None if estimate is None else estimate.value, tied=("inertia_yaw",) if turn else ("arms",),
            remedy="swing_test",
        ))  # fmt: skip
    return constants


def _lag_and_gain(logs: Sequence[FlightLog], robot: RobotCfg) -> list[Constant]:
    """Return lag and dead time of the speed behind the command, and the reached per commanded speed."""
    known = [log for log in logs if log.rotor_command is not None and log.rotor_speed is not None]
    if len(known) < FEWEST_FLIGHTS:
        known = [part for log in known for part in _parts(log)]
    lines = [_line_of_commands(log, robot) for log in known]
    own = [log for log in known if all(note.code != "relative_commands_scaled" for note in log.notes)]
    means = [[float(values.mean()) for values in (_speed(log), _command_at_voltage(log, robot))] for log in own]
    gain = _mean([speed / command for speed, command in means])
    moved = [float(log.rotor_command.var()) for log in known if log.rotor_command is not None]
    lag, dead = (_mean([getattr(one, name) for one in lines], moved) for name in ("time_constant", "delay"))
    delay = effect_parameter(robot, "actuation_delay", "delay", 0.0)
    return [
        Constant(
            name="rotor_lag", kind="rotor_lag", declared=mean_time_constant(robot), unit="s", estimate=lag,
            reason="no_rotor_speeds", setting="rotor.time_constant_up, rotor.time_constant_down",
            new=None if lag is None else lag.value,
        ),
        Constant(
            name="motor_latency", kind="motor_latency", declared=delay, unit="s", estimate=dead, reason="no_rotor_speeds",
            setting="effects.actuation_delay.delay", new=None if dead is None else dead.value,
        ),
        _voltage_constant(known, robot, gain),
    ]  # fmt: skip


def _parts(log: FlightLog) -> list[FlightLog]:
    """Return ``FEWEST_FLIGHTS`` equal parts of a flight."""
    ends = np.linspace(0, log.time.size, FEWEST_FLIGHTS + 1).astype(int)
    return [take_rows(log, slice(first, last)) for first, last in pairwise(ends)]


def _line_of_commands(log: FlightLog, robot: RobotCfg) -> LineBehindLag:
    return fit_line_behind_lag(_command_at_voltage(log, robot), _speed(log), robot, sample_rate(log))


def _mean(values: Sequence[float], weights: Sequence[float] | None = None) -> Estimate | None:
    """Return the mean of values of single flights, with the interval of their scatter; None for less than two."""
    if len(values) < 2:
        return None
    value, weight = np.array(values), np.ones(len(values)) if weights is None else np.array(weights)
    mean, count = float(weight @ value / weight.sum()), len(values)
    std = float(np.sqrt((weight * (value - mean)) @ (weight * (value - mean)) * count / (count - 1)) / weight.sum())
    return Estimate.from_half_width(mean, float(student_quantile(0.975, count - 1)) * std)


def _voltage_constant(logs: Sequence[FlightLog], robot: RobotCfg, gain: Estimate | None) -> Constant:
    """Return the reached per commanded speed; with a declared sag its error is one of the voltage.

    A nominal voltage scales, a wrong reading adds. Both look the same, and the size decides which one is named first.
    """
    constant = Constant(
        name="speed_per_command", kind="speed_per_command", declared=1.0, estimate=gain, reason="no_rotor_speeds",
        setting="the factor of the commands", new=None if gain is None else gain.value,
    )  # fmt: skip
    factors = [one for log in logs if (one := _speed_factor(log, robot)) is not None]
    if gain is None or robot.battery is None or not factors or constant.state != CONTRADICTED:
        return constant
    sag, nominal = effect_parameter(robot, "battery_sag", "gain", 0.0), robot.battery.nominal_voltage
    share = 1.0 - (1.0 - gain.value * float(np.mean(np.concatenate(factors)))) / sag
    voltage = float(np.mean(np.concatenate([log.battery for log in logs if log.battery is not None])))
    names = ("nominal_voltage", "voltage_reading", "speed_per_command")
    if abs(voltage - share * nominal) > LARGEST_READING_ERROR * voltage:
        setting, new, place = "battery.nominal_voltage [V]", voltage / share, 0
    else:
        setting, new, place = "the voltage added to the logged one [V]", share * nominal - voltage, 1
    tied = tuple(name for name in names if name != names[place])
    return replace(constant, name=names[place], setting=setting, new=new, tied=tied, remedy="measure_voltage")
