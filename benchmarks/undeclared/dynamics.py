"""Newton-Euler equations of a quadrotor about its centre of mass, and a classical Runge-Kutta step.

The attitude is a rotation matrix R (body to world). One state is a row of 22 numbers, one flight per row:
position of the centre of mass (3, world), its velocity (3, world), R (9, row by row), angular velocity (3, body),
rotor speeds (4). Letters: F flights.

``FullPlant`` in full_dynamics.py adds what the other hidden effects need.
"""

import numpy as np

from benchmarks.undeclared.vehicle import GRAVITY, Array, PlantVehicle

POS, VEL, ROT, RATE, ROTOR = slice(0, 3), slice(3, 6), slice(6, 15), slice(15, 18), slice(18, 22)
STATE_SIZE = 22

_HAT = np.zeros((3, 9))  # Maps w to the nine numbers of [w]x, the matrix with `[w]x a = w x a`
for _i, _j, _k in ((0, 1, 2), (1, 2, 0), (2, 0, 1)):
    _HAT[_i, 3 * _k + _j], _HAT[_i, 3 * _j + _k] = 1.0, -1.0


def cross_matrix(vector: Array) -> Array:
    """Return [w]x of each row, (F, 3) to (F, 3, 3)."""
    return (vector @ _HAT).reshape(-1, 3, 3)


def rotation_matrices(state: Array) -> Array:
    """Return R, body to world, (F, 3, 3); a view."""
    return state[:, ROT].reshape(-1, 3, 3)


def wrench_map(vehicle: PlantVehicle) -> Array:
    """Return the matrix (4, 6) from squared rotor speeds to force and torque about the centre of mass, body frame.

    Rotor i gives the force ``f = c_i w^2 a`` at its hub and feels the drag torque ``k |f|`` against its spin, which the
    body takes up: ``torque = (r - c) x f - spin k c_i w^2 a``.
    """
    force = vehicle.thrust_coeff[:, None] * vehicle.rotor_axis
    torque = np.cross(vehicle.rotor_position - vehicle.com, force)
    torque -= vehicle.rotor_spin[:, None] * vehicle.torque_ratio * force
    return np.hstack((force, torque))


