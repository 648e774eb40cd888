"""Gains from inertia, rotor lag, authority and time step."""

from dataclasses import replace
from math import acos, atan, pi, sqrt

import numpy as np
import pytest
import torch
import yaml

from aerial_gym.config.controller import ControlCfg, ControllerCfg
from aerial_gym.config.loader import build
from aerial_gym.config.randomize import RandomizeCfg
from aerial_gym.config.robot import RobotCfg
from aerial_gym.control import CONTROLLERS, make_controller
from aerial_gym.control.allocation import Allocation
from aerial_gym.control.controllers import LeeController
from aerial_gym.control.gains import loop_shape
from aerial_gym.errors import ConfigError
from aerial_gym.physics import vehicle_from_config
from aerial_gym.robots import ROBOTS

F64 = torch.float64


def lee_controller(robot: RobotCfg, *, dt: float = 0.01, control: ControlCfg | None = None) -> LeeController:
    vehicle = vehicle_from_config(robot, num_envs=2, dtype=F64)
    control = robot.control if control is None else control
    return make_controller(CONTROLLERS.get("lee_position_control"), vehicle, 9.81, dt=dt, control=control)


@pytest.mark.parametrize("margin", [0.4, pi / 4, 1.1])
def test_the_loop_has_its_phase_margin_at_its_crossover_and_no_gain_has_more(margin: float) -> None:
    """Of ``(2 z w s + w²) / (s² (T s + 1))``: |L| = 1 and the phase are worked out here, on a grid of frequencies."""
    lag = 0.07
    frequency, damping = loop_shape(lag, margin)

    def phase_margin(scale: float) -> float:
        s = 1j * np.geomspace(1e-2, 1e3, 400_001)
        loop = scale * (2 * damping * frequency * s + frequency**2) / (s**2 * (lag * s + 1))
        crossing = loop[np.argmin(abs(np.log(abs(loop))))]
        return float(np.angle(-crossing))

    assert phase_margin(1.0) == pytest.approx(margin, abs=1e-4)
    assert max(phase_margin(0.8), phase_margin(1.25)) < margin


def test_gains_are_frequency_and_damping_times_inertia() -> None:
    """At 100 Hz: T = 0.04 + 0.01 s, a = 1 + sqrt 2; roll, pitch from the lag, yaw of a heavier one from its authority."""
    light, gains = (lee_controller(ROBOTS.get(f"base_quadrotor{end}")).gains for end in ("", "_doubled_inertia"))
    a, lag = 1.0 + sqrt(2.0), 0.05
    assert atan(a) - atan(1 / a) == pytest.approx(pi / 4)
    for each, roll in ((light, 4.225e-4), (gains, 8.45e-4)):
        torch.testing.assert_close(each.attitude[0, :2], torch.full((2,), roll / (a**3 * lag**2), dtype=F64))
        torch.testing.assert_close(each.rate[0, :2], torch.full((2,), roll / (a * lag), dtype=F64))
    torch.testing.assert_close(light.attitude[1, 2], torch.tensor(8.45e-4 / (a**3 * lag**2), dtype=F64))
    yaw = 4 * 0.01 * min(0.25 * 9.81 / 4, 2.0 - 0.25 * 9.81 / 4)  # torque [N m] per unit of attitude error
    torch.testing.assert_close(gains.attitude[1, 2], torch.tensor(yaw, dtype=F64))
    torch.testing.assert_close(gains.velocity[0], torch.full((3,), 1 / (a**3 * lag), dtype=F64))
    torch.testing.assert_close(gains.position[0], torch.full((3,), 1 / (a**7 * lag**2), dtype=F64))


def test_slower_rotors_and_larger_steps_are_slower_loops() -> None:
    robot = ROBOTS.get("crazyflie_21")
    slow = replace(robot, rotor=replace(robot.rotor, time_constant_up=0.14))
    variants = ((robot, 0.002), (robot, 0.02), (slow, 0.002))
    quick, coarse, lagging = (lee_controller(cfg, dt=dt) for cfg, dt in variants)
    for name in ("position", "velocity", "attitude", "rate"):
        assert (getattr(coarse.gains, name) < getattr(quick.gains, name)).all(), name
        assert (getattr(lagging.gains, name) < getattr(quick.gains, name)).all(), name


