"""The closed loop at hover: eigenvalues against closed forms, and what is refused."""

import logging
from dataclasses import replace
from math import exp
from typing import Any

import pytest
import torch

from aerial_gym import ROBOTS, SIMS, physics
from aerial_gym.config.controller import ControlCfg, ControllerCfg, RateLoopCfg
from aerial_gym.config.randomize import RandomizeCfg
from aerial_gym.config.robot import RobotCfg
from aerial_gym.control import CONTROLLERS, check_closed_loop, linear_loop, make_controller
from aerial_gym.control.catalog import AERIAL_GYM_GAINS
from aerial_gym.control.stability import ClosedLoop, largest_stable_dt
from aerial_gym.errors import ConfigError
from aerial_gym.physics.law_memory import rotor_command_and_memory
from tests.builders import simulation

OWN_GAINS = [name for name in CONTROLLERS.names() if CONTROLLERS.get(name).gains is None]
LAWS = [name for name in OWN_GAINS if CONTROLLERS.get(name).law not in ("thrust", "rotor_speed", "pose")]
RATES = CONTROLLERS.get("lee_rates_control")


def radius(robot: RobotCfg, controller: ControllerCfg, dt: float) -> float:
    loop = ClosedLoop(robot, controller, gravity=9.81, integrator="euler", names=("r", "c"))
    return loop.spectral_radius(dt)


@pytest.mark.parametrize("law", LAWS)
@pytest.mark.parametrize("robot", ["base_quadrotor", "tinyprop", "neural_fly_quad", "crazyflie_2x_arpl"])
def test_registered_robots_come_to_rest_at_every_sim(law: str, robot: str) -> None:
    if robot == "neural_fly_quad" and law.startswith("crazyflie_"):
        pytest.skip("declares no yaw torque, and is refused (test_controller.py)")
    for sim in (SIMS.get(name) for name in SIMS):
        if (robot, law, sim.dt) == ("crazyflie_2x_arpl", "crazyflie_mellinger_control", 0.01):
            continue  # unstable about the rest that its integrals find: test_what_flies_at_500_hz_alone
        assert radius(ROBOTS.get(robot), CONTROLLERS.get(law), sim.dt) < 1.0


@pytest.mark.slow
@pytest.mark.parametrize("delay", [0.0, 0.0073])
def test_the_radius_of_a_controller_with_memory_is_that_of_a_flight(delay: float) -> None:
    """A small turn dies out by the radius in each step: over 400 steps, when the quicker modes are gone, by its 400th power."""
    loop = RateLoopCfg(rate_hz=100.0, derivative=(0.1, 0.1, 0.1), cutoff_hz=20.0)
    cfg = replace(CONTROLLERS.get("pid_rates_control"), rate_hz=50.0, rate_loop=loop, delay=0.01, action_delay=0.004)
    robot, backend, dt = ROBOTS.get("base_quadrotor"), physics.TorchBackend(), 0.002
    vehicle = physics.vehicle_from_config(robot, num_envs=1, dtype=torch.float64)
    late = (physics.EFFECTS.get("actuation_delay"), torch.tensor([[delay]], dtype=torch.float64))
    robot = replace(robot, effects={"actuation_delay": {"delay": delay}}, effects_source="test")
    backend.allocate(
        physics.build_model(vehicle, [late]), make_controller(cfg, vehicle, 9.81, dt=dt), integrator="euler"
    )
    state = physics.state_at_rest(1, 4, device=torch.device("cpu"), dtype=torch.float64)
    state.rotor_speed.fill_(physics.rotor_state_for_thrust(robot.rotor, 0.25 * 9.81 / 4))
    state.ang_vel.copy_(torch.tensor([[0.0, 0.0, 1e-3]], dtype=torch.float64))
    sizes = []
    for steps in (1600, 400):
        backend.step(state, torch.zeros(1, 4, dtype=torch.float64), dt, steps)
        sizes.append(float(state.ang_vel[0, 2]))
    assert (sizes[1] / sizes[0]) ** (1 / 400) == pytest.approx(radius(robot, cfg, dt), abs=2e-5)


def test_a_long_period_costs_its_different_steps_alone(monkeypatch: pytest.MonkeyPatch) -> None:
    """160 steps: law and loop run in one, the loop in every 8th, and half a period later the wish comes through."""
    flown: list[object] = []

    def count_call(*given: Any) -> Any:
        flown.append(given)
        return rotor_command_and_memory(*given)

    monkeypatch.setattr(linear_loop, "rotor_command_and_memory", count_call)
    loop = RateLoopCfg(rate_hz=1000.0)
    cfg = replace(CONTROLLERS.get("pid_position_control"), rate_hz=50.0, rate_loop=loop, delay=0.01)
    assert radius(ROBOTS.get("base_quadrotor"), cfg, 1.0 / 8000.0) < 1.0
    assert len(flown) == 1 + 2 * 5  # at rest, then each different step and its derivatives


