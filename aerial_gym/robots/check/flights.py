"""Hover with a tail servo, and the largest stable time step of a robot under a controller, from simulated flights to rest.

A tail servo tilts the tail rotor of a tricopter to give yaw torque. The unknowns at hover are the thrusts of the other rotors
and two components of the tail's thrust, along body z and along -y (a positive angle). Force and torque are linear in these;
thrust and angle are their length and direction. The rotor points along body z in the reference pose, its joint's axis runs
through its hub: ``derive_tail_servo`` takes it so.
``control.stability`` tests the linearised loop; this module simulates the full loop with limits and effects, from disturbed
starts near hover, in the physics backend of later flights. A robot with joints is rigid in its reference pose, except for a
tail servo, which then holds the heading.
Frames: body is x forward, y left, z up. Letters: E environments, R rotors, U entries of an action.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from math import atan2, ceil, exp, hypot, log

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from aerial_gym.config.controller import ControllerCfg
from aerial_gym.config.robot import RobotCfg
from aerial_gym.config.sim import STANDARD_GRAVITY
from aerial_gym.control import make_controller
from aerial_gym.control.allocation import Allocation
from aerial_gym.control.gains import apparent_gravity
from aerial_gym.control.hover import trim_axes
from aerial_gym.control.stability import AXES, ClosedLoop
from aerial_gym.errors import ConfigError
from aerial_gym.math.quaternion import quat_exp, quat_log
from aerial_gym.physics import BodyState, build_model, vehicle_from_config
from aerial_gym.physics.articulated.articulation import build_articulation
from aerial_gym.physics.capabilities import choose_backend, robot_needs
from aerial_gym.physics.effects import EffectParams, WindEffect
from aerial_gym.physics.model import robot_effects
from aerial_gym.physics.state import ArticulatedState
from aerial_gym.physics.vehicle import Vehicle
from aerial_gym.robots.joints.tail_servo import TailServo, derive_tail_servo, tail_rotor

Array = NDArray[np.float64]

FACTOR_HALVINGS = 60  # Of a factor, to rounding
LARGEST = 1e6  # Force [N] or torque [N m] that is more than any rotor gives


class TailRotorModel:
    """Forces and torques of such a vehicle, about the angle at which its tail holds hover.

    Args:
        matrix: Force and torque per thrust of each rotor as all point along their axes in the reference pose, (6, R).
        low: Lowest thrusts [N], (R,).
        high: Highest thrusts [N], (R,).
        gravity: Downward acceleration of free fall [m/s²].

    Raises:
        ConfigError: If no rotor of the robot is a tail on a servo.
    """

    def __init__(
        self, robot: RobotCfg, matrix: Array, low: Array, high: Array, *, gravity: float = STANDARD_GRAVITY
    ) -> None:
        self.tail = tail_rotor(robot)
        self.angles = derive_tail_servo(robot, dt=0.0, gravity=gravity).limits
        self._low, self._high = low, high
        upright = matrix[:, self.tail]
        arm = np.subtract(robot.mounts.layout[self.tail].position, robot.body.com)
        drag = upright[3:] - np.cross(arm, upright[:3])  # torque of the rotor itself, along its axis
        side = np.array([0.0, -1.0, 0.0])
        lean = np.concatenate((side, np.cross(arm, side) + drag[2] * side))
        self.columns = np.column_stack((matrix, lean))
        self._inverse = np.linalg.pinv(self.columns[2:])

    def unknowns_of_lift(self, lift: float, torque: Sequence[float] = (0.0, 0.0, 0.0)) -> Array:
        """Return the unknowns for a force along z [N] and a torque [N m]: thrusts, the tail's z and -y components [N]."""
        return self._inverse @ np.array([lift, *torque])

    def rotor_thrusts(self, unknowns: Array) -> Array:
        """Return the thrust of each rotor [N], (R,)."""
        values = unknowns[:-1].copy()
        values[self.tail] = hypot(unknowns[self.tail], unknowns[-1])
        return values

    def tail_angle(self, unknowns: Array) -> float:
        """Return the angle of the tail [rad]."""
        return atan2(unknowns[-1], unknowns[self.tail])

    def wrench(self, unknowns: Array) -> Tensor:
        """Return force [N] and torque [N m], (6,), without the tail's side force, which roll balances."""
        values = self.columns @ unknowns
        values[1] += unknowns[-1]
        return torch.from_numpy(values)

    def roll(self, unknowns: Array) -> float:
        """Return the angle about x [rad] at which the weight balances the side force."""
        force = self.columns @ unknowns
        return atan2(force[1], force[2])

    def first_limited_rotor(self, unknowns: Array) -> int | None:
        """Return the index of the first rotor beyond its limits, for the tail also the servo's; None if all are within."""
        thrusts = self.rotor_thrusts(unknowns)
        beyond = np.flatnonzero((thrusts < self._low) | (thrusts > self._high))
        if beyond.size:
            return int(beyond[0])
        return None if self.angles[0] <= self.tail_angle(unknowns) <= self.angles[1] else self.tail

    def control_margin(self, lift: float, axis: int) -> tuple[float, int | None]:
        """Return the symmetric control margin at a lift [N], and the number from 0 of the limiting rotor or its servo.

        Axis 0 is the force along z [N], 1 to 3 are the torques about x, y, z [N m].
        """
        hover, step = self.unknowns_of_lift(lift), self._inverse[:, axis]
        return _largest_command_within_limits(
            lambda size: next(
                (
                    rotor
                    for way in (1, -1)
                    if (rotor := self.first_limited_rotor(hover + way * size * step)) is not None
                ),
                None,
            )
        )

    def largest_lift(self) -> float:
        """Return the largest force along z without torque [N]."""
        return _largest_command_within_limits(
            lambda size: next(
                iter(np.flatnonzero(self.rotor_thrusts(self.unknowns_of_lift(size)) > self._high).tolist()), None
            )
        )[0]


