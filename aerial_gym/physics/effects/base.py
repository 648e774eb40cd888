"""What every physical effect states: the hinge between simulation and identification.

An effect is one file. It gives its parameters with unit, bounds and neutral value, what it acts on, what must vary in a
flight for it to be seen, what it can be confused with, and its formula once. Simulation and identification call the same
methods, so that they cannot drift apart. Parameters are per environment, (E, P).
Frames: body is x forward, y left, z up; world is z up.
"""

from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from math import inf
from typing import ClassVar, Literal

import torch
import warp as wp
from torch import Tensor

from aerial_gym.config.robot import RobotCfg
from aerial_gym.errors import CapabilityError, ConfigError
from aerial_gym.math.quaternion import quat_rotate_inverse
from aerial_gym.math.rows import times
from aerial_gym.math.short import dot, sum_slices
from aerial_gym.physics.effects.track import Track
from aerial_gym.physics.vehicle import Vehicle, is_shared, share_row

RotorTrait = Literal["reversible", "force", "slew", "dead_band"]
"""Of ``config.rotor.ROTOR_TRAITS``."""

ANY_ROTOR: tuple[RotorTrait, ...] = ("reversible", "force", "slew", "dead_band")
"""Of an effect that does not depend on what the state of a rotor is."""

ActsOn = Literal["rotor", "actuation", "wrench", "inertia", "environment", "sensor"]


@dataclass(frozen=True, kw_only=True)
class Parameter:
    """One number of an effect."""

    name: str
    """Short name, as in robot files and verdicts."""

    unit: str
    """SI unit."""

    low: float
    """Lowest value that is physically possible."""

    high: float
    """Highest value that is physically possible."""

    scale: float
    """A change that one would call moderate: the step of numerical derivatives and fits."""

    meaning: str
    """One line."""

    kind: Literal["number", "rotor", "convention"] = "number"
    """A number that a fit may change, the number of a rotor (1 to R), or a convention that a fit keeps."""


