"""Tuning a robot file, and ends of drawn ranges that a law does not follow."""

import logging
from dataclasses import replace
from math import isclose, pi

import pytest
import torch
import yaml

from aerial_gym.cli.main import main
from aerial_gym.config.controller import ControlCfg
from aerial_gym.config.loader import build
from aerial_gym.config.randomize import RandomizeCfg
from aerial_gym.control import CONTROLLERS, make_controller
from aerial_gym.control.stability import HoverResult
from aerial_gym.errors import ConfigError
from aerial_gym.physics import vehicle_from_config
from aerial_gym.robots import ROBOTS
from aerial_gym.robots.range_warnings import hovers_at_range_ends, report_range_faults
from aerial_gym.robots.tune import tune_robot
from tests.builders import simulation

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


GRAVITY, DT = 9.81, 0.01
AT = {"gravity": GRAVITY, "dt": DT, "integrator": "euler", "names": ("robot", "law")}
QUAD, LEE = ROBOTS.get("base_quadrotor"), CONTROLLERS.get("lee_position_control")


def hovers(randomize: dict[str, RandomizeCfg]) -> list[HoverResult]:
    return [hover for _, _, hover in hovers_at_range_ends(QUAD, LEE, randomize, **AT)]


def test_each_end_of_thrust_and_mass_rests_where_the_equations_say() -> None:
    """``e = g (1 / s - 1) / k`` below for thrust, ``g (s - 1) / k`` for mass, of which the law knows neither."""
    vehicle = vehicle_from_config(QUAD, num_envs=1, dtype=torch.float64)
    law = make_controller(LEE, vehicle, GRAVITY, dt=DT, control=QUAD.control)
    gain = float(law.gains.position[0, 2])
    result = hovers({"rotor.thrust_map": RandomizeCfg(low=0.5, high=2.0), "body.mass": RandomizeCfg(low=0.8, high=1.2)})
    expected = [1.0 - 1.0 / 0.5, 1.0 - 1.0 / 2.0, 1.0 - 0.8, 1.0 - 1.2]
    assert [hover.offset[2] for hover in result] == pytest.approx([GRAVITY / gain * n for n in expected], abs=1e-5)


def test_a_drawn_dead_time_is_judged_at_each_end() -> None:
    late = {"effects.actuation_delay.delay": RandomizeCfg(how="value", low=0.0, high=0.02)}
    robot, law = ROBOTS.get("crazyflie_21"), CONTROLLERS.get("crazyflie_lee_control")
    low, high = (hover for _, _, hover in hovers_at_range_ends(robot, law, late, **AT))
    assert low.stable
    assert not high.stable


def test_wind_is_judged_with_the_drag_that_it_needs() -> None:
    wind = {"effects.constant_wind.x": RandomizeCfg(how="value", low=0.0, high=5.0)}
    drag = {"effects.rotor_drag.dx": RandomizeCfg(how="value", low=0.0, high=0.2)}
    assert all(hover.is_within_range for hover in hovers(wind | drag))
    robot = ROBOTS.get("base_quadrotor_with_drag")
    still, windy = (hover for _, _, hover in hovers_at_range_ends(robot, LEE, wind, **AT))
    assert still.is_within_range
    assert not windy.is_within_range
    assert windy.offset[0] > 0.1


def test_rotors_that_are_drawn_apart_have_an_end_that_differs() -> None:
    each = {"rotor.torque_map": RandomizeCfg(low=0.9, high=1.1, each_rotor=True)}
    assert len(hovers(each)) == 3
    assert len(hovers({"rotor.torque_map": RandomizeCfg(low=0.9, high=1.1)})) == 2


def test_a_simulation_of_ranges_that_are_not_followed_warns(caplog: pytest.LogCaptureFixture) -> None:
    """Thrust from 0.35 to 2.1 times the declared: some of these vehicles sank by 70 m in 10 s."""
    with caplog.at_level(logging.WARNING):
        simulation("sampled_quadrotor", LEE, num_envs=1)
    (record,) = [each for each in caplog.records if "range_warnings" in each.name]
    assert "rotor.thrust_map = 0.353" in record.getMessage()


def test_ranges_that_are_followed_are_silent(caplog: pytest.LogCaptureFixture) -> None:
    small = {"body.inertia": RandomizeCfg(low=0.9, high=1.1), "rotor.thrust_map": RandomizeCfg(low=0.999, high=1.001)}
    with caplog.at_level(logging.WARNING):
        report_range_faults(QUAD, LEE, randomize=small, **AT)
        thrust = CONTROLLERS.get("rotor_speed_control")
        report_range_faults(QUAD, thrust, randomize={"body.mass": RandomizeCfg(low=0.5, high=2.0)}, **AT)
    assert not caplog.records
    (name, end, hover), *_ = hovers_at_range_ends(QUAD, LEE, {"body.mass": RandomizeCfg(low=1.0, high=1.0)}, **AT)
    assert (name, end) == ("body.mass", "1")
    assert isclose(hover.distance, 0.0, abs_tol=1e-6)
