"""Equations of motion with everything that a hidden effect can add; README.md lists formulas and sources.

A load on a cable adds six numbers to the state: its direction from the vehicle (unit) and the rate of that, world. Behind them
stand the angles [rad] of four soft arms, of the spring and of the creep, where they have them.
Letters: F flights.
"""

import numpy as np

from benchmarks.undeclared.dynamics import POS, RATE, ROTOR, VEL, Plant, cross_matrix, rotation_matrices
from benchmarks.undeclared.other_laws import cable_tension, downwash_force, drag_force, thrust_ratio
from benchmarks.undeclared.surroundings import NOMINAL_VOLTAGE, PlantSurroundings
from benchmarks.undeclared.vehicle import GRAVITY, NEUTRAL, ROTOR_RADIUS, Array, PlantVehicle

CABLE, CABLE_RATE = slice(22, 25), slice(25, 28)

LARGEST_GAIN = 2.0  # Largest ratio of thrust near a surface to thrust far from it: the formulas diverge at the surface
SETTLING = 50  # Rounds in which soft arms find where they rest; with one joint in each arm the first one is exact
LOWEST_SHEAR = 0.1  # Height below which the wind no longer changes [m]


def near_surface(strength: float, distance: Array) -> Array:
    """Return thrust near a surface over thrust far away, ``1 / (1 - k (r / (4 d))²)``, cut at ``LARGEST_GAIN``."""
    loss = strength * (ROTOR_RADIUS / (4.0 * np.maximum(distance, 1e-3))) ** 2
    return 1.0 / np.maximum(1.0 - loss, 1.0 / LARGEST_GAIN)