@dataclass(frozen=True, kw_only=True)
class Condition:
    """The instant at which a force is asked for."""

    position: Tensor
    """Centre of mass [m], world, (E, 3)."""

    attitude: Tensor
    """Body to world, xyzw, (E, 4)."""

    air_velocity: Tensor
    """Velocity of the centre of mass through the air [m/s], body axes, (E, 3)."""

    ang_vel: Tensor
    """Angular velocity [rad/s], body, (E, 3)."""

    rotor_speed: Tensor
    """Rotor speeds [rad/s], (E, R)."""

    rotor_thrust: Tensor
    """Rotor thrusts [N], (E, R)."""

    rotor_acc: Tensor
    """Angular accelerations of the rotors about their axes, positive where they speed up [rad/s²], (E, R)."""

    ground_height: float | Tensor
    """Height of the ground [m], world; or (E, 1)."""

    ceiling_height: float | Tensor
    """Height of the ceiling [m], world; not a number where there is none; or (E, 1)."""

    other_position: Tensor
    """Another vehicle, whose wake streams down [m], world, (E, 3)."""

    vehicle: Vehicle
    """Gives the geometry."""

    @cached_property
    def lever(self) -> Tensor:
        """Hubs from the centre of mass [m], body, (E, R, 3); (1, R, 3) where all environments have the same."""
        hubs, com = self.vehicle.rotor_position, self.vehicle.com
        if is_shared(hubs) and is_shared(com):
            return share_row(hubs[0] - com[0], 1)
        return hubs - com.unsqueeze(1)

    @cached_property
    def axis(self) -> Tensor:
        """Directions of thrust, body, (E, R, 3); (1, R, 3) where all environments have the same."""
        axis = self.vehicle.rotor_axis
        return axis[:1] if is_shared(axis) else axis

    @cached_property
    def hub_velocity(self) -> Tensor:
        """Velocity of the hubs through the air [m/s], body, (E, R, 3): ``v + w x l``, in the wind at the centre of mass."""
        return self.air_velocity.unsqueeze(1) + velocity_of_turning(self.ang_vel, self.lever)

    @cached_property
    def up(self) -> Tensor:
        """World z in body axes, (E, 3)."""
        up = torch.zeros_like(self.position)
        up[:, 2] = 1.0
        return quat_rotate_inverse(self.attitude, up)

    @cached_property
    def hub_altitude(self) -> Tensor:
        """World z of the hubs [m], (E, R)."""
        return self.position[:, 2:] + dot(self.lever, self.up.unsqueeze(1))

    @cached_property
    def axis_height(self) -> Tensor:
        """World z of the directions of thrust, -1 to 1, (E, R)."""
        return dot(self.axis, self.up.unsqueeze(1))

    @property
    def wake_room(self) -> Tensor:
        """Distance of the hubs to what their wakes blow at [m], (E, R): the ground, or the ceiling where thrust points down."""
        return torch.where(self._wake_goes_up, self._room_above, self._room_below)

    @property
    def inlet_room(self) -> Tensor:
        """Distance of the hubs to what bounds the air that they draw in [m], (E, R): the ceiling, or the ground likewise."""
        return torch.where(self._wake_goes_up, self._room_below, self._room_above)

    @property
    def _wake_goes_up(self) -> Tensor:
        return self.rotor_thrust * self.axis_height < 0.0

    @cached_property
    def _room_below(self) -> Tensor:
        return self.hub_altitude - self.ground_height

    @cached_property
    def _room_above(self) -> Tensor:
        return (self.ceiling_height - self.hub_altitude).nan_to_num(nan=inf)

    @cached_property
    def axial_velocity(self) -> Tensor:
        """Velocity of the hubs through the air along their rotors' axes [m/s], (E, R)."""
        return dot(self.hub_velocity, self.axis)

    @cached_property
    def edgewise_velocity(self) -> Tensor:
        """Velocity of the hubs through the air in the planes of their rotors [m/s], body, (E, R, 3)."""
        return self.hub_velocity - self.axial_velocity.unsqueeze(-1) * self.axis

    def with_thrust(self, thrust: Tensor) -> "Condition":
        """Return the condition with other thrusts [N], (E, R); what follows from the motion is not worked out again."""
        return self._with(replace(self, rotor_thrust=thrust))

    def of_vehicle(self, vehicle: Vehicle, thrust: Tensor) -> "Condition":
        """Return the condition of a vehicle of the same centre of mass and hubs, with its thrusts [N], (E, R)."""
        return self if vehicle is self.vehicle else self._with(replace(self, vehicle=vehicle, rotor_thrust=thrust))

    def _with(self, other: "Condition") -> "Condition":
        """Return another condition of the same motion, with what was worked out of it here."""
        for name in _FROM_MOTION & vars(self).keys():
            vars(other)[name] = vars(self)[name]
        return other


_FROM_MOTION = {name for name, value in vars(Condition).items() if isinstance(value, cached_property)}


def velocity_of_turning(ang_vel: Tensor, lever: Tensor) -> Tensor:
    """Return ``w x l``, (E, R, 3), for w (E, 3) and l (E, R, 3) or, shared, (1, R, 3); a row is the same among any number."""
    if not is_shared(lever):
        return torch.linalg.cross(ang_vel.unsqueeze(1), lever, dim=-1)
    return times(ang_vel, _unit_turns(lever[0]).transpose(0, 1).reshape(3, -1)).view(-1, lever.shape[1], 3)


def sum_of_crosses(vector: Tensor, arm: Tensor) -> Tensor:
    """Return ``sum_r v_r x a_r``, (E, 3), for vectors v (E, R, 3) and arms a (E, R, 3) or, shared, (1, R, 3)."""
    if not is_shared(arm):
        return sum_slices(torch.linalg.cross(vector, arm, dim=-1), 1)
    return times(vector.flatten(1), _unit_turns(arm[0]).reshape(-1, 3))


def _unit_turns(arm: Tensor) -> Tensor:
    """Return ``e_k x a`` in row k, (R, 3, 3), for arms a (R, 3)."""
    x, y, z = arm.unbind(-1)
    zero = torch.zeros_like(x)
    return torch.stack((zero, -z, y, z, zero, -x, -y, x, zero), dim=-1).view(-1, 3, 3)


@dataclass(frozen=True, kw_only=True)
class Moment:
    """The start of a substep, at which an effect brings its memory up to date."""

    rotor_speed: Tensor
    """Rotor speeds [rad/s], (E, R)."""

    since: Tensor
    """Substeps since the environment was reset, int, (E,)."""

    random: Tensor
    """Random states of this substep, for ``math.random.counted_normal``, (E,)."""

    dt: float
    """Length of the substep [s]."""

    vehicle: Vehicle
    """With the effects on its parameters applied."""


