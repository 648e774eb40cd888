"""The loop on logs of a vehicle whose rotors are in force mode: commands in newtons, no rotor speeds."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from aerial_gym.config import dump_yaml
from aerial_gym.config.robot import RobotCfg, RotorCfg
from aerial_gym.errors import ConfigError, DataError
from aerial_gym.sim2real import replay
from aerial_gym.sim2real.logs.flights import load_train_and_test
from aerial_gym.sim2real.loop import judge_flights
from tests.unit.sim2real.flat_flights import ROBOT, flight, verdict_of_command, write

TAU = 0.04  # Declared lag of the thrusts [s]

FORCE = RotorCfg(
    mode="force", torque_ratio=0.015, time_constant_up=TAU, time_constant_down=TAU, thrust_range=(0.05, 5.0),
    source="invented",
)  # fmt: skip
FORCED: RobotCfg = replace(ROBOT, rotor=FORCE)
NO_SPEED = {"axial_inflow", "battery_sag", "h_force_flapping", "rotor_inertia", "rotor_speed_scale", "tachometer_scale"}
ROTORS = [f"rotor_{n}" for n in (1, 2, 3, 4)]
COMMANDS = [f"cmd_{n}" for n in (1, 2, 3, 4)]


def force_flight(seed: int, *, tau: float = TAU, late: int = 0, scale: float = 1.0, drag: float = 0.0) -> pd.DataFrame:
    """Return a flight in which held commands [N] lead to the thrusts that the path needs, through a lag and a dead
    time. The exact inverse of ``T' = (c - T) / tau`` over a row: ``c = T + (T_next - T) / (1 - exp(-dt / tau))``.
    Commands are read ``late`` rows before they act, and the rotors give ``scale`` times what they are told."""
    kept = {"drag": drag, "seconds": 8.0, "rate": 100.0}
    thrust = 1.2e-6 * flight(seed, **kept)[ROTORS].to_numpy() ** 2 / scale
    table = flight(seed, noise=1.0, **kept)
    after = np.append(thrust[1:], thrust[-1:], axis=0)
    command = thrust + (after - thrust) / (1.0 - np.exp(-0.01 / tau))
    table = table.drop(columns=ROTORS)
    table[COMMANDS] = np.roll(command, -late, axis=0)
    return table.iloc[: len(table) - 1 - late]


@pytest.mark.parametrize(("hidden", "name", "params"), [
    ({"tau": 0.1}, "motor_time_constant", {"tau": 0.1}),
    pytest.param({"drag": 0.25}, "rotor_drag", {"dx": 0.25, "dy": 0.25}, marks=pytest.mark.slow),
    pytest.param({"scale": 1.1}, "thrust_coefficient", {"scale": 1.1}, marks=pytest.mark.slow),
])  # fmt: skip
@pytest.mark.slow
def test_the_hidden_effect_is_named(hidden, name, params, tmp_path) -> None:
    verdict = verdict_of_command(tmp_path, FORCED, [force_flight(40 + n, **hidden) for n in range(4)])
    assert [effect["name"] for effect in verdict["effects"]] == [name]
    effect = verdict["effects"][0]
    for key, value in params.items():
        assert abs(effect["params"][key] - value) < 4.0 * effect["std"][key], key
        assert effect["std"][key] < 0.1 * value
    assert set(verdict["not_testable"]) >= NO_SPEED
    for untold in NO_SPEED - {"battery_sag"}:
        assert "force mode" in verdict["not_testable_because"][untold]
    assert "rotor_speed" not in verdict["before"]


def test_a_dead_time_is_replayed_from_commands_in_newtons(tmp_path: Path) -> None:
    log = write(force_flight(50, late=3), tmp_path / "late.csv")
    left = []
    for effects in ({}, {"actuation_delay": {"delay": 0.03}}):
        robot = replace(FORCED, effects=effects, effects_source="test" if effects else "")
        (tmp_path / "robot.yaml").write_text(dump_yaml(robot))
        result = replay(tmp_path / "robot.yaml", [log], None)
        left.append(np.mean([result.as_mapping()["replay"]["angular_acceleration"][axis]["rms"] for axis in "xy"]))
    assert left[1] < 0.7 * left[0]


def test_measured_speeds_of_rotors_in_force_mode_are_refused(tmp_path: Path) -> None:
    (tmp_path / "robot.yaml").write_text(dump_yaml(FORCED))
    log = write(flight(1), tmp_path / "speeds.csv")
    words = r"speeds.csv: has measured rotor speeds .* commands \(cmd_\* in N\), or declare"
    with pytest.raises(DataError, match=words):
        replay(tmp_path / "robot.yaml", [log], None)
    table = force_flight(1)
    table[COMMANDS] = (table[COMMANDS] / 5.0).clip(0.0, 1.0)
    with pytest.raises(DataError, match=r"weight of the declared robot; it looks like a fraction .* convert them to N"):
        replay(tmp_path / "robot.yaml", [write(table, tmp_path / "throttle.csv")], None)


def test_a_learned_residual_needs_rotor_speeds(tmp_path: Path) -> None:
    logs = [write(force_flight(60 + n), tmp_path / f"f{n}.csv") for n in range(2)]
    train, test = load_train_and_test(FORCED, logs[:1], logs[1:], mapping=None, bandwidth=10.0)
    with pytest.raises(ConfigError, match="effect learned_residual: its law does not hold for rotors in force mode"):
        judge_flights(FORCED, train, test, learn_residual=True)
