"""Robot files that come with the package: each is registered, and numbers derived from another robot's are what they say."""

from math import cos, pi, sin

import numpy as np
import pytest

from aerial_gym.config import CONFIG_DIR
from aerial_gym.config.robot import RobotCfg
from aerial_gym.config.sim import STANDARD_GRAVITY
from aerial_gym.robots import ROBOTS


def test_every_file_is_a_registered_robot_and_every_robot_has_a_file() -> None:
    files = list((CONFIG_DIR / "robots").rglob("*.yaml"))
    assert sorted(file.stem for file in files) == sorted(ROBOTS)  # of each name one, in whichever room
    assert all(summary for summary in ROBOTS.summaries().values())


def test_the_inertia_that_the_simulator_gives_is_twice_the_right_one() -> None:
    right, doubled = (np.array(ROBOTS.get(f"base_quadrotor{name}").body.inertia) for name in ("", "_doubled_inertia"))
    np.testing.assert_allclose(doubled, 2.0 * right, rtol=1e-15)


def test_drags_are_those_of_the_sources_for_each_kilogram() -> None:
    """0.544 and 0.386 1/s times the mass; a spin of 0.5 kg on arms of 0.17 m braked by 2.75e-3 N m s/rad is -4 kh w l² r."""
    robot = ROBOTS.get("base_quadrotor_with_drag")
    drag, mass = robot.effects["rotor_drag"], robot.body.mass
    np.testing.assert_allclose((drag["dx"], drag["dy"]), (0.544 * mass, 0.386 * mass), rtol=1e-12)
    robot = ROBOTS.get("base_quadrotor_braked_in_spin")
    rotor = robot.the_rotor("a test")
    hover, kh = rotor.speed_for_thrust(0.25 * mass * STANDARD_GRAVITY), robot.effects["h_force_flapping"]["kh"]
    np.testing.assert_allclose(4.0 * kh * hover / mass, 2.75e-3 / (0.5 * 0.17**2), rtol=1e-12)


def test_speeds_and_offsets_are_those_of_the_sources() -> None:
    """PX4's x500 turns at 150 to 1000 rad/s; the ARPL flights tell offsets of 0.028 m."""
    rotor = ROBOTS.get("x500_px4").the_rotor("a test")
    speeds = [rotor.speed_for_thrust(thrust) for thrust in rotor.thrust_range]
    np.testing.assert_allclose(speeds, (150.0, 1000.0), rtol=1e-9)
    robots = (ROBOTS.get(name) for name in ("crazyflie_2x_arpl", "crazyflie_21"))
    here, there = (np.array([mount.position for mount in robot.mounts.layout]) for robot in robots)
    np.testing.assert_allclose(here, 0.028 / 0.0325 * there, rtol=1e-12)


def test_arms_creep_as_identified_per_inertia_of_a_point_mass() -> None:
    joints, inertia = ROBOTS.get("morphy_creeping").joints, 0.01625 * 0.07**2
    springs = [joint.spring for joint in joints.layout if joint.name.startswith("elevation")]
    assert len(springs) == 4
    for spring in springs:
        result = (spring.stiffness, spring.damping, *(each.stiffness for each in spring.creep))
        np.testing.assert_allclose(result, inertia * np.array((4877.9, 56.623, 3474.6, 1665.6, 656.34)), rtol=1e-12)


@pytest.mark.parametrize("rods", [4, 5, 6])
def test_a_snake_is_a_regular_polygon_of_equal_rods(rods: int) -> None:
    """Rod k lies along ``(cos k c, sin k c)``, ``c = 2 pi / N``, and follows the one before; the body is all rods together."""
    robot = ROBOTS.get(f"snakey{'' if rods == 4 else rods}")
    headings, end = 2.0 * pi / rods * np.arange(rods), np.array((-0.5, 0.0, 0.0))
    for k, (heading, mount) in enumerate(zip(headings, robot.mounts.layout, strict=True)):
        along = np.array((cos(heading), sin(heading), 0.0))
        np.testing.assert_allclose(mount.position, end + 0.5 * along, atol=1e-14)
        for joint in robot.joints.layout[2 * k - 2 : 2 * k] if k else ():
            np.testing.assert_allclose(joint.position, end, atol=1e-14)
            axis = (0.0, 0.0, 1.0) if joint.name == f"yaw_{k}" else along
            np.testing.assert_allclose((*joint.axis, joint.reference), (*axis, axis[2] * 2.0 * pi / rods), atol=1e-14)
        _check_rod(robot, k, heading)
        end = end + along
    np.testing.assert_allclose(end, (-0.5, 0.0, 0.0), atol=1e-14)
    _check_whole(robot, headings)


def _check_rod(robot: RobotCfg, k: int, heading: float) -> None:
    capsule, middle = robot.collision.shapes[k], robot.mounts.layout[k].position
    assert (capsule.radius, capsule.height + 2.0 * capsule.radius) == (0.02, 1.0)
    np.testing.assert_allclose((*capsule.center, *capsule.euler), (*middle, 0.0, 0.5 * pi, heading), atol=1e-14)
    assert capsule.link == robot.mounts.layout[k].link == ("base" if k == 0 else f"roll_{k}")
    if k:
        link = robot.joints.layout[2 * k - 1].link
        np.testing.assert_allclose((link.mass, *link.com), (0.30625, *middle), atol=1e-14)
        np.testing.assert_allclose(link.inertia, _inertia_of_rod(heading), atol=1e-14)


def _inertia_of_rod(heading: float) -> np.ndarray:
    """Return that of a cylinder of 0.30625 kg, 1 m and a radius of 0.02 m that lies level."""
    turn = np.array(((cos(heading), -sin(heading), 0.0), (sin(heading), cos(heading), 0.0), (0.0, 0.0, 1.0)))
    across = 0.30625 * (1.0 / 12.0 + 0.02**2 / 4.0)
    return turn @ np.diag((0.5 * 0.30625 * 0.02**2, across, across)) @ turn.T


def _check_whole(robot: RobotCfg, headings: np.ndarray) -> None:
    places = np.array([mount.position for mount in robot.mounts.layout])
    levers = places - places.mean(axis=0)
    apart = sum((0.30625 * (lever @ lever * np.eye(3) - np.outer(lever, lever)) for lever in levers), np.zeros((3, 3)))
    whole = apart + sum((_inertia_of_rod(heading) for heading in headings), np.zeros((3, 3)))
    np.testing.assert_allclose(robot.body.inertia, whole, atol=1e-14)
    np.testing.assert_allclose(robot.body.com, places.mean(axis=0), atol=1e-14)
    assert robot.body.mass == pytest.approx(0.30625 * len(headings), rel=1e-12)