class Plant:
    """Equations of motion of one vehicle; states of several flights go in as rows."""

    def __init__(self, vehicle: PlantVehicle) -> None:
        self.vehicle = vehicle
        self._wrench_map = wrench_map(vehicle)
        self._inertia = vehicle.inertia
        self._inverse = np.linalg.inv(vehicle.inertia)
        self._gravity = np.array([0.0, 0.0, -GRAVITY])
        self._has_quadratic = bool(np.any(vehicle.quadratic_drag))
        self._time = 0.0

    def begin_sample(self, index: int, voltage: Array) -> None:
        """Start sample ``index`` at a battery voltage [V], (F,): nothing here depends on them."""

    def states_at_rest(self, state: Array) -> Array:
        """Return states at rest with the parts that this plant adds to (F, 22): none."""
        return state

    def body_force(self, state: Array) -> Array:
        """Return thrust plus drag [N], body frame, (F, 3): all but gravity."""
        return (state[:, ROTOR] ** 2 @ self._wrench_map)[:, :3] + self._drag(state)

    def _speed_through_air(self, state: Array) -> Array:
        """Return the airspeed of the centre of mass [m/s], body axes, (F, 3)."""
        return ((state[:, VEL] - self._wind(state))[:, None, :] @ rotation_matrices(state))[:, 0]

    def _wind(self, _state: Array) -> Array:
        """Return the velocity of the air [m/s], world, (3,) or (F, 3)."""
        return self.vehicle.wind_world

    def _drag(self, state: Array) -> Array:
        """Return ``-(d1 + d2 |u|) u`` with the airspeed u of the centre of mass in body axes, (F, 3)."""
        air = self._speed_through_air(state)
        if not self._has_quadratic:
            return -self.vehicle.linear_drag * air
        speed = np.sqrt((air * air).sum(axis=1, keepdims=True))
        return -(self.vehicle.linear_drag + self.vehicle.quadratic_drag * speed) * air

    def derivative(self, state: Array, command: Array) -> Array:
        """Return the time derivative of each state (F, 22) at commanded rotor speeds (F, 4) [rad/s].

        ``p' = v``, ``m v' = R f + m g``, ``R' = R [w]x``, ``I w' = torque - w x I w``, ``n' = (n_cmd - n) / tau``.
        """
        rotor = state[:, ROTOR]
        wrench = rotor * rotor @ self._wrench_map
        force = (rotation_matrices(state) @ (wrench[:, :3] + self._drag(state))[:, :, None])[:, :, 0]
        return self._state_derivative(state, force, wrench[:, 3:], self._rotor_acceleration(command - rotor))

    def _rotor_acceleration(self, error: Array) -> Array:
        """Return the rotor accelerations [rad/s²] for target less present speeds, (F, 4)."""
        return error / np.where(error > 0.0, self.vehicle.tau_up, self.vehicle.tau_down)

    def _state_derivative(self, state: Array, force: Array, torque: Array, rotor_dot: Array) -> Array:
        """Return the time derivative of each state under a force (world) and a torque (body), both (F, 3); 0 elsewhere."""
        out, rate = np.zeros_like(state), state[:, RATE]
        turn, momentum = cross_matrix(rate), (rate @ self._inertia)[:, :, None]  # the inertia is symmetric
        out[:, POS] = state[:, VEL]
        out[:, VEL] = force / self.vehicle.mass + self._gravity
        out[:, ROT] = (rotation_matrices(state) @ turn).reshape(-1, 9)
        out[:, RATE] = (torque - (turn @ momentum)[:, :, 0]) @ self._inverse
        out[:, ROTOR] = rotor_dot
        return out

    def step(self, state: Array, command: Array, dt: float) -> Array:
        """Return the states after ``dt`` [s] under a held command: the classical fourth order Runge-Kutta step."""
        start = self._time
        k1 = self.derivative(state, command)
        self._time = start + 0.5 * dt
        k2 = self.derivative(state + (0.5 * dt) * k1, command)
        k3 = self.derivative(state + (0.5 * dt) * k2, command)
        self._time = start + dt
        k4 = self.derivative(state + dt * k3, command)
        return state + (dt / 6.0) * (k1 + 2.0 * (k2 + k3) + k4)

    def origin_position(self, state: Array) -> Array:
        """Return the position of the body origin [m], ``p - R c``, world, (F, 3)."""
        return state[:, POS] - rotation_matrices(state) @ self.vehicle.com

    def origin_velocity(self, state: Array) -> Array:
        """Return the velocity of the body origin [m/s], ``v - R (w x c)``, world, (F, 3)."""
        lever = cross_matrix(state[:, RATE]) @ self.vehicle.com
        return state[:, VEL] - (rotation_matrices(state) @ lever[:, :, None])[:, :, 0]

    def specific_force(self, state: Array, place: Array | float = 0.0) -> Array:
        """Return the specific force [m/s²] at a place [m] from the body origin, body frame, (F, 3).

        Derived: ``R^T (a_P - g)`` with ``a_P = a_C - R (w' x l + w x (w x l))``, ``l = c - p`` and ``m (a_C - g) = R f``.
        """
        rate, com = state[:, RATE], self.vehicle.com - place
        rate_dot = self.derivative(state, state[:, ROTOR])[:, RATE]
        turn = cross_matrix(rate)
        return self.body_force(state) / self.vehicle.mass - cross_matrix(rate_dot) @ com - (turn @ turn) @ com


def orthonormalise(state: Array) -> None:
    """Pull R back to a rotation in place, one Newton step ``R (3 - R^T R) / 2`` of the polar decomposition.

    Source: N. Higham, "Computing the polar decomposition", 1986, the Newton-Schulz variant.
    """
    rot = rotation_matrices(state)
    gram = rot.transpose(0, 2, 1) @ rot
    state[:, ROT] = (0.5 * rot @ (3.0 * np.eye(3) - gram)).reshape(-1, 9)


def rest_state(vehicle: PlantVehicle, origin: Array, yaw: Array) -> Array:
    """Return level states at rest with the rotors at hover speed, from origin positions (F, 3) and headings (F,)."""
    state = np.zeros((len(origin), STATE_SIZE))
    rot = rotation_matrices(state)
    rot[:, 0, 0] = rot[:, 1, 1] = np.cos(yaw)
    rot[:, 1, 0], rot[:, 0, 1], rot[:, 2, 2] = np.sin(yaw), -np.sin(yaw), 1.0
    state[:, POS] = origin + rot @ vehicle.com
    state[:, ROTOR] = vehicle.hover_speed()
    return state