@dataclass(frozen=True, kw_only=True)
class Suspension:
    """How the body origin, on which a load hangs, would move without the load."""

    acceleration: Tensor
    """Of the origin, gravity included [m/s²], world, (E, 3)."""

    mobility: Tensor
    """Acceleration of the origin per force on it [1/kg], world, (E, 3, 3)."""

    gravity: float
    """Downward acceleration of free fall [m/s²]."""


class Effect(ABC):
    """A named physical effect. Subclasses say where they act.

    ``VehicleEffect``, ``WindEffect``, ``RotorEffect``, ``WrenchEffect``, ``FluidEffect``, ``LoadEffect``, ``DelayEffect``,
    ``CommandEffect``, ``ImuEffect``, ``RotorSensorEffect``, and those of ``on_links``. An effect on the wind, rotors, wrench or
    command may remember M numbers of each environment: the backend keeps them, and passes them behind the parameters wherever
    it calls the effect, (E, P + M).
    """

    kind: ClassVar[type["Effect"]]
    """Which of those it is: the direct subclass of ``Effect`` in its line."""
    twin: ClassVar[str | None] = None
    """Name of the method that gives the Warp code of its kind; None for a kind that costs nothing in a step."""
    name: ClassVar[str]
    summary: ClassVar[str]
    acts_on: ClassVar[ActsOn]
    parameters: tuple[Parameter, ...]
    """In the order of the columns P; of the class, unless they have names of parts of a robot (``of``)."""
    excitation: ClassVar[str]
    """What must vary in a flight for the effect to be visible."""
    confused_with: ClassVar[tuple[str, ...]]
    """Names of effects that can look alike, and so must be weighed against this one."""
    contains: ClassVar[tuple[str, ...]] = ()
    """Effects with as many parameters that it is a wider case of: where flights do not tell them apart, these are meant."""
    memory: ClassVar[tuple[float, ...]] = ()
    """Values right after a reset of the numbers that it remembers of each environment."""
    drifting: ClassVar[tuple[int, ...]] = ()
    """Places in ``memory`` of numbers that grow throughout a flight, such as a drawn charge: they never come to rest."""
    rotor_memory: ClassVar[tuple[float, ...]] = ()
    """Values right after a reset of what it remembers of each rotor; all rotors of the first one come first."""
    needs: ClassVar[tuple[Literal["position", "ceiling_height", "other_position"], ...]] = ()
    """What of the scene it needs."""
    follows: ClassVar[tuple[Literal["position", "velocity", "voltage"], ...]] = ()
    """On what its force depends, so that an imperfect law leaves a residual which follows it."""
    told_by_torques: ClassVar[bool] = False
    """Whether torques tell it from what else pushes alike: without them it is not looked for."""
    logged: ClassVar[tuple[Literal["battery"], ...]] = ()
    """What a log must hold in place of its memory."""
    rotors: ClassVar[tuple[RotorTrait, ...]] = ("slew", "dead_band")
    """What rotors may have beyond a plain speed under it; with others it is refused by name."""
    at_hubs: ClassVar[bool] = False
    """Whether hubs and rotors alone make it: where the centre of mass is changes its torque by the lever of its force, and
    nothing else; and on a vehicle that bends it acts on the links that rotors sit on, by the motion of these."""
    on_joints: ClassVar[bool] = True
    """Whether a vehicle that bends can have it: unless it is at hubs, at its base, with the geometry of its reference pose."""
    on_rigid: ClassVar[bool] = True
    """Whether a vehicle without joints can have it, and so whatever takes a vehicle as rigid in its reference pose."""
    instead: ClassVar[tuple[str, ...]] = ()
    """What vehicles that cannot have it, with joints or without, can have in its place."""
    medium: ClassVar[Literal["air", "water"]] = "air"
    """In what it matters; flights are in air."""
    random: ClassVar[bool] = False
    """Whether chance decides what it does, so that it predicts no row of a flight."""

    def __init_subclass__(cls) -> None:
        """Make each direct subclass a kind."""
        super().__init_subclass__()
        if Effect in cls.__bases__:
            cls.kind = cls

    by_default: ClassVar[bool] = True
    """Whether it is looked for also where nobody says what to look for; not where others together do what it does."""

    @property
    def sought(self) -> bool:
        """Whether it can be looked for in flights."""
        return self.predicts and self.medium == "air"

    @property
    def predicts(self) -> bool:
        """Whether a vehicle that is taken as rigid is predicted with it."""
        return self.on_rigid and not self.random

    @property
    def has_twin(self) -> bool:
        """Whether it can run in the fused kernel: all that it does in a step has Warp code."""
        mine, kind = type(self), self.kind
        if mine.remember is not Effect.remember and mine.warp_remember is Effect.warp_remember:
            return False
        return kind.twin is None or getattr(mine, kind.twin) is not getattr(kind, kind.twin)

    @property
    def remembers(self) -> bool:
        """Whether it has memory of its own."""
        return bool(self.memory or self.rotor_memory)

    def fresh_memory(self, num_rotors: int) -> tuple[float, ...]:
        """Return the M numbers that it remembers of an environment right after a reset."""
        return self.memory + tuple(number for number in self.rotor_memory for _ in range(num_rotors))

    def remember(self, moment: Moment, values: Tensor) -> Tensor:
        """Return what it remembers during the substep that begins, (E, M), from parameters and memory (E, P + M).

        Forces of the substep are those of this memory, held: a splitting of order 1.
        """
        del moment
        return values[:, len(self.parameters) :]

    def replay(self, track: Track, params: Tensor) -> Tensor:
        """Return what it remembers in every row of a measured flight, (T, M), from parameters (1, P).

        Identification needs it of effects on rotors and body that remember.

        Raises:
            CapabilityError: If the effect does not say.
        """
        del track, params
        raise CapabilityError(f"effect {self.name}: remembers, but cannot be followed along a flight: it has no replay")

    def warp_remember(self, vehicle: type, moment: type) -> wp.Function | None:
        """Return the twin of ``remember``, or None: what is remembered never changes.

        Args:
            vehicle: The ``wp.struct`` of the vehicle.
            moment: The ``wp.struct`` with the fields of ``Moment`` for this number of rotors.

        Returns:
            A ``wp.func`` (vehicle, moment, values: vector of P + M) -> parameters and new memory.
        """
        del vehicle, moment
        return None

    def neutral(self, robot: RobotCfg) -> tuple[float, ...]:
        """Return the parameters with which the robot behaves as declared; zeros unless a subclass says otherwise."""
        del robot
        return (0.0,) * len(self.parameters)

    def starts(self, robot: RobotCfg) -> list[tuple[float, ...]]:
        """Return the parameters from which fits are tried: the neutral ones, once for each rotor if it acts on one."""
        neutral = self.neutral(robot)
        if self.parameters[0].kind != "rotor":
            return [neutral]
        return [(float(rotor), *neutral[1:]) for rotor in range(1, robot.num_rotors + 1)]

    def bounds(self, robot: RobotCfg) -> list[tuple[float, float]]:
        """Return the lowest and highest value of each parameter that is physically possible for a robot."""
        del robot
        return [(parameter.low, parameter.high) for parameter in self.parameters]

    def of(self, robot: RobotCfg) -> "Effect":
        """Return the effect as a robot file declares it: itself, unless its parameters have names of parts of the robot.

        Raises:
            ConfigError: If the robot has no such part.
        """
        del robot
        return self

    def to(self, dtype: torch.dtype) -> "Effect":
        """Return the effect for another float type: itself, unless it holds numbers of its own."""
        del dtype
        return self

    def check(self, robot: RobotCfg) -> None:
        """Raise ``ConfigError`` if the robot file lacks a number that the effect needs."""
        del robot

    def params_from(self, values: Mapping[str, float]) -> tuple[float, ...]:
        """Return the parameters in order; raise ``ConfigError`` if one is unknown, missing or out of bounds."""
        known = [parameter.name for parameter in self.parameters]
        if set(values) != set(known):
            raise ConfigError(f"effect {self.name}: parameters {sorted(values)} given, needs exactly {known}")
        for parameter in self.parameters:
            value = values[parameter.name]
            if not parameter.low <= value <= parameter.high:
                raise ConfigError(
                    f"effect {self.name}.{parameter.name} = {value!r}: "
                    f"must lie in [{parameter.low:g}, {parameter.high:g}] {parameter.unit}"
                )
        return tuple(float(values[name]) for name in known)


