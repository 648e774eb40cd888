"""Gains from inertia, rotor lag, authority and time step; the tuner against closed forms, sampled loops and flights."""

from dataclasses import replace
from math import acos, atan, pi, sqrt

import numpy as np
import pytest
import torch
import yaml
from torch import Tensor

from aerial_gym import physics
from aerial_gym.config.controller import ControlCfg, ControllerCfg
from aerial_gym.config.loader import build
from aerial_gym.config.randomize import RandomizeCfg
from aerial_gym.config.robot import RobotCfg
from aerial_gym.control import CONTROLLERS, make_controller
from aerial_gym.control.allocation import Allocation
from aerial_gym.control.controllers import LeeController
from aerial_gym.control.gains import frequency_and_damping
from aerial_gym.control.stability import ClosedLoop
from aerial_gym.control.tuner import Tuning, rotor_response, tune_attitude, tune_loop, tune_position
from aerial_gym.errors import ConfigError
from aerial_gym.math.quaternion import euler_from_quat
from aerial_gym.robots import ROBOTS

F64 = torch.float64
X500 = ROBOTS.get("x500")


def vehicles() -> physics.Vehicle:
    vehicle = physics.vehicle_from_config(X500, num_envs=4, dtype=F64)
    turn, slow = torch.tensor([1.0, 2.0, 1.0, 0.7], dtype=F64), torch.tensor([1.0, 1.0, 1.6, 0.5], dtype=F64)
    lag = slow.unsqueeze(-1) * vehicle.time_constant_down
    return replace(vehicle, inertia=turn[:, None, None] * vehicle.inertia, time_constant_up=lag, time_constant_down=lag)


@pytest.mark.parametrize("damping", [0.5, 0.7, 1.0])
def test_without_lag_it_is_the_second_order_formula(damping: float) -> None:
    """Bandwidth over natural frequency: sqrt(1 - 2 z² + sqrt((1 - 2 z²)² + 1))."""
    none = torch.zeros(2, 3, dtype=F64)
    result = tune_loop(rotor_response(none, 0.0), none, bandwidth=5.0, damping=damping, loop_name="a")
    square = 1.0 - 2.0 * damping**2
    natural = 5.0 / sqrt(square + sqrt(square**2 + 1.0))
    torch.testing.assert_close(result.natural_frequency, torch.full_like(none, natural), rtol=1e-5, atol=0)
    torch.testing.assert_close(result.damping, torch.full_like(none, damping), rtol=1e-5, atol=0)


def residual(results: Tuning, damping: float) -> Tensor:
    """Return the characteristic polynomial at the pair, over s²."""
    s = results.frequency * complex(-damping, sqrt(1.0 - damping**2))
    return (s.square() + (results.proportional + results.derivative * s) * results.inner(s)) / s.square()


def test_poles_and_bandwidth_are_met_with_lag_and_dead_time_in_every_environment() -> None:
    attitude = tune_attitude(vehicles(), bandwidth=5.0, damping=0.7, delay=0.01, dt=0.004)
    position = tune_position(attitude, bandwidth=(0.5, 0.7, 1.2), damping=0.8)
    asked = torch.tensor([[5.0] * 3, [0.5, 0.7, 1.2]], dtype=F64)
    for result, bandwidth, damping in ((attitude, asked[0], 0.7), (position, asked[1], 0.8)):
        assert float(residual(result, damping).abs().max()) < 1e-12
        s = torch.complex(torch.zeros(4, 3, dtype=F64), bandwidth.expand(4, 3))
        torch.testing.assert_close(
            result.closed_loop_response(s).abs(), torch.full((4, 3), sqrt(0.5), dtype=F64), rtol=1e-9, atol=0
        )
    assert len(set(attitude.proportional[:, 0].tolist())) == 3  # inertia is not in it, lag is


