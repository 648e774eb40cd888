"""Manoeuvres in closed form, and the flight of the declared vehicle along each.

A multirotor is differentially flat in position and heading. Attitude and thrust follow from the acceleration, torques from the
angular acceleration, and rotor speeds from the inverse allocation. Drag is neglected: it takes a few per cent of the thrust,
and hardly changes which effects a manoeuvre excites. Source of flatness: Mellinger, Kumar (2011), Minimum snap trajectory
generation and control for quadrotors, section III. Letters: T rows, R rotors.
"""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import torch
from scipy.spatial.transform import Rotation

from aerial_gym.config.robot import RobotCfg
from aerial_gym.config.sim import STANDARD_GRAVITY
from aerial_gym.control.allocation import allocation_matrix
from aerial_gym.physics import vehicle_from_config
from aerial_gym.physics.rotors import state_for_thrust
from aerial_gym.sim2real.arrays import Array
from aerial_gym.sim2real.logs.checks.conventions import body_rate_from_attitude
from aerial_gym.sim2real.logs.flights import Flight
from aerial_gym.sim2real.logs.recording import AT_REST
from aerial_gym.sim2real.logs.signals import continuous_quaternion, lowpass

Path = Callable[[Array], tuple[Array, Array]]  # Position [m], world, (T, 3), and heading [rad], (T,), at times [s] (T,)
SPAN_S = 10.0  # Length of a manoeuvre [s]
LEAD_S = 1.0  # Time before and after a manoeuvre that is cut off, against end effects of the derivatives [s]
BAND_HZ = 30.0  # Low-pass of the derivatives [Hz], far above the frequencies of the paths
HEIGHT = 5.0  # Height above the ground where it does not matter [m]


def _sine(time: Array, size: float | Array, period: float) -> Array:
    return size * np.sin(2.0 * np.pi * time / period)


def _path(
    time: Array, x: Array | float = 0.0, y: Array | float = 0.0, z: Array | float = HEIGHT, heading: Array | None = None
) -> tuple[Array, Array]:
    """Return the path of coordinates (T,) or constants [m], and the heading; without arguments a hover."""
    still = np.zeros_like(time)
    return np.stack((still + x, still + y, still + z), axis=1), still if heading is None else heading


def _staircase(time: Array, size: float, every: float) -> Array:
    """Return a staircase with a step of ``size`` in the middle of every interval, each taking about a second."""
    middles = (np.arange(int(SPAN_S / every)) + 0.5) * every
    return size * (0.5 + 0.5 * np.tanh((time[:, None] - middles) / 0.3)).sum(axis=1)


def _circle_path(time: Array, turns: float) -> tuple[Array, Array]:
    angle = 1.5 * time
    return _path(time, 2.0 * np.cos(angle), 2.0 * np.sin(angle), heading=turns * angle)


MANOEUVRES: dict[str, Path] = {
    "hover": _path,
    "climb and descend, up to 2 m/s": lambda t: _path(t, z=HEIGHT + _sine(t, 1.6, 5.0)),
    "jump up and down by a few centimetres, thrust up and down by a third": lambda t: _path(
        t, z=HEIGHT + _sine(t, 0.08, 1.0)
    ),
    "sweep forwards and back, up to 3 m/s": lambda t: _path(t, x=_sine(t, 2.4, 5.0)),
    "sweep from side to side, up to 3 m/s": lambda t: _path(t, y=_sine(t, 2.4, 5.0)),
    "sweep along both axes, slow and then fast, up to 5 m/s": lambda t: _path(
        t, _sine(t, 0.4 * t, 5.0), _sine(t + 1.0, 0.4 * t, 5.0)
    ),
    "circle at 3 m/s, heading held": lambda t: _circle_path(t, 0.0),
    "circle at 3 m/s, nose first": lambda t: _circle_path(t, 1.0),
    "hover and turn the heading in steps of 90 degrees, a second each": lambda t: _path(
        t, heading=_staircase(t, 0.5 * np.pi, 2.0)
    ),
    "rock quickly in roll and pitch (doublets of 15 to 20 degrees)": lambda t: _path(
        t, _sine(t, 0.08, 1.0), _sine(t, 0.07, 0.9)
    ),
    "sweep forwards and back, the same path at four headings": lambda t: _path(
        t, x=_sine(t, 1.0, 2.5), heading=_staircase(t, 0.5 * np.pi, 2.5)
    ),
    "come down to 0.15 m above the ground and up again": lambda t: _path(
        t, z=0.75 - 0.6 * np.cos(2.0 * np.pi * t / 5.0)
    ),
    "climb from 1 m to 9 m and descend": lambda t: _path(t, z=HEIGHT - 4.0 * np.cos(0.2 * np.pi * t)),
    "hover until the battery is empty": _path,
}
"""Paths that a pilot or a script can fly, by their name in reports."""


