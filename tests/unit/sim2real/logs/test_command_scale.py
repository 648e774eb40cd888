"""One scale of relative commands for all logs, so that a sagging battery stays visible in the commands."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest

from aerial_gym.config.robot import BatteryCfg
from aerial_gym.robots.catalog import robot_by_name
from aerial_gym.sim2real.logs.command_scale import with_common_command_scale
from aerial_gym.sim2real.logs.flights import scale_relative_commands
from aerial_gym.sim2real.logs.recording import FlightLog
from aerial_gym.sim2real.logs.rotor_model import simulate_lag, total_rotor_force

ROBOT, RATE, ROWS = robot_by_name("tinyprop"), 200.0, 1600
FULL, SAG = 1800.0, 0.8  # Speed at a full command and 16 V [rad/s], relative speed per relative voltage
BATTERY = BatteryCfg(
    nominal_voltage=16.0, full_voltage=16.8, empty_voltage=13.2, internal_resistance=0.03, capacity=4000.0, source="test"
)  # fmt: skip


def fly(start: float, *, sag: float = SAG, speeds: bool = True) -> FlightLog:
    """Return a log whose voltage falls by 1 V from ``start``, and whose commands rise with it to keep the thrust."""
    time, rng = np.arange(ROWS) / RATE, np.random.default_rng(round(10.0 * start))
    voltage = start - time / time[-1]
    supply = (1.0 + sag * (voltage / 16.0 - 1.0))[:, None]
    phase = rng.uniform(0.0, 6.0, (3, 4))
    wanted = 900.0 + 60.0 * np.sin(2.0 * np.pi * np.array([0.7, 1.9, 3.1])[:, None] * time[:, None, None] + phase).sum(
        1
    )
    speed = simulate_lag(ROBOT, wanted, RATE)
    force = np.zeros((ROWS, 3))
    force[:, 2] = total_rotor_force(ROBOT, speed) / ROBOT.body.mass
    log = FlightLog(
        path=f"{start}", time=time, attitude=np.tile((0.0, 0.0, 0.0, 1.0), (ROWS, 1)), specific_force=force,
        rotor_speed=speed if speeds else None, rotor_command=wanted / (FULL * supply), relative_commands=True,
        battery=voltage,
    )  # fmt: skip
    return scale_relative_commands(log, ROBOT)


def full_commands(logs: Sequence[FlightLog]) -> list[float]:
    return [float(log.notes[-1].values["full"]) for log in logs]


def test_a_full_command_is_that_of_the_nominal_voltage_whatever_the_battery() -> None:
    """Scaled one by one, commands of a falling voltage give full speeds that differ by some 10 %, as their lines are bent."""
    logs, robot = [fly(16.4), fly(15.6), fly(15.0)], replace(ROBOT, battery=BATTERY)
    assert max(full_commands(logs)) > 1.02 * min(full_commands(logs))
    alike = with_common_command_scale(logs, robot, 2)
    assert full_commands(alike) == pytest.approx([FULL] * 3, rel=2e-3)
    for log in alike:
        assert log.rotor_speed is not None
        assert log.battery is not None
        supply = 1.0 + SAG * (log.battery / 16.0 - 1.0)
        reached = simulate_lag(ROBOT, log.rotor_command * supply[:, None], RATE)
        np.testing.assert_allclose(reached[200:], log.rotor_speed[200:], rtol=3e-3)


def test_without_a_declared_battery_a_full_command_is_that_of_the_mean_voltage_of_training() -> None:
    logs = [fly(16.4), fly(15.6), fly(15.0)]
    supply = 1.0 + SAG * (15.5 / 16.0 - 1.0)  # of the first two
    assert full_commands(with_common_command_scale(logs, ROBOT, 2)) == pytest.approx([FULL * supply] * 3, rel=2e-3)


def test_commands_that_thrust_scales_show_the_voltage_between_flights() -> None:
    """One factor for all: with 1.4 V less, the same thrust takes more command, as the battery sags."""
    logs = with_common_command_scale([fly(16.4, speeds=False), fly(15.0, speeds=False)], ROBOT, 2)
    assert full_commands(logs)[0] == full_commands(logs)[1]
    supplies = [1.0 + SAG * ((start - 0.5) / 16.0 - 1.0) for start in (16.4, 15.0)]
    means = [float(log.rotor_command.mean()) for log in logs if log.rotor_command is not None]
    assert means[1] / means[0] == pytest.approx(supplies[0] / supplies[1], rel=5e-3)


def test_logs_without_a_voltage_or_of_two_kinds_keep_their_own_scale() -> None:
    logs = [fly(16.4), fly(15.0)]
    for mixture in ([logs[0], replace(logs[1], battery=None)], [logs[0], fly(15.0, speeds=False)]):
        assert with_common_command_scale(mixture, ROBOT, 2) == mixture
    assert with_common_command_scale([], ROBOT, 0) == []
