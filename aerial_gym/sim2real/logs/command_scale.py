"""One scale for the relative commands of all logs of a vehicle, at one battery voltage.

The speed of a full command belongs to the vehicle. With a scale of its own, each log hides how that speed differs between
batteries; within a log, commands that rise as the voltage falls then look like another thrust curve.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from aerial_gym.config.robot import RobotCfg
from aerial_gym.sim2real.arrays import Array
from aerial_gym.sim2real.logs.recording import FlightLog, sample_rate
from aerial_gym.sim2real.logs.rotor_model import fit_line_behind_lag

SCALED = "relative_commands_scaled"  # Code of the finding on the scale of a log


def with_common_command_scale(logs: Sequence[FlightLog], robot: RobotCfg, learning: int) -> list[FlightLog]:
    """Return the logs, relative commands scaled alike: by the mean line ``w = a + b u`` of the first ``learning`` ones.

    Lines behind measured speeds are those at the nominal voltage of the robot file, or else at the mean voltage. Unless all
    logs have scaled commands of one kind and a voltage, each keeps its own scale.
    """
    notes = [next((note for note in log.notes if note.code == SCALED), None) for log in logs]
    voltages = [0.0 if log.battery is None else float(np.mean(log.battery)) for log in logs]
    kinds = {None if note is None else bool(note.values["by_speeds"]) for note in notes}
    if len(kinds) != 1 or None in kinds or not min(voltages) > 0.0:
        return list(logs)
    first = slice(learning or len(logs))
    nominal = float(np.mean(voltages[first])) if robot.battery is None else robot.battery.nominal_voltage
    lines = [_line_at_voltage(log, robot, nominal) for log in logs[first]]
    offset, slope = np.mean(lines, axis=0).tolist()
    return [_with_line(log, offset, slope) for log in logs]


def _line_at_voltage(log: FlightLog, robot: RobotCfg, nominal: float) -> tuple[float, float]:
    """Return a and b of steady states ``a + b u``, behind measured speeds at the nominal voltage, else the present ones."""
    assert log.command_curve is not None
    if log.rotor_speed is None or log.battery is None:
        return log.command_curve[:2]
    above = log.battery / nominal - 1.0
    line = fit_line_behind_lag(_shares(log), log.rotor_speed, robot, sample_rate(log), above=above)
    return line.idle, line.slope


def _shares(log: FlightLog) -> Array:
    """Return the relative commands (T, R), to the power of the command curve."""
    assert log.rotor_command is not None
    assert log.command_curve is not None
    return (log.rotor_command - log.command_curve[0]) / log.command_curve[1]


def _with_line(log: FlightLog, offset: float, slope: float) -> FlightLog:
    """Return the log with its commands, and the finding on them, by another line."""
    assert log.command_curve is not None
    full = {"full": offset + slope}
    notes = (replace(one, values={**one.values, **full}) if one.code == SCALED else one for one in log.notes)
    curve = (offset, slope, log.command_curve[2])
    return replace(log, rotor_command=offset + slope * _shares(log), command_curve=curve, notes=tuple(notes))