class VehicleEffect(Effect):
    """An effect that is a change of the vehicle's parameters: it costs nothing in a step."""

    @abstractmethod
    def adjust(self, vehicle: Vehicle, params: Tensor) -> Vehicle:
        """Return the vehicle with the effect in it. ``params`` is (E, P)."""


class WindEffect(Effect):
    """An effect that moves the air."""

    acts_on = "environment"
    twin = "warp_wind"
    rotors = ANY_ROTOR

    @abstractmethod
    def wind(self, position: Tensor, params: Tensor) -> Tensor:
        """Return the velocity of the air [m/s], world, (E, 3), at ``position`` [m], world, (E, 3)."""

    def warp_wind(self) -> wp.Function | None:
        """Return the twin of ``wind`` for one environment, a ``wp.func`` (position: wp.vec3, params: vector of P) -> wp.vec3.

        None where there is none: the effect then runs on the torch backend only.
        """
        return None


class RotorEffect(Effect):
    """A change of thrust, rotor by rotor. The drag torque of the rotors stays what it is."""

    acts_on = "rotor"
    twin = "warp_thrust"
    at_hubs = True

    @abstractmethod
    def thrust(self, condition: Condition, params: Tensor) -> Tensor:
        """Return the thrust that comes to the rotors' own [N], (E, R); ``condition.rotor_thrust`` is their own."""

    def warp_thrust(self, condition: type, hub: type) -> wp.Function | None:
        """Return the twin of ``thrust`` for one rotor, or None: the effect then runs on the torch backend only.

        Args:
            condition: The ``wp.struct`` with the fields of ``Condition`` for this number of rotors.
            hub: The ``wp.struct`` with what one rotor feels.

        Returns:
            A ``wp.func`` (condition, hub, params: vector of P) -> thrust [N].
        """
        del condition, hub
        return None


