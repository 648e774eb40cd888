"""Check that rotor and command columns hold rotor speeds [rad/s], or thrusts [N] in force mode.

Letters: T rows, R rotors.
"""

from dataclasses import replace

import numpy as np

from aerial_gym.config.robot import RobotCfg
from aerial_gym.config.sim import STANDARD_GRAVITY
from aerial_gym.errors import DataError
from aerial_gym.sim2real.arrays import Array
from aerial_gym.sim2real.findings import Finding
from aerial_gym.sim2real.logs.readers.mapping import UNITS
from aerial_gym.sim2real.logs.recording import FlightLog
from aerial_gym.sim2real.logs.rotor_model import total_rotor_force


def check_rotor_columns(log: FlightLog, robot: RobotCfg) -> None:
    """Raise ``DataError`` for rotor columns with a wrong number, unit or sign."""
    if log.num_rotors != robot.num_rotors:
        raise DataError(
            f"{log.path}: has {log.num_rotors} rotor columns, the robot has {robot.num_rotors} rotors; "
            "give the robot that flew, or correct the columns"
        )
    if log.rotor_speed is not None and "force" in robot.rotor_traits:
        raise DataError(
            f"{log.path}: has measured rotor speeds (rotor_1..{log.num_rotors}), but the robot has rotors in force mode, whose "
            "state is a thrust, and no map from one to the other; leave these columns empty, so that thrusts follow from the "
            "commands (cmd_* in N), or declare the rotors in speed mode, with a thrust_map"
        )
    for name, values in (("rotor", log.rotor_speed), ("cmd", log.rotor_command)):
        if values is not None:
            _check_sign_of_rotor_column(log, name, values, robot)
            _check_unit_of_rotor_column(log, name, values, robot)


def without_copied_commands(log: FlightLog) -> FlightLog:
    """Return the log without commands that equal the measured speeds in every digit, as real rotors lag."""
    speed, command = log.rotor_speed, log.rotor_command
    if speed is None or command is None or not np.array_equal(speed, command):
        return log
    return replace(log, rotor_command=None, notes=(*log.notes, Finding("commands_copied")))


def _check_sign_of_rotor_column(log: FlightLog, name: str, values: Array, robot: RobotCfg) -> None:
    """Refuse a negative median speed of a rotor that is not reversible; noise at rest may be negative."""
    one_way = np.array([not rotor.reversible for rotor in robot.rotor_types])
    backwards = np.flatnonzero((np.median(values, axis=0) < 0.0) & one_way)
    if backwards.size:
        raise DataError(
            f"{log.path}: {name}_{backwards[0] + 1} is negative (median {np.median(values[:, backwards[0]]):.4g}); log them "
            "without sign: in which direction a rotor turns is declared in the robot file (spin); a reversible rotor has a "
            "thrust_range that begins below 0"
        )


def _check_unit_of_rotor_column(log: FlightLog, name: str, values: Array, robot: RobotCfg) -> None:
    """Check that the declared thrust at high logged speeds is the weight within a factor of three."""

    def high(states: Array) -> float:
        return float(np.percentile(total_rotor_force(robot, states), 90.0))

    thrust, unit = high(values), "N" if "force" in robot.rotor_traits else "rad/s"
    if thrust == 0.0:
        raise DataError(
            f"{log.path}: {name}_1..{values.shape[1]} (largest {values.max():.4g}) give the declared robot no thrust in nine "
            "of ten rows; leave the columns empty if the rotors were not measured"
        )
    ratio = thrust / (robot.body.mass * STANDARD_GRAVITY)
    if 1.0 / 3.0 < ratio < 3.0:
        return
    guess = f"check the unit ({unit}) and the robot"
    for other in ("rpm", "rev/s"):
        if unit == "rad/s" and 0.5 < high(UNITS[other] * values) * ratio / thrust < 2.0:
            guess = f"it looks like {other}: convert to rad/s, or give unit: {other} in a mapping file"
    if np.all((values >= 0.0) & (values <= 1.0)):
        guess = f"it looks like a fraction of full throttle: leave these columns out, or convert them to {unit}"
    raise DataError(
        f"{log.path}: {name}_1..{values.shape[1]} (90th percentile {np.percentile(values, 90.0):.4g}) would give {ratio:.3g} "
        f"times the weight of the declared robot; {guess}"
    )