def test_the_sampled_loop_has_the_placed_poles() -> None:
    """Its eigenvalues ``exp(s dt)``: half a step of holding is all but what sampling does, to the square of the time step."""
    quick = replace(X500, rotor=replace(X500.rotor, time_constant_up=0.02, time_constant_down=0.02))
    vehicle, missed = physics.vehicle_from_config(quick, num_envs=1, dtype=F64), []
    for dt in (0.008, 0.004):
        attitude = tune_attitude(vehicle, bandwidth=8.0, damping=0.7, delay=0.0, dt=dt)
        position = tune_position(attitude, bandwidth=1.0, damping=0.8)
        loops = {"attitude": attitude, "position": position}
        numbers = {
            f"{name}_{kind}": tuple(getattr(result, "natural_frequency" if kind == "frequency" else kind)[0].tolist())
            for name, result in loops.items()
            for kind in ("frequency", "damping")
        }
        loop = ClosedLoop(
            replace(quick, control=ControlCfg(**numbers)),
            CONTROLLERS.get("lee_position_control"), gravity=9.81, integrator="rk4", names=("x500", "lee_position_control"),
        )  # fmt: skip
        poles = torch.log(loop._corner_modes(None, 1.0, dt)[0]) / dt
        yaw, sideways, up = (attitude, 2, 0.7), (position, 0, 0.8), (position, 2, 0.8)
        for result, axis, damping in (yaw, sideways, up):
            placed = complex(result.frequency[0, axis]) * complex(-damping, sqrt(1.0 - damping**2))
            missed.append(float((poles - placed).abs().min()) / abs(placed))
    assert max(missed[:3]) < 0.01
    for coarse, fine in zip(missed[:3], missed[3:], strict=True):
        assert fine < 0.3 * coarse


def test_a_flight_with_lag_and_dead_time_has_the_bandwidth() -> None:
    """Every vehicle told to roll by a sine at it gives ``sqrt 1/2`` of it, within 1 %; dead time of 3.5 steps."""
    bandwidth, vehicle, amplitude = 5.0, vehicles(), 0.02
    dt = 2.0 * pi / bandwidth / 150.0
    delay = 3.5 * dt
    result = tune_attitude(vehicle, bandwidth=bandwidth, damping=0.7, delay=delay, dt=dt)
    law = make_controller(CONTROLLERS.get("lee_attitude_control"), vehicle, 9.81, dt=dt)
    inertia = vehicle.inertia.diagonal(dim1=1, dim2=2)
    law.gains = replace(law.gains, attitude=inertia * result.proportional, rate=inertia * result.derivative)
    late = (physics.EFFECTS.get("actuation_delay"), torch.full((4, 1), delay, dtype=F64))
    backend, state = physics.TorchBackend(), physics.state_at_rest(4, 4, device=torch.device("cpu"), dtype=F64)
    backend.allocate(physics.build_model(vehicle, [late]), law, integrator="rk4")
    state.rotor_speed.fill_(physics.rotor_state_for_thrust(X500.rotor, X500.body.mass * 9.81 / 4))
    rolls, times = [], []
    for step in range(600):
        time = torch.tensor(step * dt, dtype=F64)
        action = torch.zeros(4, 4, dtype=F64)
        action[:, 1] = amplitude * torch.sin(bandwidth * time)
        backend.step(state, action, dt, 1)
        if step >= 450:  # a period, three after the start
            rolls.append(euler_from_quat(state.attitude.clone())[:, 0])
            times.append((step + 1) * dt)
    wave = torch.tensor(times, dtype=F64) * bandwidth
    roll = torch.stack(rolls)
    part = torch.stack(((roll.T * torch.sin(wave)).mean(-1), (roll.T * torch.cos(wave)).mean(-1)))
    gain = 2.0 * part.square().sum(0).sqrt() / amplitude
    torch.testing.assert_close(gain, torch.full((4,), sqrt(0.5), dtype=F64), rtol=0.01, atol=0)