def test_largest_stable_time_step_is_where_the_radius_is_one() -> None:
    """One number that is multiplied by ``1 - 40 dt`` in each step is stable below dt = 0.05 s."""
    result = largest_stable_dt(lambda dt: abs(1.0 - 40.0 * dt), 0.2)
    assert result == pytest.approx(0.05, rel=1e-5)
    assert largest_stable_dt(lambda dt: 1.0 + dt, 0.2) is None


def test_frequencies_that_the_rotor_lag_forbids_are_refused_with_the_largest_time_step() -> None:
    control = ControlCfg(attitude_frequency=(30.0, 30.0, 2.0), attitude_damping=(2.0, 2.0, 1.0))
    robot = replace(ROBOTS.get("base_quadrotor"), control=control)
    law = CONTROLLERS.get("lee_attitude_control")
    with pytest.raises(ConfigError) as e:
        check_closed_loop(robot, law, gravity=9.81, dt=0.05, integrator="euler", names=("fast", "att"))
    largest = float(str(e.value).split("6 dB is ")[1].split(" s")[0])
    loop = ClosedLoop(robot, law, gravity=9.81, integrator="euler", names=("fast", "att"))
    assert (
        max(loop.spectral_radii_at_loop_gains(0.99 * largest))
        < 1.0
        < max(loop.spectral_radii_at_loop_gains(1.01 * largest))
    )
    assert loop.spectral_radius(1.01 * largest) < 1.0
    assert loop.is_stable(largest / 0.9)


def test_a_gain_margin_is_that_of_the_two_by_two() -> None:
    """``dt (1 - d) K < 2 (1 + d)`` of a rate loop: twice K is stable up to half of that, and not beyond."""
    robot, dt, decay = ROBOTS.get("base_quadrotor"), 0.01, exp(-0.25)
    limit = 2.0 * (1.0 + decay) / (dt * (1.0 - decay))  # of 2 z w [1/s]
    for share, firm in ((0.49, True), (0.51, False), (0.99, False)):
        quick = 0.5 * share * limit
        control = ControlCfg(attitude_frequency=(quick, quick, 1.0), attitude_damping=(1.0, 1.0, 1.0))
        tuned = replace(robot, control=control)
        loop = ClosedLoop(tuned, RATES, gravity=9.81, integrator="euler", names=("quad", "r"))
        assert loop.is_stable(dt)
        assert loop.is_stable_with_margin(dt) is firm
        check_closed_loop(tuned, RATES, gravity=9.81, dt=dt, integrator="euler", names=("quad", "r"))


def test_what_flies_at_500_hz_alone_is_refused_at_100_hz() -> None:
    """Rotors that follow at once: about the rest that its integrals find, Mellinger's law is unstable from 9.9 ms on."""
    robot, law = ROBOTS.get("crazyflie_2x_arpl"), CONTROLLERS.get("crazyflie_mellinger_control")
    assert radius(robot, law, 0.0095) < 1.0 < radius(robot, law, 0.01)
    with pytest.raises(ConfigError):
        check_closed_loop(robot, law, gravity=9.81, dt=0.01, integrator="euler", names=("crazyflie_2x_arpl", "it"))
    for dt in (0.002, 0.004):
        check_closed_loop(robot, law, gravity=9.81, dt=dt, integrator="euler", names=("crazyflie_2x_arpl", "it"))


def test_gains_that_do_not_hold_a_vehicle_are_refused_with_the_way_out(caplog: pytest.LogCaptureFixture) -> None:
    """A name that means the gains of another robot, and one set of gains for every robot: a Crazyflie flew 101 m away."""
    robot = ROBOTS.get("crazyflie_21")
    everybodys = replace(CONTROLLERS.get("lee_position_control"), gains=AERIAL_GYM_GAINS)
    for law in (CONTROLLERS.get("lmf2_position_control"), everybodys):
        with pytest.raises(ConfigError, match='if_unstable="warn"') as e:
            check_closed_loop(robot, law, gravity=9.81, dt=0.01, integrator="euler", names=("crazyflie_21", "p"))
        assert not caplog.records
        with caplog.at_level(logging.WARNING):
            anyway = replace(law, if_unstable="warn")
            check_closed_loop(robot, anyway, gravity=9.81, dt=0.01, integrator="euler", names=("crazyflie_21", "p"))
        (record,) = caplog.records
        assert record.getMessage() == str(e.value)
        caplog.clear()
    with pytest.raises(ConfigError, match="if_unstable = 'fly'"):
        replace(everybodys, if_unstable="fly")


