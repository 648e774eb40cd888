import numpy as np
import pytest
from scipy.spatial.transform import Rotation

pytest.importorskip("pymavlink")

from aerial_gym.firmware.px4.readings import Home, Motion, Readings, air_pressure, ned_attitude

TIME_US = 4000


def motion(*, position=(0.0, 0.0, 0.0), turn=None, lin_vel=(0.0, 0.0, 0.0), ang_vel=(0.0, 0.0, 0.0)) -> Motion:
    """Return one environment at rest in the air, but for the given values; ``turn``: rotation vector [rad], world."""
    rotation = Rotation.from_rotvec(np.zeros(3) if turn is None else turn)
    force = rotation.inv().apply([0.0, 0.0, 9.81])
    values = (position, rotation.as_quat(), lin_vel, ang_vel, force)
    position, attitude, lin_vel, ang_vel, force = (np.array([value], dtype=float) for value in values)
    return Motion(position=position, attitude=attitude, lin_vel=lin_vel, ang_vel=ang_vel, force=force)


def sensor(**state):
    return Readings(Home()).sensors(TIME_US, motion(**state))[0]


def gps(**state):
    return Readings(Home()).positions(TIME_US, motion(**state))[0]


def test_attitude_in_px4_frames_is_that_of_turned_axes():
    rotations = Rotation.random(20, random_state=3)
    to_ned = Rotation.from_matrix([[0, 1, 0], [1, 0, 0], [0, 0, -1]])
    to_frd = Rotation.from_euler("x", np.pi)
    x, y, z, w = (to_ned * rotations * to_frd).as_quat().T
    expected, result = np.stack((w, x, y, z), axis=1), ned_attitude(rotations.as_quat())
    assert np.abs(np.sum(expected * result, axis=1)) == pytest.approx(1.0)  # either sign is the same attitude
    assert np.linalg.norm(result, axis=1) == pytest.approx(1.0)


def test_accelerometer_at_rest_points_up():
    message = sensor()
    assert (message.xacc, message.yacc, message.zacc) == pytest.approx((0.0, 0.0, -9.81), abs=1e-9)


def test_roll_to_the_right_lets_the_right_side_feel_gravity():
    message = sensor(turn=(0.3, 0.0, 0.0))  # about forward: the right side goes down
    assert message.yacc == pytest.approx(-9.81 * np.sin(0.3))


def test_turn_to_the_left_is_a_negative_yaw_rate():
    message = sensor(ang_vel=(0.1, 0.2, 0.3))
    assert (message.xgyro, message.ygyro, message.zgyro) == pytest.approx((0.1, -0.2, -0.3))


def test_magnetometer_points_north_and_down():
    facing_east, facing_north = sensor(), sensor(turn=(0.0, 0.0, np.pi / 2))
    assert facing_north.xmag == pytest.approx(Home().magnetic_field[0])
    assert facing_east.ymag == pytest.approx(-Home().magnetic_field[0])  # north is to the left
    assert facing_north.zmag == facing_east.zmag == pytest.approx(Home().magnetic_field[2])


def test_pressure_falls_with_height_as_a_column_of_air():
    low, high = air_pressure(np.array([0.0, 1.0]))
    assert low == pytest.approx(1013.25)
    assert (low - high) * 100.0 == pytest.approx(1.225 * 9.80665, rel=1e-3)  # [Pa]


def test_gps_shows_place_height_and_course():
    message = gps(position=(100.0, 200.0, 3.0), lin_vel=(2.0, 0.0, 1.0))
    north = (message.lat * 1e-7 - Home().latitude) * 111194.93  # [m] for each degree of a sphere of 6371 km
    east = (message.lon * 1e-7 - Home().longitude) * 111194.93 * np.cos(np.radians(Home().latitude))
    assert (east, north) == pytest.approx((100.0, 200.0), abs=0.02)
    assert message.alt == pytest.approx(491000)
    assert (message.vn, message.ve, message.vd, message.vel, message.cog) == (0, 200, -100, 200, 9000)


def test_true_state_has_the_units_of_the_message():
    message = Readings(Home()).states(TIME_US, motion(lin_vel=(1.0, 2.0, 3.0)))[0]
    assert (message.vx, message.vy, message.vz) == (200, 100, -300)
    assert message.zacc == -1000