class WrenchEffect(Effect):
    """A force and torque on the body."""

    acts_on = "wrench"
    twin = "warp_wrench"

    @abstractmethod
    def wrench(self, condition: Condition, params: Tensor) -> Tensor:
        """Return force [N] and torque about the centre of mass [N m], body axes, (E, 6)."""

    def warp_wrench(self, condition: type) -> wp.Function | None:
        """Return the twin of ``wrench`` for one environment, or None: the effect then runs on the torch backend only.

        Args:
            condition: The ``wp.struct`` with the fields of ``Condition`` for this number of rotors.

        Returns:
            A ``wp.func`` (condition, params: vector of P) -> force and torque, body, ``wp.spatial_vector``.
        """
        del condition
        return None


class LinearWrenchEffect(WrenchEffect):
    """A force and torque on the body that is linear in its parameters."""

    @abstractmethod
    def regressor(self, condition: Condition) -> Tensor:
        """Return the matrix (E, 6, P) that maps parameters to force [N] and torque about the centre of mass [N m], body."""

    def wrench(self, condition: Condition, params: Tensor) -> Tensor:
        """Return force and torque (E, 6), body axes: the regressor times the parameters (E, P)."""
        return linear_wrench(self.regressor(condition), params)


def linear_wrench(regressor: Tensor, params: Tensor) -> Tensor:
    """Return force and torque (E, 6) of a regressor (E, 6, P) and parameters (E, P)."""
    return dot(regressor, params.unsqueeze(1))


class FluidEffect(Effect):
    """Fluid that a body sets in motion with it: it changes the accelerations that all forces together give. One at most.

    The body then has another mass along each of its axes, and moves by Kirchhoff's equations (``physics.kirchhoff``).
    """

    acts_on = "inertia"
    twin = "warp_entrain"
    rotors = ANY_ROTOR
    on_joints = False

    @abstractmethod
    def added_mass(self, params: Tensor) -> Tensor:
        """Return the mass of the fluid along each body axis [kg], (E, 3), from parameters (E, P)."""

    def warp_added_mass(self) -> wp.Function | None:
        """Return the twin of ``added_mass``, a ``wp.func`` (params: vector of P) -> wp.vec3, or None: torch backend only."""
        return None

    @abstractmethod
    def entrain(self, wrench: Tensor, condition: Condition, gravity: float, params: Tensor) -> Tensor:
        """Return the force [N] and torque [N m] under which the body alone would move as it does with the fluid, body, (E, 6).

        Args:
            wrench: Of everything else but gravity, likewise, (E, 6).
            condition: At this instant.
            gravity: Downward acceleration of free fall [m/s²].
            params: (E, P).
        """

    def warp_entrain(self, condition: type) -> wp.Function | None:
        """Return the twin of ``entrain``, or None: the effect then runs on the torch backend only.

        Args:
            condition: The ``wp.struct`` with the fields of ``Condition`` for this number of rotors.

        Returns:
            A ``wp.func`` (wrench: wp.spatial_vector, condition, mass [kg], gravity, params: vector of P) -> wp.spatial_vector.
        """
        del condition
        return None


