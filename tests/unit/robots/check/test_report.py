"""Numbers of a robot against those worked out by hand, and what is said of robots that cannot be."""

from dataclasses import replace
from math import atan, cos, sin, tan

import numpy as np
import pytest
from scipy.optimize import linprog

from aerial_gym import CONTROLLERS, ROBOTS
from aerial_gym.config.checks import NO_SOURCE
from aerial_gym.config.robot import BodyCfg, MountCfg, RobotCfg
from aerial_gym.control.stability import ClosedLoop
from aerial_gym.errors import ConfigError, UnknownNameError
from aerial_gym.robots.check import RobotReport, check_robot, flights, largest_stable_step
from aerial_gym.robots.check.flights import STEP_RANGE


def make_report(robot: RobotCfg) -> RobotReport:
    return check_robot(robot, name="it", controllers=())


def with_mounts(robot: RobotCfg, *mounts: MountCfg) -> RobotCfg:
    return replace(robot, mounts=replace(robot.mounts, layout=mounts))


def test_a_flat_quadrotor_is_what_is_worked_out_by_hand() -> None:
    """Each rotor of lmf1 carries m g / 4 of 20 N and can give up all of it: 4 h a about x, and 4 h k about z. Downwards
    there is the same room as the weight, upwards more, and it is the lesser that is given both ways."""
    report, hover = make_report(ROBOTS.get("lmf1")), 1.235 * 9.81 / 4.0
    assert report.hover_thrust_n == pytest.approx((hover,) * 4)
    assert report.hover_share == pytest.approx(hover / 20.0)
    assert report.thrust_to_weight == pytest.approx(20.0 / hover)
    assert report.rank == 4
    assert report.force_n == pytest.approx((0.0, 0.0, 4.0 * hover), abs=1e-9)
    assert report.torque_n_m == pytest.approx((0.4 * hover, 0.4 * hover, 0.2 * hover))
    turn = (0.4 * hover / 0.013404, 0.4 * hover / 0.014404, 0.2 * hover / 0.013804)
    assert report.angular_acceleration_rad_s2 == pytest.approx(turn)
    assert report.first_at_limit[:2] == (None, None)
    assert report.problems == report.warnings == ()


def test_the_rotor_that_ends_an_axis_is_named() -> None:
    """Where three rotors give 20 N and the third 3.2 N, that one ends all that turns or lifts."""
    robot = ROBOTS.get("lmf1")
    weak, strong = (replace(robot.rotor, thrust_range=(0.0, most)) for most in (3.2, 20.0))
    layout = tuple(replace(mount, rotor="weak" if i == 2 else "strong") for i, mount in enumerate(robot.mounts.layout))
    mounts, rotors = replace(robot.mounts, layout=layout), {"weak": weak, "strong": strong}
    report = make_report(replace(robot, mounts=mounts, rotor=None, rotors=rotors))
    assert report.first_at_limit == (None, None, 3, 3, 3, 3)
    assert report.thrust_to_weight == pytest.approx(4.0 * 3.2 / (1.235 * 9.81))


def test_only_tilted_rotors_push_sideways() -> None:
    """About 30 degrees each: with one newton of hover thrust per rotor some of them at most half of that to the side."""
    flat, tilted = (make_report(ROBOTS.get(name)) for name in ("typhoon_hexarotor", "tilted_hexarotor"))
    assert (flat.rank, tilted.rank) == (4, 6)
    assert flat.force_n[:2] == (0.0, 0.0)
    assert min(tilted.force_n[:2]) > 0.2 * tilted.mass_kg * 9.81
    assert max(tilted.force_n[:2]) < 0.5 * sum(tilted.hover_thrust_n)


def test_a_centre_of_mass_beyond_the_rotors_cannot_hover() -> None:
    """0.05 m before the front rotors, 0.25 m before the rear ones: 0.05 f + 0.25 b = 0, 2 f + 2 b = m g, so b = -m g / 8."""
    robot = ROBOTS.get("lmf1")
    report = make_report(replace(robot, body=replace(robot.body, com=(0.15, 0.0, 0.0))))
    assert len(report.problems) == 2
    assert "rotor 2 must give -1.51 N, but its limits are 0 to 20 N" in report.problems[0]
    assert report.stable_steps == ()


def test_a_torque_that_nothing_takes_away_is_a_problem() -> None:
    robot = ROBOTS.get("lmf1")
    places = ((0.1, 0.0, 0.0), (-0.05, 0.0866, 0.0), (-0.05, -0.0866, 0.0))
    report = make_report(with_mounts(robot, *(MountCfg(position=place, spin=1) for place in places)))
    assert len(report.problems) == 2
    assert "a torque about z of -0.606 N m is left over" in report.problems[0]  # 0.05 m of 1.235 * 9.81 N
    assert "lift and torque about z come only together" in report.problems[1]
    assert report.rank == 3