def test_a_robot_file_may_give_frequencies_damping_and_limits() -> None:
    robot = ROBOTS.get("base_quadrotor")
    control = ControlCfg(
        attitude_frequency=(8.0, 7.0, 2.0), attitude_damping=(0.7, 0.8, 0.9), position_frequency=(1.0, 1.0, 2.0),
        position_damping=(0.7, 0.7, 1.0), max_yaw_rate=2.0, max_inclination=0.3, source="test",
    )  # fmt: skip
    gains = lee_controller(robot, control=control).gains
    inertia = torch.tensor([4.225e-4, 4.225e-4, 8.45e-4], dtype=F64)
    torch.testing.assert_close(gains.attitude[0], inertia * torch.tensor([64.0, 49.0, 4.0], dtype=F64))
    torch.testing.assert_close(gains.rate[0], inertia * torch.tensor([11.2, 11.2, 3.6], dtype=F64))
    torch.testing.assert_close(gains.position[0], torch.tensor([1.0, 1.0, 4.0], dtype=F64))
    torch.testing.assert_close(gains.velocity[0], torch.tensor([1.4, 1.4, 4.0], dtype=F64))
    assert (gains.max_yaw_rate, gains.max_inclination) == (2.0, 0.3)


def test_inclination_leaves_half_of_the_spare_thrust() -> None:
    """tinyprop has 4 x 1.2 N for 3.66 N: cos tilt = 1 / (1 + 0.31 / 2); a vehicle with thrust to spare keeps pi/3."""
    surplus = 4 * 1.2 / (0.373 * 9.81) - 1.0
    expected = acos(1.0 / (1.0 + surplus / 2))
    assert lee_controller(ROBOTS.get("tinyprop")).gains.max_inclination == pytest.approx(expected)
    assert lee_controller(ROBOTS.get("base_quadrotor")).gains.max_inclination == pytest.approx(pi / 3)


def test_without_yaw_torque_yaw_is_left_alone() -> None:
    gains = lee_controller(ROBOTS.get("neural_fly_quad")).gains
    assert gains.attitude[0, 2] == gains.rate[0, 2] == 0.0
    assert (gains.attitude[0, :2] > 0.0).all()


def test_authority_is_the_torque_at_which_a_rotor_meets_its_limit() -> None:
    """tinyprop at hover: 0.915 N a rotor, 0.285 N below its limit, arms of 0.16 m, 0.01 m of drag torque per thrust."""
    vehicle = vehicle_from_config(ROBOTS.get("tinyprop"), num_envs=1, dtype=F64)
    spare = 1.2 - 0.373 * 9.81 / 4
    expected = 4 * spare * torch.tensor([0.16, 0.16, 0.01], dtype=F64)
    torch.testing.assert_close(Allocation(vehicle, 9.81).torque_authority(0.373 * 9.81), expected)
    assert Allocation(vehicle, 9.81).largest_thrust() == pytest.approx(4.8)


def test_each_environment_may_have_gains_of_its_own() -> None:
    controller = lee_controller(ROBOTS.get("base_quadrotor"))
    controller.own_gains()
    controller.gains.attitude[1] *= 2.0
    torch.testing.assert_close(controller.gains.attitude[1], 2.0 * controller.gains.attitude[0])


@pytest.mark.parametrize("field", ["randomize", "rate_gain_low", "position_gain_high"])
def test_a_file_with_ranges_of_gains_is_told_where_they_went(field: str) -> None:
    gains = {"randomize": False} if field == "randomize" else {field: [1.0, 1.0, 1.0]}
    with pytest.raises(ConfigError) as e:
        build(ControlCfg, {"gains": gains}, where="robot.yaml: control")
    message = str(e.value)
    assert message.startswith(f"robot.yaml: control: gains: field {field!r} is gone: gains have no ranges of their own")
    way_out = message.split("randomize: {", 1)[1].rsplit("}", 1)[0]
    name, drawn = next(iter(yaml.safe_load(f"{{{way_out}}}").items()))
    assert name == "gains.position"
    assert build(RandomizeCfg, drawn, where="the message").how == "value"


def test_what_is_missing_or_impossible_is_named() -> None:
    vehicle = vehicle_from_config(ROBOTS.get("tinyprop"), num_envs=1)
    with pytest.raises(ConfigError, match=r"derived from the time step. Give dt"):
        make_controller(CONTROLLERS.get("lee_rates_control"), vehicle, 9.81)
    with pytest.raises(ConfigError, match=r"ControlCfg.phase_margin = 1.6: must be > 0 and < pi/2"):
        ControlCfg(phase_margin=1.6)
    with pytest.raises(ConfigError, match=r"ControlCfg.attitude_frequency = \(1.0, nan, 1.0\)"):
        ControlCfg(attitude_frequency=(1.0, float("nan"), 1.0))
    with pytest.raises(ConfigError, match="ControllerCfg.allocation = 'none'"):
        ControllerCfg(summary="", law="rates", allocation="none")
