"""The largest stable time step, flown, against the linearised loop, which shares nothing of the flight but the law."""

from dataclasses import replace

import pytest

from aerial_gym import CONTROLLERS, ROBOTS
from aerial_gym.control.stability import ClosedLoop
from aerial_gym.robots.check import flights, largest_stable_step
from aerial_gym.robots.check.flights import STEP_RANGE


@pytest.mark.slow
def test_published_gains_are_stable_up_to_the_linear_limit() -> None:
    """magpie has gains of its own, whatever the time step; the search is to 1 % of it, with a gain margin of 6 dB."""
    robot, controller = ROBOTS.get("magpie"), CONTROLLERS.get("lee_attitude_control")
    result = largest_stable_step(robot, controller, name="lee_attitude_control")
    loop = ClosedLoop(robot, controller, gravity=9.81, integrator="euler", names=("magpie", "lee_attitude_control"))
    assert result.largest_s == pytest.approx(loop.largest_firm_dt(1.0), rel=0.02)
    assert not result.at_least


def test_a_slow_integrator_is_not_taken_for_unfit(monkeypatch: pytest.MonkeyPatch) -> None:
    """450 mm, 1.3 kg, rotors of 80 ms: PX4's integral takes 18 s, and holds the vehicle within 3 cm meanwhile."""
    base = ROBOTS.get("base_quadrotor")
    layout = tuple(replace(mount, position=tuple(1.22 * x for x in mount.position)) for mount in base.mounts.layout)
    motor = replace(base.rotor, thrust_range=(0.0, 6.4), time_constant_up=0.08, time_constant_down=0.08)
    inertia = ((0.012, 0.0, 0.0), (0.0, 0.012, 0.0), (0.0, 0.0, 0.022))
    body = replace(base.body, mass=1.3, inertia=inertia)
    robot = replace(base, body=body, mounts=replace(base.mounts, layout=layout), rotor=motor)
    monkeypatch.setattr(flights, "STEP_RANGE", (0.01, 0.02))
    result = largest_stable_step(robot, CONTROLLERS.get("px4_position_control"), name="it")
    assert (result.largest_s, result.at_least, result.little_margin) == (0.02, True, False)


def test_derived_gains_follow_the_time_step() -> None:
    result = largest_stable_step(ROBOTS.get("lmf1"), CONTROLLERS.get("lee_attitude_control"), name="it")
    assert (result.largest_s, result.at_least) == (STEP_RANGE[1], True)


@pytest.mark.slow
def test_gains_that_hold_nothing_have_no_step() -> None:
    robot = ROBOTS.get("magpie")
    loose = replace(robot.control, gains=replace(robot.control.gains, rate=(0.0, 0.0, 0.0388)))
    result = largest_stable_step(replace(robot, control=loose), CONTROLLERS.get("lee_attitude_control"), name="it")
    assert (result.largest_s, result.refused) == (None, None)


def test_gusts_are_left_out_and_a_hung_load_is_not() -> None:
    """In its own gusts of 3 m/s this robot is never at rest; the load pulls the other one to a rest below hover."""
    controller = CONTROLLERS.get("lee_velocity_control")
    for name in ("base_quadrotor_in_gusts", "base_quadrotor_with_payload"):
        assert largest_stable_step(ROBOTS.get(name), controller, name="it").at_least


def test_a_controller_that_holds_nothing_is_refused() -> None:
    result = largest_stable_step(ROBOTS.get("lmf1"), CONTROLLERS.get("no_control"), name="no_control")
    assert result.refused == "commands rotors, and holds nothing"


@pytest.mark.slow
def test_a_tail_flies_on_its_servo_and_one_that_leans_the_wrong_way_does_not_rest(monkeypatch) -> None:
    robot, controller = ROBOTS.get("tilt_tricopter"), CONTROLLERS.get("lee_attitude_control")
    assert largest_stable_step(robot, controller, name="it").at_least
    servo = flights.make_tail(robot, 0.1, 9.81)
    monkeypatch.setattr(flights, "make_tail", lambda *_: replace(servo, heading=-servo.heading))
    monkeypatch.setattr(flights, "STEP_RANGE", (0.05, 0.1))
    result = largest_stable_step(robot, controller, name="it")
    assert (result.largest_s, result.refused) == (None, None)