def _largest_command_within_limits(stopped_by: Callable[[float], int | None]) -> tuple[float, int | None]:
    """Return the largest size without a violation, and the first violation beyond it."""
    size, ends, last = 0.0, LARGEST, None
    for _ in range(FACTOR_HALVINGS):
        middle = 0.5 * (size + ends)
        stopped = stopped_by(middle)
        size, ends, last = (middle, ends, last) if stopped is None else (size, middle, stopped)
    return size, last


def tail_rotor_model(
    robot: RobotCfg, matrix: Array, low: Array, high: Array, *, gravity: float = STANDARD_GRAVITY
) -> TailRotorModel | None:
    """Return the model of a vehicle with a tail servo; None without one."""
    try:
        return TailRotorModel(robot, matrix, low, high, gravity=gravity)
    except ConfigError:
        return None


NUM_FLIGHTS = 8  # Starts of each time step, side by side
DISTURBANCE = (0.1, 0.1, 0.1, 0.2)  # Largest offset of a start from hover on each axis [m, rad, m/s, rad/s]
SPAN, STEPS = 60.0, 400  # Of a flight [s], and steps beyond it: gains that are derived for a long time step are slower
STEP_RANGE = (5e-4, 0.1)  # Time steps [s] between which the largest one is looked for
HEADING = ("yaw", "r")  # The `AXES` that a tail servo controls
AT_REST = 0.05  # Share of the disturbance that is left at rest
SLOW = 4.0  # Two as starts are on both sides of rest, and two as the linearised loop does not begin with empty filters
HALVINGS = 9  # Of the logarithm of that range: to 1 % of the time step
CEILING = 1e3  # Height of the ceiling [m] for effects that ask for one: out of reach


@dataclass(frozen=True, kw_only=True)
class StableStep:
    """Largest stable time step of a controller."""

    controller: str  # Its name
    largest_s: float | None = None  # Largest step at which all flights come to rest, with 6 dB of gain margin [s]
    at_least: bool = False  # Whether that is the end of ``STEP_RANGE``, and the true one is larger
    little_margin: bool = False  # Whether no time step has a gain margin of 6 dB
    refused: str | None = None  # Why the controller does not fit the robot