class FullPlant(Plant):
    """``Plant`` with the numbers of ``vehicle.extra`` at work."""

    def __init__(self, vehicle: PlantVehicle, surroundings: PlantSurroundings | None = None) -> None:
        super().__init__(vehicle)
        self._extra = extra = vehicle.extra
        self._surroundings = surroundings or PlantSurroundings()
        self._failures = self._surroundings.failures
        self._hub = vehicle.rotor_position - vehicle.com
        self._spin_axis = extra.rotor_inertia * vehicle.rotor_spin[:, None] * vehicle.rotor_axis
        self._inflow, self._thrust_map, self._side_map = self._rotor_maps()
        outside = (extra.downwash[0], extra.downwash_law, extra.attraction[3], extra.periodic[0], extra.shadow[0])
        self._has_outside = any(outside)
        self._near = bool(extra.ground or extra.ceiling or extra.ground_law or extra.ceiling_law)
        self._aero = any(
            (extra.h_force, extra.flapping, extra.axial_inflow, extra.translational_lift, extra.thrust_curve)
        ) or bool(extra.thrust_voltage)
        self._slung, self._elastic = extra.slung[0] > 0.0, bool(extra.cable)
        joints = [joint for joint in (extra.joint_spring, extra.joint_creep) if joint[0] > 0.0]
        first = CABLE_RATE.stop if self._slung or self._elastic else ROTOR.stop
        self._joints = [(*joint, slice(first + 4 * k, first + 4 * k + 4)) for k, joint in enumerate(joints)]
        self._prepare_arms()
        self._index, self._time, self._step_start, self._supply = 0, 0.0, 0.0, 1.0
        self._thrust_share: Array | float = 1.0
        self._command: Array | None = None
        if (extra.ceiling or extra.ceiling_law) and self._surroundings.ceiling is None:
            raise ValueError("ceiling_effect: needs a ceiling in the surroundings")
        if (extra.downwash[0] or extra.downwash_law) and self._surroundings.other is None:
            raise ValueError("downwash: needs another vehicle in the surroundings")

    def begin_sample(self, index: int, voltage: Array) -> None:
        """Start sample ``index`` at a battery voltage [V], (F,)."""
        self._index, self._time = index, index / self._surroundings.rate
        self._step_start = self._time
        self._thrust_share = ((voltage / NOMINAL_VOLTAGE) ** self._extra.thrust_voltage)[:, None]
        self._supply = (1.0 + self._extra.battery_gain * (voltage / NOMINAL_VOLTAGE - 1.0))[:, None]

    def states_at_rest(self, state: Array) -> Array:
        """Return states at rest with the load straight below, and soft arms as the thrust bends them in the long run."""
        if self._slung:
            state = np.hstack((state, np.tile([0.0, 0.0, -1.0, 0.0, 0.0, 0.0], (len(state), 1))))
        if self._elastic:
            mass, length, stiffness, _, hook = self._extra.cable
            depth = hook + length + mass * GRAVITY / stiffness
            state = np.hstack((state, np.tile([0.0, 0.0, -depth, 0.0, 0.0, 0.0], (len(state), 1))))
        state = np.hstack((state, np.zeros((len(state), 4 * len(self._joints)))))
        for _ in range(SETTLING if self._joints else 0):
            slopes = self._arm_loads(state, state[:, ROTOR] ** 2)[1]
            for (_, tau, _, angles), slope in zip(self._joints, slopes, strict=True):
                state[:, angles] += tau * slope
        return state

    def step(self, state: Array, command: Array, dt: float) -> Array:
        """Return the states after ``dt`` [s] under a held command; the time of each stage is its own."""
        self._command, self._step_start = command, self._time
        if self._failures is not None:
            self._failures.begin_step(self._step_start, state[:, ROTOR])
        state = super().step(state, command, dt)
        if self._slung:
            state[:, CABLE] /= np.linalg.norm(state[:, CABLE], axis=1, keepdims=True)
        return state

    def derivative(self, state: Array, command: Array) -> Array:
        """Return the time derivative of each state, (F, 22) and more with a load or soft arms."""
        rotor_dot, squared = self._rotor_dot(state, command), self._square_speeds(state)
        wrench, slopes = self._arm_loads(state, squared) if self._joints else (squared @ self._wrench_map, [])
        force, torque = self._body_loads(state, squared, wrench, rotor_dot)
        pull = 0.0
        if self._elastic:
            force, torque, pull = self._pull_of_elastic_cable(state, force, torque)
        world, swing = (rotation_matrices(state) @ force[:, :, None])[:, :, 0], None
        if self._slung:
            world, swing = self._cable_pull(state, world)
        out = self._state_derivative(state, world, torque, rotor_dot)
        for joint, slope in zip(self._joints, slopes, strict=True):
            out[:, joint[3]] = slope
        if self._elastic:
            swing = -np.asarray(pull) / self._extra.cable[0] - world / self.vehicle.mass
        if swing is not None:
            out[:, CABLE], out[:, CABLE_RATE] = state[:, CABLE_RATE], swing
        return out

    def body_force(self, state: Array) -> Array:
        """Return all forces but gravity [N], body frame, (F, 3), the pull of a load included."""
        command = state[:, ROTOR] if self._command is None else self._command
        acceleration = self.derivative(state, command)[:, VEL] - self._gravity
        return self.vehicle.mass * (acceleration[:, None, :] @ rotation_matrices(state))[:, 0]

    def specific_force(self, state: Array, place: Array | float = 0.0) -> Array:
        """Return the specific force [m/s²] at a place [m] from the body origin, body frame, (F, 3); see ``Plant``."""
        command = state[:, ROTOR] if self._command is None else self._command
        slope, com, turn = self.derivative(state, command), self.vehicle.com - place, cross_matrix(state[:, RATE])
        force = ((slope[:, VEL] - self._gravity)[:, None, :] @ rotation_matrices(state))[:, 0]
        return force - cross_matrix(slope[:, RATE]) @ com - (turn @ turn) @ com

    def _prepare_arms(self) -> None:
        """Work out what bending does not change: directions outwards, parts of the rotor axes along them and aside."""
        vehicle, up = self.vehicle, np.array([0.0, 0.0, 1.0])
        flat = vehicle.rotor_position * (1.0, 1.0, 0.0)
        self._reach = np.linalg.norm(flat, axis=1)
        self._out = out = flat / self._reach[:, None]
        self._axis_out = (vehicle.rotor_axis * out).sum(axis=1)
        self._aside = vehicle.rotor_axis - self._axis_out[:, None] * out - vehicle.rotor_axis[:, 2:] * up
        self._turning = np.cross(out, up)
        self._out_aside, self._up_aside = np.cross(out, self._aside), np.cross(up, self._aside)
        self._com_hat = cross_matrix(vehicle.com[None])[0].T

    def _rotor_maps(self) -> tuple[Array, Array, Array]:
        """Return matrices from motion to airspeeds at the hubs, and from thrusts and lateral flows to the wrench."""
        # From airspeed of the centre of mass and angular velocity (6) to the airspeed at each hub along its axis (4) and
        # across it (12); from thrust added along each axis (4), and from n times the airspeed across (12), to the wrench (6).
        axis, extra, count = self.vehicle.rotor_axis, self._extra, len(self._hub)
        at_hub = np.stack([np.hstack((np.eye(3), -cross_matrix(r[None])[0])) for r in self._hub])  # u + w x r
        along = np.einsum("ri,rij->rj", axis, at_hub)
        across = at_hub - axis[:, :, None] * along[:, None, :]
        inflow = np.vstack((along, across.reshape(3 * count, 6))).T
        thrust = np.hstack((axis, np.cross(self._hub, axis)))
        moments = -extra.h_force * cross_matrix(self._hub) - extra.flapping * cross_matrix(axis)
        side = [np.vstack((-extra.h_force * np.eye(3), moment)).T for moment in moments]
        return inflow, thrust, np.vstack(side)

    def _wind(self, state: Array) -> Array:
        x, y, reference, exponent = self._extra.shear
        wind, gust = self.vehicle.wind_world, self._surroundings.gust
        if gust is not None:
            wind = wind + gust[self._index]
        if x or y:
            growth = (np.maximum(state[:, 2:3], LOWEST_SHEAR) / reference) ** exponent
            wind = wind + growth * (x, y, 0.0)
        return wind

    def _rotor_dot(self, state: Array, command: Array) -> Array:
        """Return ``(supply n_cmd - n) / tau`` [rad/s²], (F, 4); a failure changes what stands for the first term."""
        led = self._supply * command
        if self._failures is not None:
            led = self._failures.rotor_targets(led, self._step_start)
        return self._rotor_acceleration(led - state[:, ROTOR])

    def _square_speeds(self, state: Array) -> Array:
        """Return the squared rotor speeds [rad²/s²], (F, 4), less what fading and failures take."""
        squared, (loss, time) = state[:, ROTOR] ** 2, self._extra.fading
        if self._failures is not None:
            squared = self._failures.blade_squares(squared, self._step_start)
        return squared * (1.0 - loss * (1.0 - np.exp(-self._time / time))) if loss else squared

    def _arm_loads(self, state: Array, squared: Array) -> tuple[Array, list[Array]]:
        """Return force and torque (F, 6) of rotors on soft arms, and the angular velocities of each element [rad/s], (F, 4)."""
        # Each arm is a plane chain of straight pieces, x outwards and z upwards, that turn upwards by the angles of the joints
        # before them; the rotor turns with the last piece.
        vehicle, x, z, turned, place = self.vehicle, 0.0, 0.0, 0.0, 0.0
        joints = []
        for compliance, tau, hinge, angles in sorted(self._joints, key=lambda joint: joint[2]):
            piece = (hinge - place) * self._reach
            x, z = x + piece * np.cos(turned), z + piece * np.sin(turned)
            joints.append((compliance, tau, angles, x, z))
            turned, place = turned + state[:, angles], hinge
        cos, sin = np.cos(turned), np.sin(turned)
        piece = (1.0 - place) * self._reach
        x, z = x + piece * cos, z + piece * sin
        thrust, height = vehicle.thrust_coeff * squared, z + vehicle.rotor_position[:, 2]
        leaning = cos * self._axis_out - sin * vehicle.rotor_axis[:, 2]  # outward part of the turned axis
        rising = sin * self._axis_out + cos * vehicle.rotor_axis[:, 2]

        def sum_thrusts(weight: Array | float) -> Array:
            """Return the sum of all thrusts [N] with a weight, along their turned axes, (F, 3)."""
            along = (weight * thrust * leaning) @ self._out + (weight * thrust) @ self._aside
            along[:, 2] += (weight * thrust * rising).sum(axis=1)
            return along

        force = sum_thrusts(1.0)
        torque = (thrust * (x * rising - height * leaning)) @ self._turning
        torque += (thrust * x) @ self._out_aside + (thrust * height) @ self._up_aside - force @ self._com_hat
        torque -= sum_thrusts(vehicle.rotor_spin * vehicle.torque_ratio)
        slopes = {
            angles.start: (compliance * thrust * ((x - at) * rising - (z - height) * leaning) - state[:, angles]) / tau
            for compliance, tau, angles, at, height in joints
        }
        return np.hstack((force, torque)), [slopes[joint[3].start] for joint in self._joints]

    def _body_loads(self, state: Array, squared: Array, wrench: Array, rotor_dot: Array) -> tuple[Array, Array]:
        """Return force and torque, body frame, (F, 3) each, without gravity and cable; ``wrench`` is that in still air."""
        extra, rotor = self._extra, state[:, ROTOR]
        force, torque = wrench[:, :3] + self._drag(state), wrench[:, 3:]
        if extra.drag_law:
            air, thrust = self._speed_through_air(state), squared @ self.vehicle.thrust_coeff
            force = force + drag_force(extra.drag_law, air, thrust, self.vehicle.mass * GRAVITY)
        if self._aero or self._near:
            push, moment = self._rotor_changes(state, squared)
            force, torque = force + push, torque + moment
        if extra.rotor_inertia:
            spin = rotor @ self._spin_axis
            torque = torque - rotor_dot @ self._spin_axis - (cross_matrix(state[:, RATE]) @ spin[:, :, None])[:, :, 0]
        return force + self._external_force(state) if self._has_outside else force, torque

    def _rotor_changes(self, state: Array, squared: Array) -> tuple[Array, Array]:
        """Return force and torque that inflow, flapping and surfaces add to ``c n²`` of each rotor, (F, 3) each."""
        extra, rotor, count = self._extra, state[:, ROTOR], len(self._hub)
        plain = self.vehicle.thrust_coeff * squared
        thrust, wrench = plain, 0.0
        if self._aero:
            flow = np.hstack((self._speed_through_air(state), state[:, RATE])) @ self._inflow
            along, across = flow[:, :count], flow[:, count:].reshape(-1, count, 3)
            hover = self.vehicle.mass * GRAVITY / count
            thrust = (
                self._thrust_share * plain * (plain / hover) ** (0.5 * extra.thrust_curve)
                - extra.axial_inflow * rotor * along
            )
            thrust = thrust + extra.translational_lift * (across * across).sum(axis=2)
            wrench = (rotor[:, :, None] * across).reshape(len(state), -1) @ self._side_map
        if self._near:
            height = state[:, 2:3] + rotation_matrices(state)[:, 2] @ self._hub.T
            gain = near_surface(extra.ground, height) * thrust_ratio(extra.ground_law, height)
            if self._surroundings.ceiling is not None:
                room = self._surroundings.ceiling - height
                gain = gain * near_surface(extra.ceiling, room) * thrust_ratio(extra.ceiling_law, room)
            thrust = thrust * gain
        wrench = wrench + (thrust - plain) @ self._thrust_map
        return wrench[:, :3], wrench[:, 3:]

    def _external_force(self, state: Array) -> Array:
        """Return the forces on the centre of mass that are neither of rotors nor of drag [N], body frame, (F, 3)."""
        extra, force, rot = self._extra, np.zeros((len(state), 3)), rotation_matrices(state)
        origin = state[:, POS] - rot @ self.vehicle.com  # wakes act between body origins
        if extra.downwash[0] and self._surroundings.other is not None:
            apart = self._surroundings.other[self._index] - origin
            wake = np.exp(-0.5 * (apart[:, 0] ** 2 + apart[:, 1] ** 2) / extra.downwash[1] ** 2)
            force[:, 2] -= extra.downwash[0] * wake * (apart[:, 2] > 0.0)
        if extra.downwash_law and self._surroundings.other is not None:
            force[:, 2] -= downwash_force(extra.downwash_law, self._surroundings.other[self._index] - origin)
        if extra.attraction[3]:
            apart = (np.asarray(extra.attraction[:3]) - state[:, POS]) / extra.attraction[4]
            force += extra.attraction[3] * apart * np.exp(0.5 - 0.5 * (apart * apart).sum(axis=1, keepdims=True))
        body = (force[:, None, :] @ rot)[:, 0]
        if extra.periodic[0]:
            body[:, 0] += extra.periodic[0] * np.sin(2.0 * np.pi * extra.periodic[1] * self._time)
        if extra.shadow[0]:
            yaw = np.arctan2(rot[:, 1, 0], rot[:, 0, 0])
            body[:, 1] += extra.shadow[0] * np.maximum(np.cos(yaw - extra.shadow[1]), 0.0)
        return body

    def _pull_of_elastic_cable(self, state: Array, force: Array, torque: Array) -> tuple[Array, Array, Array]:
        """Return force and torque with the pull of the cable at its hook, body, and the pull itself, world, (F, 3) each."""
        rot, hook = rotation_matrices(state), np.array([0.0, 0.0, -self._extra.cable[4]])
        rope = state[:, CABLE] - rot @ hook
        rope_rate = state[:, CABLE_RATE] - (rot @ (cross_matrix(state[:, RATE]) @ hook)[:, :, None])[:, :, 0]
        pull = cable_tension(self._extra.cable, rope, rope_rate)
        body = (pull[:, None, :] @ rot)[:, 0]
        return force + body, torque + np.cross(hook, body), pull

    def _cable_pull(self, state: Array, force: Array) -> tuple[Array, Array]:
        """Return the world force with the pull of the load, and the second derivative of the cable direction q."""
        # Derived: m a = F + S q + d l q' + m g and M a_L = -S q - d l q' + M g, with a_L - a = l q'' and q . q'' = -|q'|²;
        # S is the tension of a cable that stays taut. It hangs from the centre of mass: no torque.
        mass, length, damping = self._extra.slung
        q, q_dot = state[:, CABLE], state[:, CABLE_RATE]
        speed = (q_dot * q_dot).sum(axis=1, keepdims=True)
        along = (force * q).sum(axis=1, keepdims=True)
        inverse = 1.0 / mass + 1.0 / self.vehicle.mass
        tension = (length * speed - along / self.vehicle.mass) / inverse
        swing = -speed * q - (force - along * q) / (self.vehicle.mass * length) - damping * inverse * q_dot
        return force + tension * q + damping * length * q_dot, swing


def make_plant(vehicle: PlantVehicle, surroundings: PlantSurroundings | None = None) -> Plant:
    """Return the plain plant if it is enough for the vehicle and its surroundings."""
    moved = surroundings is not None and (surroundings.gust is not None or surroundings.failures is not None)
    return FullPlant(vehicle, surroundings) if moved or vehicle.extra != NEUTRAL else Plant(vehicle)