def test_gains_about_an_axis_without_torque_are_refused() -> None:
    """Drawn headings stay as they are, and a vehicle that faced the other way was 1.3 m away after 10 s."""
    robot, law = ROBOTS.get("neural_fly_quad"), CONTROLLERS.get("lmf2_position_control")
    kind = {"gravity": 9.81, "dt": 0.01, "integrator": "euler", "names": ("neural_fly_quad", "p")}
    with pytest.raises(ConfigError, match="the explicit gains control yaw, but its rotors give no torque there"):
        check_closed_loop(robot, law, **kind)
    roll, pitch, _ = law.gains.attitude
    check_closed_loop(robot, replace(law, gains=replace(law.gains, attitude=(roll, pitch, 0.0))), **kind)
    check_closed_loop(robot, CONTROLLERS.get("lmf2_velocity_control"), **kind)


WIDE = {"gains.rate": RandomizeCfg(how="value", low=0.0, high=(0.3, 0.3, 0.2))}
FIRM = replace(CONTROLLERS.get("lee_position_control"), gains=AERIAL_GYM_GAINS, if_unstable="warn")


def check(controller: ControllerCfg, randomize: dict[str, RandomizeCfg], dt: float = 0.01) -> None:
    robot, kind = ROBOTS.get("base_quadrotor"), {"gravity": 9.81, "integrator": "euler", "names": ("quad", "p")}
    check_closed_loop(robot, controller, dt=dt, randomize=randomize, **kind)


def test_what_is_drawn_about_explicit_gains_can_cause_a_warning(caplog: pytest.LogCaptureFixture) -> None:
    with caplog.at_level(logging.WARNING):
        check(FIRM, {})
        check(FIRM, {"gains.rate": RandomizeCfg(how="offset", low=-0.01, high=0.01)})
        assert not caplog.records
        check(FIRM, WIDE)
    (record,) = caplog.records
    assert "gains.rate" in record.getMessage()


def test_what_is_drawn_about_derived_gains_is_refused_with_the_largest_time_step() -> None:
    """The two by two of a rate loop has determinant d and trace ``1 + d - dt (1 - d) K``: ``dt (1 - d) K < 2 (1 + d)``."""
    strong, tau = RandomizeCfg(how="value", low=0.01, high=(0.6, 0.6, 0.01)), 0.04
    check(RATES, {"gains.rate": RandomizeCfg(low=0.8, high=1.2)}, 0.02)
    with pytest.raises(ConfigError, match="gains.rate") as e:
        check(RATES, {"gains.rate": strong}, 0.02)
    largest = float(str(e.value).split("6 dB is ")[1].split(" s")[0])
    decay = exp(-largest / tau)
    # The message gives three figures.
    assert largest * (1.0 - decay) * 0.6 / 4.225e-4 == pytest.approx(2.0 * (1.0 + decay), rel=0.02)
    check(RATES, {"gains.rate": strong}, 0.99 * largest)


def test_the_ends_of_gains_are_combined(caplog: pytest.LogCaptureFixture) -> None:
    """A strong attitude alone comes to rest, a weak rate as well, both do not: Routh's ``k_w > T k_R`` of ``s² (T s + 1)``."""
    strong = {"gains.attitude": RandomizeCfg(low=1.0, high=2.0)}
    weak = {"gains.rate": RandomizeCfg(low=0.4, high=1.0)}
    with caplog.at_level(logging.WARNING):
        check(FIRM, strong)
        check(FIRM, weak)
        assert not caplog.records
        check(FIRM, strong | weak)
    assert "gains.attitude, gains.rate" in caplog.records[0].getMessage()


def test_an_untruncated_normal_gain_is_judged_where_its_draws_end(caplog: pytest.LogCaptureFixture) -> None:
    """5.4 standard deviations: with 0.02 of 1 there is nothing to warn of, with 2 the ends are far out."""
    with caplog.at_level(logging.WARNING):
        check(FIRM, {"gains.rate": RandomizeCfg(distribution="normal", mean=1.0, std=0.02, low=0.5)})
        assert not caplog.records
        check(FIRM, {"gains.rate": RandomizeCfg(distribution="normal", mean=1.0, std=2.0, low=0.5)})
    assert len(caplog.records) == 1


def test_a_robot_that_cannot_hover_is_refused() -> None:
    robot = ROBOTS.get("tinyprop")
    heavy = replace(robot, body=replace(robot.body, mass=0.6))
    with pytest.raises(ConfigError, match=r"robot 'heavy' cannot hover under controller 'c': its rotors need"):
        check_closed_loop(heavy, RATES, gravity=9.81, dt=0.01, integrator="euler", names=("'heavy'", "'c'"))


def test_a_simulation_is_refused_when_it_is_built() -> None:
    robot = replace(ROBOTS.get("base_quadrotor"), control=ControlCfg(attitude_frequency=(80.0, 80.0, 2.0)))
    with pytest.raises(ConfigError, match=r"robot '0.25 kg.*' with controller 'lee_velocity_control' at dt = 0.01 s"):
        simulation(robot, "lee_velocity_control", num_envs=1)
