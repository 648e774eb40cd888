"""One scale for the relative commands of all logs of a vehicle, at one battery voltage.

The speed of a full command belongs to the vehicle. With a scale of its own, each log hides how that speed differs between
batteries; within a log, commands that rise as the voltage falls then look like another thrust curve.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from aerial_gym.config.robot import RobotCfg
from aerial_gym.sim2real.arrays import Array
from aerial_gym.sim2real.findings import Finding
from aerial_gym.sim2real.logs.recording import FlightLog, sample_rate
from aerial_gym.sim2real.logs.rotor_model import fit_line_behind_lag

SCALED = "relative_commands_scaled"  # Code of the finding on the scale of a log


def with_common_command_scale(logs: Sequence[FlightLog], robot: RobotCfg, learning: int) -> list[FlightLog]:
    """Return the logs, relative commands scaled alike: by the mean line ``w = a + b u`` of the first ``learning`` ones.

    Lines behind measured speeds are those at the nominal voltage of the robot file, or else at the mean voltage. Unless all
    logs have scaled commands of one kind and a voltage, each keeps its own scale.
    """
    if not logs:
        return []
    first = logs[: learning or len(logs)]
    notes = [[note for note in log.notes if note.code == SCALED] for log in logs]
    kinds = {bool(own[0].values["by_speeds"]) for own in notes if own}
    voltages = [0.0 if log.battery is None else float(np.mean(log.battery)) for log in logs]
    if len(kinds) != 1 or not all(notes) or not min(voltages) > 0.0:
        return list(logs)
    nominal = float(np.mean(voltages[: len(first)])) if robot.battery is None else robot.battery.nominal_voltage
    lines = [_line_at_voltage(log, robot, nominal) if True in kinds else _own_line(log) for log in first]
    offset, slope = np.mean(lines, axis=0).tolist()
    return [_with_line(log, own[0], offset, slope) for log, own in zip(logs, notes, strict=True)]


def _own_line(log: FlightLog) -> tuple[float, float]:
    assert log.command_curve is not None
    return log.command_curve[:2]


def _shares(log: FlightLog) -> Array:
    """Return the relative commands (T, R), to the power of the command curve."""
    offset, slope = _own_line(log)
    assert log.rotor_command is not None
    return (log.rotor_command - offset) / slope


def _line_at_voltage(log: FlightLog, robot: RobotCfg, nominal: float) -> tuple[float, float]:
    """Return a [rad/s] and b of steady speeds ``a + b u`` at the nominal voltage."""
    assert log.rotor_speed is not None
    assert log.battery is not None
    above = log.battery / nominal - 1.0
    return fit_line_behind_lag(_shares(log), log.rotor_speed, robot, sample_rate(log), above=above)


def _with_line(log: FlightLog, note: Finding, offset: float, slope: float) -> FlightLog:
    """Return the log with its commands, and the finding on them, by another line."""
    assert log.command_curve is not None
    changed = replace(note, values={**note.values, "full": offset + slope})
    return replace(
        log,
        rotor_command=offset + slope * _shares(log),
        command_curve=(offset, slope, log.command_curve[2]),
        notes=tuple(changed if one is note else one for one in log.notes),
    )
