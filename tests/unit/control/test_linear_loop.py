"""The linearised loop against closed forms, and what is refused, warned of and accepted before a flight."""

import logging
from dataclasses import replace
from math import exp

import numpy as np
import pytest
import torch

from aerial_gym.config.controller import ControlCfg
from aerial_gym.config.robot import RobotCfg
from aerial_gym.control import CONTROLLERS, check_closed_loop, make_controller
from aerial_gym.control.allocation import Allocation
from aerial_gym.control.hover import HOVER_RANGE, HOVER_SPAN
from aerial_gym.control.stability import ClosedLoop
from aerial_gym.errors import ConfigError
from aerial_gym.math.quaternion import quat_exp
from aerial_gym.physics import EFFECTS, BodyState, TorchBackend, build_model, vehicle_from_config
from aerial_gym.robots import ROBOTS

GRAVITY, DT, TAU = 9.81, 0.01, 0.04
QUAD = ROBOTS.get("base_quadrotor")
RATES, POSITION = CONTROLLERS.get("lee_rates_control"), CONTROLLERS.get("lee_position_control")
FREQUENCY = 6.0
QUICK = ControlCfg(attitude_frequency=(FREQUENCY, FREQUENCY, 1.0), attitude_damping=(1.0, 1.0, 1.0))
TUNED = replace(QUAD, control=QUICK)


def with_effects(robot: RobotCfg, **effects: dict[str, float]) -> RobotCfg:
    return replace(robot, effects=effects, effects_source="test")


def make_loop(robot: RobotCfg, controller: str = "lee_position_control") -> ClosedLoop:
    cfg = CONTROLLERS.get(controller)
    return ClosedLoop(robot, cfg, gravity=GRAVITY, integrator="euler", names=("robot", controller))


def position_gain(robot: RobotCfg) -> float:
    vehicle = vehicle_from_config(robot, num_envs=1, dtype=torch.float64)
    law = make_controller(POSITION, vehicle, GRAVITY, dt=DT, control=robot.control)
    return float(law.gains.position[0, 2])


def late_rate_radius(gain: float, steps: float) -> float:
    """Return the spectral radius of ``n' = d n + a u_w + b u_(w+1)``, ``p' = p + dt n'``, ``u = -K p`` with a late u."""
    whole, part = int(steps), steps - int(steps)
    early, rest = exp(-part * DT / TAU), exp(-(1.0 - part) * DT / TAU)
    matrix = np.zeros((whole + 3, whole + 3))
    slopes = np.zeros(whole + 3)  # of n' per p, n and commands on their way, newest first
    slopes[1] = early * rest
    for age, weight in ((whole, 1.0 - rest), (whole + 1, (1.0 - early) * rest)):
        if age == 0:
            slopes[0] -= weight * gain
        else:
            slopes[1 + age] += weight
    matrix[1], matrix[0] = slopes, DT * slopes
    matrix[0, 0] += 1.0
    matrix[2, 0] = -gain
    for age in range(1, whole + 1):
        matrix[2 + age, 1 + age] = 1.0
    return float(abs(np.linalg.eigvals(matrix)).max())


@pytest.mark.parametrize("steps", [0.0, 0.3, 1.0, 2.0, 3.6, 9.25])
def test_the_radius_of_a_late_rate_loop_is_that_of_its_delay_states(steps: float) -> None:
    late = with_effects(TUNED, actuation_delay={"delay": steps * DT})
    expected = max(late_rate_radius(2.0 * FREQUENCY, steps), late_rate_radius(2.0, steps))
    assert make_loop(late, "lee_rates_control").spectral_radius(DT) == pytest.approx(expected, abs=1e-6)


def test_a_lag_that_differs_up_and_down_counts_as_the_mean_of_its_decays() -> None:
    """``n' = d n + (1 - d) u`` with ``d = (exp(-dt / 0.02) + exp(-dt / 0.08)) / 2``: half of a swing is up, half is down."""
    rotor = replace(QUAD.the_rotor("a test"), time_constant_up=0.02, time_constant_down=0.08)
    robot = replace(TUNED, rotor=rotor)
    decay = 0.5 * (exp(-DT / 0.02) + exp(-DT / 0.08))

    def radius(gain: float) -> float:
        matrix = [[decay, -(1.0 - decay) * gain], [decay * DT, 1.0 - DT * (1.0 - decay) * gain]]
        return float(abs(np.linalg.eigvals(matrix)).max())

    expected = max(radius(2.0 * FREQUENCY), radius(2.0))
    assert make_loop(robot, "lee_rates_control").spectral_radius(DT) == pytest.approx(expected, abs=1e-6)