def largest_stable_step(robot: RobotCfg, controller: ControllerCfg, *, name: str, gravity: float = 9.81) -> StableStep:
    """Return the largest time step at which a robot comes to rest under a controller, which is built for each time step.

    Flights start with different disturbances on the controlled axes. They are at rest if in their last tenth the state
    differs by less than ``AT_REST`` of the disturbance between flights and times. The rest pose may differ from declared
    hover: a slung load lowers it. Wind effects are left out, as gusts prevent rest.
    """
    (step,) = largest_stable_steps(robot, {name: controller}, gravity=gravity)
    return step


def largest_stable_steps(
    robot: RobotCfg, controllers: Mapping[str, ControllerCfg], *, gravity: float = 9.81,
    progress: Callable[[str, float], None] = lambda _text, _share: None,
) -> list[StableStep]:  # fmt: skip
    """Return ``largest_stable_step`` of several controllers by name; their kernels are compiled side by side."""
    searches, steps = [], []
    for number, (name, controller) in enumerate(controllers.items()):
        progress(f"analysing {name}", 0.5 * number / len(controllers))
        searches.append(_search_step(robot, controller, name, gravity))
        steps.append(next(searches[-1]))
    for number, (name, search) in enumerate(zip(controllers, searches, strict=True)):
        progress(f"flying {name}", 0.5 + 0.5 * number / len(controllers))
        *_, steps[number] = (steps[number], *search)
    return steps


def _search_step(robot: RobotCfg, controller: ControllerCfg, name: str, gravity: float) -> Iterator[StableStep]:
    """Yield the largest time step of the linearised loop, while its flights are compiled, and then that of flights."""
    axes = trim_axes(controller)
    if not axes:
        unknown = "its law states no trim: the axes that it controls"
        yield StableStep(controller=name, refused=unknown if axes is None else "commands rotors, and holds nothing")
        return
    try:
        loop = ClosedLoop(robot, controller, gravity=gravity, integrator="euler", names=("this", name))
        for is_stable, little_margin in ((loop.is_stable_with_margin, False), (loop.is_stable, True)):
            largest = _largest_passing_step(is_stable)
            if largest is None:
                continue
            flights = RestFlights(robot, controller, largest, loop, gravity)
            yield _stable_step(name, largest, little_margin=little_margin)
            if not flights.end_at_rest():
                largest = _largest_passing_step(
                    lambda dt: is_stable(dt) and RestFlights(robot, controller, dt, loop, gravity).end_at_rest()  # noqa: B023
                )
            if largest is not None:
                yield _stable_step(name, largest, little_margin=little_margin)
                return
        yield StableStep(controller=name)
    except ConfigError as error:
        yield StableStep(controller=name, refused=str(error))


def _stable_step(name: str, largest: float, *, little_margin: bool) -> StableStep:
    at_least = largest == STEP_RANGE[1]
    return StableStep(controller=name, largest_s=largest, at_least=at_least, little_margin=little_margin)


def _largest_passing_step(holds: Callable[[float], bool]) -> float | None:
    """Return the largest time step [s] of ``STEP_RANGE`` that holds; None if the smallest does not."""
    low, high = STEP_RANGE
    if holds(high):
        return high
    if not holds(low):
        return None
    for _ in range(HALVINGS):
        middle = exp(0.5 * (log(low) + log(high)))
        low, high = (middle, high) if holds(middle) else (low, middle)
    return low


def _steps_between_samples(dt: float) -> int:
    """Return the physics steps of a hundredth of a flight."""
    return ceil(0.01 * (SPAN / dt + STEPS))


def make_tail_servo(robot: RobotCfg, dt: float, gravity: float) -> TailServo | None:
    """Return the heading servo of a tricopter at a time step [s]; None without a tail servo."""
    try:
        return derive_tail_servo(robot, dt=dt, gravity=gravity)
    except ConfigError:
        return None


