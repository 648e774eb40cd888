"""Tuning a robot file: lag and dead time come from its effects, yaw from its torque; the file that is printed loads."""

from dataclasses import replace
from math import pi

import pytest
import torch
import yaml

from aerial_gym.cli.main import main
from aerial_gym.config.controller import ControlCfg
from aerial_gym.config.loader import build
from aerial_gym.control import CONTROLLERS, make_controller
from aerial_gym.errors import ConfigError
from aerial_gym.physics import vehicle_from_config
from aerial_gym.robots import ROBOTS
from aerial_gym.robots.tune import tune_robot

X500 = ROBOTS.get("x500")


def test_lag_and_dead_time_are_those_of_the_identified_robot() -> None:
    plain = tune_robot(X500, name="x500", attitude=6.0, position=1.0, damping=0.8, dt=0.004)
    assert (plain.lag, plain.delay) == (0.025, 0.0)
    effects = {"motor_time_constant": {"tau": 0.04}, "actuation_delay": {"delay": 0.01}}
    result = tune_robot(
        replace(X500, effects=effects, effects_source="here"), name="x500", attitude=4.0, position=0.6, damping=0.8, dt=0.004
    )  # fmt: skip
    assert result.lag == pytest.approx(0.04)
    assert result.delay == 0.01
    assert result.radius < 1.0
    with pytest.raises(ConfigError, match=r"attitude loop: a bandwidth of 20.0 rad/s .* Ask for at most"):
        tune_robot(X500, name="x500", attitude=20.0, position=1.0, damping=0.8, dt=0.004)


def test_yaw_is_no_quicker_than_its_torque() -> None:
    """x500 gives 10.1 rad/s² about yaw at hover, docs/results/robots.md: sqrt of that, 3.18 rad/s, is the most."""
    result = tune_robot(X500, name="x500", attitude=6.0, position=1.0, damping=0.8, dt=0.004)
    assert result.yaw_limited
    assert result.control.attitude_frequency[2] == pytest.approx(10.1**0.5, rel=5e-3)


def test_the_printed_control_loads_and_gives_the_gains(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["robot", "tune", "x500", "--attitude-hz", "1.0", "--position-hz", "0.15", "--dt-s", "0.004"]) == 0
    control = build(ControlCfg, yaml.safe_load(capsys.readouterr().out)["control"], where="printed")
    result = tune_robot(X500, name="x500", attitude=2.0 * pi, position=0.3 * pi, damping=0.8, dt=0.004).control
    vehicle = vehicle_from_config(X500, num_envs=1, dtype=torch.float64)
    gains = []
    for each in (control, result):
        law = make_controller(CONTROLLERS.get("lee_position_control"), vehicle, 9.81, dt=0.004, control=each)
        gains.append(law.gains_by_name)
    for name, rows in gains[0].items():
        torch.testing.assert_close(rows, gains[1][name], rtol=1e-4, atol=0)