@pytest.mark.parametrize("factor", [0.7, 1.3])
def test_a_law_without_an_integrator_rests_beside_its_setpoint(factor: float) -> None:
    """``s m (g + k e) = m g`` of thrust that is s times the declared: ``e = g (1 / s - 1) / k`` below the setpoint."""
    rest = make_loop(with_effects(QUAD, thrust_coefficient={"scale": factor})).equilibrium(DT)
    expected = -GRAVITY * (1.0 / factor - 1.0) / position_gain(QUAD)
    assert rest.converged.all()
    assert rest.offset_from_start[0].tolist() == pytest.approx([0.0, 0.0, expected], abs=1e-6)


def test_a_law_that_knows_the_actual_thrust_rests_at_its_setpoint() -> None:
    robot = replace(QUAD, control=replace(QUAD.control, effectiveness="actual"))
    loop = make_loop(with_effects(robot, thrust_coefficient={"scale": 0.8}))
    assert loop.equilibrium(DT).offset_from_start[0].tolist() == pytest.approx([0.0, 0.0, 0.0], abs=1e-6)
    assert loop.hover(DT).is_within_range


def test_a_velocity_law_drifts() -> None:
    """``s m (g - k v) = m g`` of a gain k on the velocity: ``v = g (1 - 1 / s) / k`` upwards, and so far in 10 s."""
    robot = with_effects(QUAD, thrust_coefficient={"scale": 1.01})
    vehicle = vehicle_from_config(QUAD, num_envs=1, dtype=torch.float64)
    law = make_controller(CONTROLLERS.get("lee_velocity_control"), vehicle, GRAVITY, dt=DT, control=QUAD.control)
    expected = GRAVITY * (1.0 - 1.0 / 1.01) / float(law.gains.velocity[0, 2])
    hover = make_loop(robot, "lee_velocity_control").hover(DT)
    assert hover.drift == pytest.approx((0.0, 0.0, expected), abs=1e-6)
    assert 0.8 * expected * HOVER_SPAN < hover.distance < expected * HOVER_SPAN


def test_an_integrator_brings_the_rest_to_the_setpoint() -> None:
    rest = make_loop(with_effects(QUAD, thrust_coefficient={"scale": 0.9}), "px4_position_control").equilibrium(DT)
    assert rest.converged.all()
    assert rest.offset_from_start[0].tolist() == pytest.approx([0.0, 0.0, 0.0], abs=1e-4)


def test_random_wind_and_later_failures_are_left_out_and_failures_from_the_start_are_not() -> None:
    calm = make_loop(QUAD).spectral_radius(DT)
    gusts = with_effects(QUAD, gusts={"std": 3.0, "corr_time": 1.0}, rotor_drag={"dx": 0.0, "dy": 0.0, "dz": 0.0})
    later = with_effects(QUAD, motor_failure={"motor": 1.0, "scale": 0.9, "time": 5.0})
    for robot in (gusts, later):
        assert make_loop(robot).spectral_radius(DT) == pytest.approx(calm, abs=1e-9)
    failed = with_effects(QUAD, motor_failure={"motor": 1.0, "scale": 0.98, "time": 0.0})
    assert float(make_loop(failed).equilibrium(DT).offset_from_start[0].norm()) > 0.01


def test_slew_limited_rotors_are_flown() -> None:
    """30 rad/s² lose a start with a lean of 0.1 rad, which 2000 rad/s² do not; small disturbances meet neither limit."""
    rotor = QUAD.the_rotor("a test")
    for slew, lost in ((2000.0, False), (30.0, True)):
        robot = replace(QUAD, rotor=replace(rotor, slew_rate=slew, slew_rate_down=slew))
        hover = make_loop(robot).hover(DT)
        assert hover.stable
        assert hover.is_lost is lost


F64 = torch.float64
CHECK_DT, DOWN = 0.01, 9.81


def is_refused(robot: str, controller: str, effects: dict[str, dict[str, float]]) -> bool:
    cfg = replace(ROBOTS.get(robot), effects=effects, effects_source="test")
    law, names = CONTROLLERS.get(controller), (robot, controller)
    try:
        check_closed_loop(cfg, law, gravity=DOWN, dt=CHECK_DT, integrator="euler", names=names)
    except ConfigError:
        return True
    return False