def manoeuvre_flight(name: str, robot: RobotCfg, like: Flight, *, rate: float) -> Flight | None:
    """Return the flight that the declared vehicle makes of a manoeuvre; None if its rotors cannot.

    Args:
        like: A flight whose log tells which quantities are measured.
        rate: Rows per second [Hz], at least 100.
    """
    time = np.arange(-LEAD_S, SPAN_S + LEAD_S, 1.0 / rate)
    position, heading = MANOEUVRES[name](time)
    velocity = _band_limited_derivative(position, rate)
    force = _band_limited_derivative(velocity, rate) + AT_REST
    turn = _flat_attitude(force, heading)
    attitude = continuous_quaternion(turn.as_quat())
    ang_vel = body_rate_from_attitude(attitude, rate, BAND_HZ)
    thrust = _rotor_thrusts(robot, np.linalg.norm(force, axis=1), ang_vel, rate)
    kept = (time >= 0.0) & (time < SPAN_S - 0.5 / rate)
    low, high = np.array([rotor.thrust_range for rotor in robot.rotor_types]).T  # each (R,)
    if (thrust[kept] < low).any() or (thrust[kept] > high).any():
        return None
    vehicle = vehicle_from_config(robot, num_envs=time.size, dtype=torch.float64)
    speed = state_for_thrust(vehicle, torch.from_numpy(thrust)).numpy()
    change = _band_limited_derivative(speed, rate)
    lag = np.where(change * speed > 0.0, vehicle.time_constant_up.numpy(), vehicle.time_constant_down.numpy())
    voltage = None
    if (cell := robot.battery) is not None:
        nominal = cell.nominal_voltage
        start, end = (cell.full_voltage, cell.empty_voltage) if "battery" in name else (nominal, nominal)
        voltage = np.linspace(start, end, kept.sum())
    return replace(
        like,
        name=name,
        path="",
        rate=rate,
        time=time[kept],
        position=None if like.position is None else position[kept],
        attitude=attitude[kept],
        lin_vel=None if like.lin_vel is None else velocity[kept],
        ang_vel=ang_vel[kept],
        specific_force=None if like.specific_force is None else turn.apply(force, inverse=True)[kept],
        rotor_speed=None if like.rotor_speed is None else speed[kept],
        rotor_command=None if like.rotor_command is None else (speed + lag * change)[kept],
        battery=None if like.battery is None else voltage,
        other_position=None,
        on_ground=None,
        lost=None,
        notes=(),
    )


def _band_limited_derivative(values: Array, rate: float) -> Array:
    return lowpass(values, rate, BAND_HZ, derivative=True)


def _flat_attitude(force: Array, heading: Array) -> Rotation:
    """Return the attitude with body z along the specific force (T, 3), world, and the nose towards the heading (T,)."""
    up = force / np.linalg.norm(force, axis=1, keepdims=True)
    ahead = np.stack((np.cos(heading), np.sin(heading), np.zeros_like(heading)), axis=1)
    left = np.cross(up, ahead)
    left /= np.linalg.norm(left, axis=1, keepdims=True)
    return Rotation.from_matrix(np.stack((np.cross(left, up), left, up), axis=2))


def _rotor_thrusts(robot: RobotCfg, lift: Array, ang_vel: Array, rate: float) -> Array:
    """Return the rotors' thrusts [N], (T, R), for a specific force along body z (T,) and an angular velocity (T, 3)."""
    inertia = np.array(robot.body.inertia)
    torque = _band_limited_derivative(ang_vel, rate) @ inertia + np.cross(ang_vel, ang_vel @ inertia)
    vehicle = vehicle_from_config(robot, num_envs=1, dtype=torch.float64)
    inverse = np.linalg.pinv(allocation_matrix(vehicle, STANDARD_GRAVITY)[0].numpy()[2:])  # along z, and three torques
    return np.column_stack((robot.body.mass * lift, torque)) @ inverse.T