class LoadEffect(Effect):
    """A body that hangs on the body origin by a massless rigid link. A vehicle has one at most.

    Its memory is the direction of the link, a unit vector n away from the origin, and its rate n', world. The steppers
    integrate them together with the vehicle, to their own order.
    """

    acts_on = "wrench"
    twin = "warp_pull"
    rotors = ANY_ROTOR
    on_joints = False
    memory = (0.0, 0.0, -1.0, 0.0, 0.0, 0.0)

    @abstractmethod
    def pull(self, suspension: Suspension, load: Tensor, params: Tensor) -> tuple[Tensor, Tensor]:
        """Return the force of the load on the body origin [N], world, (E, 3), and n'' [1/s²], (E, 3), for ``load`` (E, 6)."""

    def warp_pull(self, suspension: type) -> wp.Function | None:
        """Return the twin of ``pull``, or None: the effect then runs on the torch backend only.

        Args:
            suspension: The ``wp.struct`` with the fields of ``Suspension``, of single or of double precision.

        Returns:
            A ``wp.func`` (suspension, load: vector of 6, params: vector of P) -> (force, n''), vectors of 3, all of the
            precision of ``suspension``.
        """
        del suspension
        return None


class DelayEffect(Effect):
    """Commands that act late. A vehicle has one at most; the backend keeps the commands of the longest delay."""

    acts_on = "actuation"
    twin = "warp_delay"
    longest: ClassVar[float]
    """Upper bound of the delay [s]."""

    @property
    def remembers(self) -> bool:
        """Whether it has memory of its own: the commands on their way."""
        return True

    @abstractmethod
    def delay(self, params: Tensor) -> Tensor:
        """Return the delay [s], (E,), from parameters (E, P)."""

    def warp_delay(self) -> wp.Function | None:
        """Return the twin of ``delay``, a ``wp.func`` (params: vector of P) -> delay [s], or None: torch backend only."""
        return None


class CommandEffect(Effect):
    """A change of the speeds to which commands lead the rotors."""

    acts_on = "actuation"
    twin = "warp_command"

    @abstractmethod
    def command(self, command: Tensor, vehicle: Vehicle, params: Tensor) -> Tensor:
        """Return the speeds that the rotors tend to [rad/s], (E, R), under commanded ones (E, R)."""

    @abstractmethod
    def measured(self, voltage: Tensor) -> Tensor:
        """Return its memory in a flight, (T, M), from the voltage of the battery in each row of the log [V], (T,)."""

    def warp_command(self, vehicle: type, vector: type) -> wp.Function | None:
        """Return the twin of ``command``, or None: the effect then runs on the torch backend only.

        Args:
            vehicle: The ``wp.struct`` of the vehicle.
            vector: Type of a number for each rotor.

        Returns:
            A ``wp.func`` (command: vector, vehicle, params: vector of P + M) -> speeds [rad/s], vector.
        """
        del vehicle, vector
        return None


class ImuEffect(Effect):
    """An error of the inertial sensors: the vehicle flies as before, but is measured otherwise."""

    acts_on = "sensor"
    rotors = ANY_ROTOR

    @abstractmethod
    def measure(self, specific_force: Tensor, ang_vel: Tensor, params: Tensor) -> tuple[Tensor, Tensor]:
        """Return what is measured of a true specific force [m/s²] and angular velocity [rad/s], body, each (E, 3)."""


class RotorSensorEffect(Effect):
    """An error of the sensors of rotor speed: the vehicle flies as before, but is measured otherwise."""

    acts_on = "sensor"

    @abstractmethod
    def measure(self, rotor_speed: Tensor, params: Tensor) -> Tensor:
        """Return what is measured of true rotor speeds [rad/s], (E, R)."""

    @abstractmethod
    def true_speed(self, measured: Tensor, params: Tensor) -> Tensor:
        """Return the rotor speeds behind measured ones [rad/s], (E, R), the inverse of ``measure``."""