def last_ways(robot: str, controller: str, delays: list[float]) -> list[float]:
    """Return the way [m] that vehicles go between 6 and 7 s after a start with a lean of 0.1 rad and 0.2 m/s."""
    cfg, law_cfg, rows = ROBOTS.get(robot), CONTROLLERS.get(controller), len(delays)
    vehicle = vehicle_from_config(cfg, num_envs=rows, dtype=F64)
    law = make_controller(law_cfg, vehicle, DOWN, dt=CHECK_DT, control=cfg.control)
    late = (EFFECTS.get("actuation_delay"), torch.tensor(delays, dtype=F64).unsqueeze(-1))
    backend, turn, weight = TorchBackend(), torch.zeros(rows, 3, dtype=F64), torch.zeros(rows, 6, dtype=F64)
    turn[:, 0], weight[:, 2] = 0.1, cfg.body.mass * DOWN
    state = BodyState(
        position=torch.zeros_like(turn), attitude=quat_exp(turn), lin_vel=0.2 * torch.ones_like(turn),
        ang_vel=0.2 * torch.ones_like(turn), rotor_speed=Allocation(vehicle, DOWN).speed_for_wrench(weight),
    )  # fmt: skip
    backend.allocate(build_model(vehicle, [late]), law, integrator="euler")
    action = torch.zeros(rows, len(law.action_names), dtype=F64)
    backend.step(state, action, CHECK_DT, 600)
    before = state.position.clone()
    backend.step(state, action, CHECK_DT, 100)
    return (state.position - before).norm(dim=-1).tolist()


@pytest.mark.parametrize(("robot", "controller", "held", "lost"), [
    ("crazyflie_21", "crazyflie_lee_control", [0.0, 0.005], [0.01]),
    ("magpie", "pid_velocity_control", [0.0, 0.005], [0.01]),
])  # fmt: skip
def test_what_flies_away_is_refused_and_what_hovers_is_not(robot, controller, held, lost) -> None:
    """Dead times [s] on both sides of the limit; the first two robots were 17 and 29 m away with 10 ms."""
    ways = last_ways(robot, controller, held + lost)
    for delay, way in zip(held + lost, ways, strict=True):
        assert (way > HOVER_RANGE) is (delay in lost)
        assert is_refused(robot, controller, {"actuation_delay": {"delay": delay}}) is (delay in lost)


@pytest.mark.slow
def test_a_limit_cycle_that_holds_its_place_causes_a_warning(caplog: pytest.LogCaptureFixture) -> None:
    with caplog.at_level(logging.WARNING):
        assert not is_refused("crazyflie_2x_arpl", "crazyflie_pid_control", {"actuation_delay": {"delay": 0.0156}})
    assert len(caplog.records) == 1


def test_effects_that_a_law_does_not_know_cause_a_warning(caplog: pytest.LogCaptureFixture) -> None:
    payload = {"payload_mass": {"dm": 0.02}}
    with caplog.at_level(logging.WARNING):
        assert not is_refused("base_quadrotor", "lee_position_control", payload)
        (record,) = caplog.records
        assert "payload_mass" in record.getMessage()
        caplog.clear()
        assert not is_refused("base_quadrotor", "lee_attitude_control", payload)
        assert not is_refused("base_quadrotor", "lee_position_control", {"payload_mass": {"dm": 1e-4}})
        drag = {"rotor_drag": {"dx": 0.1, "dy": 0.1, "dz": 0.1}}
        assert not is_refused("base_quadrotor", "lee_position_control", drag)
    assert not caplog.records


def test_what_cannot_be_lifted_is_refused_unless_asked_to_warn(caplog: pytest.LogCaptureFixture) -> None:
    weak = {"thrust_coefficient": {"scale": 0.3}}
    assert is_refused("base_quadrotor", "lee_position_control", weak)
    robot = replace(ROBOTS.get("base_quadrotor"), effects=weak, effects_source="test")
    anyway = replace(CONTROLLERS.get("lee_position_control"), if_unstable="warn")
    with caplog.at_level(logging.WARNING):
        check_closed_loop(robot, anyway, gravity=DOWN, dt=CHECK_DT, integrator="euler", names=("weak", "it"))
    assert len(caplog.records) == 1