class RestFlights:
    """Flights with a time step [s] from different disturbances near hover; the kernel is compiled from construction on."""

    def __init__(self, robot: RobotCfg, controller: ControllerCfg, dt: float, loop: ClosedLoop, gravity: float) -> None:
        self._dt, self._loop, self._tail = dt, loop, make_tail_servo(robot, dt, gravity)
        held = (*loop.axes.split(), *(() if self._tail is None else HEADING))
        self._kept = torch.tensor([name in held for name in AXES])
        self._size = torch.tensor(DISTURBANCE).repeat_interleave(3)
        vehicle = vehicle_from_config(robot, num_envs=NUM_FLIGHTS)
        model = build_model(
            vehicle, _effects_without_wind(robot), gravity=gravity, ceiling_height=CEILING,
            articulation=None if self._tail is None else build_articulation(robot, like=vehicle.mass),
        )  # fmt: skip
        law = make_controller(controller, vehicle, gravity, dt=dt, control=robot.control)
        self._backend = choose_backend("auto", needs=robot_needs(robot, torch.device("cpu"), integrator="euler"))
        self._backend.allocate(model, law, integrator="euler")
        self._backend.prepare(dt)
        felt = apparent_gravity(robot.control, robot.body.mass, gravity)
        self._start = torch.where(self._kept, self._size, 0.0)
        self._state: BodyState = _starts_with_disturbance(self._start, _hover_speeds(vehicle, felt))
        self._action = torch.zeros(NUM_FLIGHTS, len(law.action_names))
        if self._tail is not None:
            self._action = torch.nn.functional.pad(self._action, (0, 1))
            self._state = _add_tail_state(self._state, self._tail)

    def end_at_rest(self) -> bool:
        """Fly, and return whether all end at one and the same rest on the axes that law and rotors control.

        A slow integrator takes minutes to settle without instability: flights may be ``SLOW`` times as far from rest as the
        linearised loop at that time.
        """
        last = self._distances_in_last_tenth() / self._size
        apart = last.amax((0, 1)) - last.amin((0, 1))
        steps = 90 * _steps_between_samples(self._dt)
        left = SLOW * self._loop.deviation_bound(self._dt, steps, self._start).float() / self._size
        return bool((apart < left.clamp_min(AT_REST))[self._kept].all())  # written so that NaN fails as well

    def _distances_in_last_tenth(self) -> Tensor:
        """Return distances from hover at ten moments at the end of the flights, (10, E, 12)."""
        steps, distances, state = _steps_between_samples(self._dt), [], self._state
        self._fly(90 * steps)
        for _ in range(10):
            self._fly(steps)
            distances.append(
                torch.cat((state.position, quat_log(state.attitude), state.lin_vel, state.ang_vel), dim=-1)
            )
        return torch.stack(distances)

    def _fly(self, steps: int) -> None:
        if self._tail is None:
            self._backend.step(self._state, self._action, self._dt, steps)
            return
        ahead = torch.zeros(NUM_FLIGHTS)
        for _ in range(steps):
            self._action[:, -1] = self._tail.command_angle(self._state.attitude, self._state.ang_vel, ahead)
            self._backend.step(self._state, self._action, self._dt, 1)


def _hover_speeds(vehicle: Vehicle, gravity: float) -> Tensor:
    weight = torch.zeros(NUM_FLIGHTS, 6)
    weight[:, 2] = vehicle.mass * gravity
    return Allocation(vehicle, gravity).speed_for_wrench(weight)


def _add_tail_state(state: BodyState, tail: TailServo) -> ArticulatedState:
    """Return the starts with the tail servo at its hover angle."""
    angle = torch.full((NUM_FLIGHTS, 1), tail.trim)
    return ArticulatedState(**vars(state), joint_pos=angle, joint_vel=torch.zeros_like(angle))


def _effects_without_wind(robot: RobotCfg) -> list[EffectParams]:
    cpu = torch.device("cpu")
    effects = robot_effects(robot, num_envs=NUM_FLIGHTS, device=cpu, dtype=torch.float32, rigid=True)
    return [(effect, params) for effect, params in effects if not isinstance(effect, WindEffect)]


def _starts_with_disturbance(size: Tensor, rotors: Tensor) -> BodyState:
    """Return the disturbed starts: the corners of a cube, in another order for each quantity."""
    corners = torch.tensor([[1.0 if (i >> axis) & 1 else -1.0 for axis in range(3)] for i in range(NUM_FLIGHTS)])
    place, turn, lin_vel, ang_vel = (part * corners.roll(3 * i, 0) for i, part in enumerate(size.split(3)))
    return BodyState(position=place, attitude=quat_exp(turn), lin_vel=lin_vel, ang_vel=ang_vel, rotor_speed=rotors)
