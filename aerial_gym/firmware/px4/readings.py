"""Readings of PX4's simulated sensors, from states of the simulation.

World: x east, y north, z up; PX4 has north, east, down. Body: x forward, y left, z up; PX4 has forward, right, down.
Letters: E environments.
"""

from dataclasses import dataclass
from math import cos, radians
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pymavlink.dialects.v20 import common as mavlink

_messages: Any = mavlink  # Their constructors take rows of numbers here
Rows = NDArray[np.float64]

EARTH_RADIUS = 6371000.0  # [m]. Source: PX4, CONSTANTS_RADIUS_OF_EARTH
TO_NED = np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]], dtype=np.float64)  # Rows: north, east, down
TO_FRD = np.array([1.0, -1.0, -1.0])

ACCELEROMETER, GYRO, MAGNETOMETER, BAROMETER = 0x7, 0x38, 0x1C0, 0x1A00
"""Bits of HIL_SENSOR's ``fields_updated``. Source: PX4, SimulatorMavlink.hpp, SensorSource."""

FIX_3D, EPH, EPV, SATELLITES = 3, 30, 40, 10  # Of the simulated GPS receiver; standard deviations [cm]
TEMPERATURE = 25.0  # [deg C]


@dataclass(frozen=True, kw_only=True)
class Home:
    """Place of the simulation's origin on the earth."""

    latitude: float = 47.397742  # [deg]
    longitude: float = 8.545594  # [deg]. Source of both, and of the altitude: PX4, default home of its simulators
    altitude: float = 488.0  # Above sea level [m]
    magnetic_field: tuple[float, float, float] = (0.216, 0.012, 0.430)
    """North, east, down [G]; must fit the place. Source: World Magnetic Model 2025 near Zurich, rounded."""


@dataclass(frozen=True, kw_only=True)
class Motion:
    """States and inertial readings of all environments."""

    position: Rows  # [m], world, (E, 3)
    attitude: Rows  # Body to world, xyzw, (E, 4)
    lin_vel: Rows  # [m/s], world, (E, 3)
    ang_vel: Rows  # Gyro [rad/s], body, (E, 3)
    force: Rows  # Accelerometer [m/s²], body, (E, 3)


def ned_attitude(attitude: Rows) -> Rows:
    """Return quaternions of the body in PX4's frames, wxyz, (E, 4), for ours, xyzw."""
    x, y, z, w = attitude.T
    # q_ned = q(enu -> ned) q q(frd -> flu), two half turns: about (1, 1, 0) / sqrt 2, and about x
    return np.stack((w + z, x + y, x - y, w - z), axis=1) * np.sqrt(0.5)


def air_pressure(altitude: Rows) -> Rows:
    """Return the pressure [hPa] of the standard atmosphere at an altitude above sea level [m]. Source: ISO 2533."""
    return 1013.25 * (1.0 - 2.25577e-5 * altitude) ** 5.25588


def _turn_to_body(attitude: Rows, vector: Rows) -> Rows:
    """Return world vectors (E, 3) in body axes."""
    about, w = -attitude[:, :3], attitude[:, 3:]
    twice = 2.0 * np.cross(about, vector)
    return vector + w * twice + np.cross(about, twice)


class Readings:
    """Messages of PX4's sensors for the states of all environments."""

    def __init__(self, home: Home) -> None:
        self._home, self._north = home, radians(1.0) * EARTH_RADIUS
        self._east = self._north * cos(radians(home.latitude))
        self._field: Rows = TO_NED.T @ np.array(home.magnetic_field)

    def sensors(self, time_us: int, motion: Motion) -> list[mavlink.MAVLink_hil_sensor_message]:
        """Return HIL_SENSOR of each environment."""
        force, rate = motion.force * TO_FRD, motion.ang_vel * TO_FRD
        field = _turn_to_body(motion.attitude, np.tile(self._field, (len(rate), 1))) * TO_FRD
        altitude = self._home.altitude + motion.position[:, 2]
        no_airspeed, fields = np.zeros_like(altitude), ACCELEROMETER | GYRO | MAGNETOMETER | BAROMETER
        air = (air_pressure(altitude), no_airspeed, altitude, no_airspeed + TEMPERATURE)
        rows = np.column_stack((force, rate, field, *air)).tolist()
        return [_messages.MAVLink_hil_sensor_message(time_us, *row, fields, 0) for row in rows]

    def positions(self, time_us: int, motion: Motion) -> list[mavlink.MAVLink_hil_gps_message]:
        """Return HIL_GPS of each environment, without errors."""
        velocity = np.rint(100.0 * motion.lin_vel @ TO_NED.T).astype(int)  # [cm/s]
        speed = np.rint(100.0 * np.linalg.norm(motion.lin_vel[:, :2], axis=1)).astype(int)
        course = np.rint(np.degrees(np.arctan2(motion.lin_vel[:, 0], motion.lin_vel[:, 1])) % 360.0 * 100.0) % 36000
        rows = zip(self._places(motion), velocity.tolist(), speed.tolist(), course.astype(int).tolist(), strict=True)
        return [
            _messages.MAVLink_hil_gps_message(time_us, FIX_3D, *place, EPH, EPV, total, *ned, heading, SATELLITES)
            for place, ned, total, heading in rows
        ]

    def states(self, time_us: int, motion: Motion) -> list[mavlink.MAVLink_hil_state_quaternion_message]:
        """Return HIL_STATE_QUATERNION of each environment: the true state, which PX4 only logs."""
        velocity = np.rint(100.0 * motion.lin_vel @ TO_NED.T).astype(int).tolist()  # [cm/s]
        force = np.rint(motion.force * TO_FRD / 9.80665 * 1000.0).clip(-32768, 32767).astype(int).tolist()  # [mG]
        rate, attitude = (motion.ang_vel * TO_FRD).tolist(), ned_attitude(motion.attitude).tolist()
        rows = zip(attitude, rate, self._places(motion), velocity, force, strict=True)
        return [
            _messages.MAVLink_hil_state_quaternion_message(time_us, turn, *turning, *place, *ned, 0, 0, *felt)
            for turn, turning, place, ned, felt in rows
        ]

    def _places(self, motion: Motion) -> list[tuple[int, int, int]]:
        """Return latitude and longitude [1e-7 deg], and altitude [mm], of each environment."""
        home, (east, north, up) = self._home, motion.position.T
        latitude, longitude = home.latitude + north / self._north, home.longitude + east / self._east
        numbers = np.column_stack((latitude * 1e7, longitude * 1e7, (home.altitude + up) * 1e3))
        return [tuple(row) for row in np.rint(numbers).astype(int).tolist()]