def test_more_than_the_lag_allows_is_refused_with_what_it_does() -> None:
    with pytest.raises(ConfigError, match=r"attitude loop: a bandwidth of 60.0 rad/s .* at most (\S+), ") as refused:
        tune_attitude(vehicles(), bandwidth=60.0, damping=0.7, delay=0.01, dt=0.004)
    most = float(str(refused.value).split("at most ")[1].split(",")[0])
    tune_attitude(vehicles(), bandwidth=0.999 * most, damping=0.7, delay=0.01, dt=0.004)
    with pytest.raises(ConfigError, match="damping = 0.1: must be from 0.3 to 1.0"):
        tune_attitude(vehicles(), bandwidth=5.0, damping=0.1, delay=0.0, dt=0.004)
    with pytest.raises(ConfigError, match="bandwidth = -1.0 rad/s: must be > 0"):
        tune_attitude(vehicles(), bandwidth=-1.0, damping=0.7, delay=0.0, dt=0.004)


def lee_controller(robot: RobotCfg, *, dt: float = 0.01, control: ControlCfg | None = None) -> LeeController:
    vehicle = physics.vehicle_from_config(robot, num_envs=2, dtype=F64)
    control = robot.control if control is None else control
    return make_controller(CONTROLLERS.get("lee_position_control"), vehicle, 9.81, dt=dt, control=control)


@pytest.mark.parametrize("margin", [0.4, pi / 4, 1.1])
def test_the_loop_has_its_phase_margin_at_its_crossover_and_no_gain_has_more(margin: float) -> None:
    """Of ``(2 z w s + w²) / (s² (T s + 1))``: |L| = 1 and the phase are worked out here, on a grid of frequencies."""
    lag = 0.07
    frequency, damping = frequency_and_damping(lag, margin)

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
    vehicle = physics.vehicle_from_config(ROBOTS.get("tinyprop"), num_envs=1, dtype=F64)
    spare = 1.2 - 0.373 * 9.81 / 4
    expected = 4 * spare * torch.tensor([0.16, 0.16, 0.01], dtype=F64)
    torch.testing.assert_close(Allocation(vehicle, 9.81).torque_authority(0.373 * 9.81), expected)
    assert Allocation(vehicle, 9.81).largest_thrust() == pytest.approx(4.8)


@pytest.mark.parametrize("field", ["randomize", "rate_gain_low", "position_gain_high"])
def test_a_file_with_ranges_of_gains_is_told_where_they_went(field: str) -> None:
    gains = {"randomize": False} if field == "randomize" else {field: [1.0, 1.0, 1.0]}
    with pytest.raises(ConfigError) as e:
        build(ControlCfg, {"gains": gains}, where="robot.yaml: control")
    message = str(e.value)
    assert f"robot.yaml: control: gains: field {field!r} is gone: gains have no ranges of their own" in message
    way_out = message.split("randomize: {", 1)[1].rsplit("}", 1)[0]
    name, drawn = next(iter(yaml.safe_load(f"{{{way_out}}}").items()))
    assert name == "gains.position"
    assert build(RandomizeCfg, drawn, where="the message").how == "value"


def test_what_is_missing_or_impossible_is_named() -> None:
    vehicle = physics.vehicle_from_config(ROBOTS.get("tinyprop"), num_envs=1)
    with pytest.raises(ConfigError, match=r"derived from the time step. Give dt"):
        make_controller(CONTROLLERS.get("lee_rates_control"), vehicle, 9.81)
    with pytest.raises(ConfigError, match=r"ControlCfg.phase_margin = 1.6: must be > 0 and < pi/2"):
        ControlCfg(phase_margin=1.6)
    with pytest.raises(ConfigError, match=r"ControlCfg.attitude_frequency = \(1.0, nan, 1.0\)"):
        ControlCfg(attitude_frequency=(1.0, float("nan"), 1.0))
    with pytest.raises(ConfigError, match="ControllerCfg.allocation = 'none'"):
        ControllerCfg(summary="", law="rates", allocation="none")