def test_numbers_in_other_units_are_noticed() -> None:
    robot = ROBOTS.get("racing_quadrotor")
    assert make_report(robot).warnings == ()
    inertia = tuple(tuple(1e3 * n for n in row) for row in robot.body.inertia)
    in_grams = replace(robot, body=replace(robot.body, inertia=inertia))
    assert "radius of gyration 1.82 m, but the vehicle reaches" in make_report(in_grams).warnings[0]
    per_turn = replace(robot, rotor=replace(robot.rotor, thrust_map=(0.0, 0.0, 1.562522e-6 / 39.4784)))
    assert "tips would move at 931 m/s, faster than sound" in make_report(per_turn).warnings[0]
    wide = replace(robot, rotor=replace(robot.rotor, radius=0.08))
    assert "propellers 1 and 3 overlap by 0.01 m" in make_report(wide).warnings[0]
    heavy = replace(robot, body=replace(robot.body, mass=2.8))
    assert "thrust to weight is 1.24" in make_report(heavy).warnings[0]


def test_what_cannot_be_is_refused_with_a_way_out() -> None:
    rows = ((0.0347563, 0.0, 0.0), (0.0, 0.0458929, 0.0), (0.0, 0.0, 0.0977))
    with pytest.raises(ConfigError, match=r"triangle inequality.*check digits and units"):
        BodyCfg(mass=1.5, inertia=rows, source="RotorS, firefly.xacro")
    with pytest.raises(UnknownNameError, match="Did you mean 'lee_position_control'"):
        check_robot(ROBOTS.get("lmf1"), name="it", controllers=("lee_positon_control",))


def test_a_tail_on_a_servo_gives_the_torque_about_z() -> None:
    """Hover in closed form: ``tan d = k / L``, each front rotor ``T (cos d + k sin d / L)``; the lean takes the side force.
    What it gives is the optimum of a linear program: thrusts within their limits, the tail within its angles (0.7 rad)."""
    report = make_report(ROBOTS.get("tilt_tricopter"))
    arm, ratio, weight = 0.2460732, 0.025, 1.592 * 9.81
    angle = atan(ratio / arm)
    tail = weight / (3.0 * cos(angle) + 2.0 * ratio * sin(angle) / arm)
    front = tail * (cos(angle) + ratio * sin(angle) / arm)
    assert report.hover_thrust_n == pytest.approx((front, front, tail), rel=1e-6)
    assert (report.rank, report.problems, report.stable_steps) == (4, (), ())
    assert f"leans by {angle:.3g} rad" in report.warnings[0]
    assert f"the vehicle by {-atan(tail * sin(angle) / weight):.3g} rad" in report.warnings[0]

    side = [0.2131056, 0.1230366]  # of the front rotors: y, x
    lift = [1.0, 1.0, 1.0, 0.0]
    roll = [-side[0], side[0], 0.0, 0.0]
    pitch = [-side[1], -side[1], arm, ratio]
    yaw = [-ratio, ratio, -ratio, arm]
    servo = [[0.0, 0.0, -tan(0.7), 1.0], [0.0, 0.0, -tan(0.7), -1.0]]  # within the range both ways
    for axis, result in enumerate((report.force_n[2], *report.torque_n_m)):
        step = -np.eye(4)[:, [axis]]
        fixed = {
            "A_ub": np.hstack((servo, np.zeros((2, 1)))), "b_ub": [0.0, 0.0], "b_eq": [weight, 0.0, 0.0, 0.0],
            "bounds": [(0.0, 20.0)] * 2 + [(0.0, 20.0 * cos(0.7)), (None, None), (0.0, None)],
        }  # fmt: skip
        ways = (np.hstack(([lift, roll, pitch, yaw], way * step)) for way in (1.0, -1.0))
        most = [linprog([0.0, 0.0, 0.0, 0.0, -1.0], A_eq=equations, **fixed).x[4] for equations in ways]
        assert result == pytest.approx(min(most), rel=1e-6)


@pytest.mark.slow
def test_published_gains_are_stable_up_to_the_linear_limit() -> None:
    """magpie has gains of its own, whatever the time step; the search is to 1 % of it, with a gain margin of 6 dB."""
    robot, controller = ROBOTS.get("magpie"), CONTROLLERS.get("lee_attitude_control")
    result = largest_stable_step(robot, controller, name="lee_attitude_control")
    loop = ClosedLoop(robot, controller, gravity=9.81, integrator="euler", names=("magpie", "lee_attitude_control"))
    assert result.largest_s == pytest.approx(loop.largest_dt_with_margin(1.0), rel=0.02)
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
    servo = flights.make_tail_servo(robot, 0.1, 9.81)
    monkeypatch.setattr(flights, "make_tail_servo", lambda *_: replace(servo, heading=-servo.heading))
    monkeypatch.setattr(flights, "STEP_RANGE", (0.05, 0.1))
    result = largest_stable_step(robot, controller, name="it")
    assert (result.largest_s, result.refused) == (None, None)


def test_numbers_without_a_source_are_named() -> None:
    robot = ROBOTS.get("base_quadrotor")
    bare = replace(
        robot,
        body=replace(robot.body, source=NO_SOURCE),
        effects={"constant_wind": {"x": 0.0, "y": 0.0, "z": 0.0}},
        effects_source="",
    )
    named = [each for each in check_robot(bare, name="bare", controllers=()).warnings if each.startswith("no source")]
    assert named == [
        "no source of the numbers of body, effects: say where they come from (source: data sheet, scale, ...)"
    ]
    assert not [each for each in check_robot(robot, name="own", controllers=()).warnings if "no source" in each]
