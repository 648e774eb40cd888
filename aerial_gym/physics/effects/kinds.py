"""Kinds of effect: the hooks of a step that an effect can implement.

Axes of a link are those of the body in the reference pose. Effects leave out links without mass.
Letters: E environments, R rotors, L links (the base first), P parameters.
"""

from abc import abstractmethod
from dataclasses import dataclass
from typing import ClassVar

from torch import Tensor

from aerial_gym.math.rows import dot
from aerial_gym.physics.effects.base import ANY_ROTOR, Effect
from aerial_gym.physics.effects.condition import Condition
from aerial_gym.physics.vehicle import Vehicle


class WrenchEffect(Effect):
    """A force and torque on the body."""

    acts_on = "wrench"
    order = 2
    additive, accelerates, replayed = True, True, True

    @abstractmethod
    def wrench(self, condition: Condition, params: Tensor) -> Tensor:
        """Return force [N] and torque about the centre of mass [N m], body axes, (E, 6)."""


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


class RotorEffect(Effect):
    """A change of the thrust of each rotor; the drag torque stays unchanged."""

    acts_on = "rotor"
    order = 1
    additive, accelerates, replayed = True, True, True
    at_hubs = True

    @abstractmethod
    def thrust(self, condition: Condition, params: Tensor) -> Tensor:
        """Return the change of each rotor's thrust [N], (E, R), which is added to ``condition.rotor_thrust``."""


class WindEffect(Effect):
    """A velocity of the air that depends on the position."""

    acts_on = "environment"
    order = 0
    additive, accelerates, needs_com = True, True, True
    rotors = ANY_ROTOR

    @abstractmethod
    def wind(self, position: Tensor, params: Tensor) -> Tensor:
        """Return the velocity of the air [m/s], world, (E, 3), at ``position`` [m], world, (E, 3)."""


class VehicleEffect(Effect):
    """A change of the vehicle's parameters, made once: it costs nothing in a step."""

    @abstractmethod
    def adjust(self, vehicle: Vehicle, params: Tensor) -> Vehicle:
        """Return the vehicle with the effect applied; ``params`` is (E, P)."""


class DelayEffect(Effect):
    """A delay of the commands. The backend keeps the commands of the longest delay."""

    acts_on = "actuation"
    order, single = 8, "delay"
    longest: ClassVar[float]  # Upper bound of the delay [s]

    @property
    def remembers(self) -> bool:
        """Whether it has memory of its own: the delayed commands."""
        return True

    @abstractmethod
    def delay(self, params: Tensor) -> Tensor:
        """Return the delay [s], (E,), from parameters (E, P)."""


class CommandEffect(Effect):
    """A change of the rotor speed that a command requests, such as by battery voltage or a motor failure."""

    acts_on = "actuation"
    order = 7

    @abstractmethod
    def command(self, command: Tensor, vehicle: Vehicle, params: Tensor) -> Tensor:
        """Return the speeds [rad/s], (E, R), that the rotors approach under commanded speeds (E, R)."""

    def memory_from_voltage(self, voltage: Tensor) -> Tensor:
        """Return its memory along a flight, (T, M), from the logged battery voltage [V], (T,); that of a reset by default."""
        return voltage.new_tensor(self.memory).expand(len(voltage), -1)


class ImuEffect(Effect):
    """An error of the inertial sensors; it does not change the motion."""

    acts_on = "sensor"
    rotors = ANY_ROTOR

    @abstractmethod
    def measure(self, specific_force: Tensor, ang_vel: Tensor, params: Tensor) -> tuple[Tensor, Tensor]:
        """Return the measured specific force [m/s²] and angular velocity [rad/s] for the true ones, body, each (E, 3)."""


class RotorSensorEffect(Effect):
    """An error of the rotor speed sensors; it does not change the motion."""

    acts_on = "sensor"

    @abstractmethod
    def measure(self, rotor_speed: Tensor, params: Tensor) -> Tensor:
        """Return the measured rotor speeds [rad/s], (E, R), for the true ones."""

    @abstractmethod
    def true_speed(self, measured: Tensor, params: Tensor) -> Tensor:
        """Return the true rotor speeds [rad/s], (E, R), for the measured ones: the inverse of ``measure``."""


class AttitudeSensorEffect(Effect):
    """An error of the logged attitude; it does not change the motion, and the simulator's attitude has none."""

    acts_on = "sensor"
    rotors = ANY_ROTOR

    @abstractmethod
    def turn(self, params: Tensor) -> Tensor:
        """Return roll, pitch and yaw from the axes of the logged attitude to those of the body [rad], (E, 3)."""


class FluidEffect(Effect):
    """Fluid that moves with the body (added mass).

    The body then has a different mass along each of its axes, and follows Kirchhoff's equations (``physics.integrators``).
    """

    acts_on = "inertia"
    order, single = 3, "fluid"
    accelerates, needs_com = True, True
    rotors = ANY_ROTOR
    on_joints = False

    @abstractmethod
    def added_mass(self, params: Tensor) -> Tensor:
        """Return the mass of the fluid along each body axis [kg], (E, 3), from parameters (E, P)."""

    @abstractmethod
    def wrench_with_fluid(self, wrench: Tensor, condition: Condition, gravity: float, params: Tensor) -> Tensor:
        """Return the wrench without weight that gives the body alone the acceleration of body and fluid, (E, 6), body axes.

        Args:
            wrench: Force and torque of all other causes without gravity, body axes, (E, 6).
            condition: State and surroundings.
            gravity: Downward acceleration of free fall [m/s²].
            params: (E, P).
        """


@dataclass(frozen=True, kw_only=True)
class SuspensionMotion:
    """Motion of the body origin, on which a load hangs, without the load."""

    acceleration: Tensor  # Acceleration of the origin, gravity included [m/s²], world, (E, 3)
    mobility: Tensor  # Acceleration of the origin per force on it [1/kg], world, (E, 3, 3)
    gravity: float  # Downward acceleration of free fall [m/s²]


class LoadEffect(Effect):
    """A body that hangs on the body origin by a massless rigid link.

    Its memory is the direction of the link, a unit vector n away from the origin, and its rate n', world.
    """

    acts_on = "wrench"
    order, single = 9, "load"
    accelerates, needs_com, moves_with_body = True, True, True
    needs = ("lin_vel",)
    rotors = ANY_ROTOR
    on_joints = False
    memory = (0.0, 0.0, -1.0, 0.0, 0.0, 0.0)

    @abstractmethod
    def pull(self, suspension: SuspensionMotion, load: Tensor, params: Tensor) -> tuple[Tensor, Tensor]:
        """Return the load's force on the origin [N], world, (E, 3), and n'' [1/s²], (E, 3); ``load`` is (n, n'), (E, 6)."""


class LinkEffect(Effect):
    """A damping of each link by its motion through the air.

    The force at the centre of mass of a link is ``-D_i u_i`` per axis of the link, with u its velocity through the air. The
    torque has the same form in its angular velocity. With D from the start of a step and u from its end, it is always stable.
    """

    acts_on = "wrench"
    order, single = 6, "damping of links"
    rotors = ANY_ROTOR
    on_rigid = False

    @abstractmethod
    def damping(self, velocity: Tensor, params: Tensor) -> Tensor:
        """Return the damping D of every link [N s/m, N m s/rad], >= 0, (E, L, 6).

        Args:
            velocity: Velocity of each centre of mass through the air [m/s] and angular velocity [rad/s], link axes, (E, L, 6).
            params: (E, P).
        """


class LinkWrenchEffect(Effect):
    """A force and torque on each link that depend on its attitude."""

    acts_on = "wrench"
    order = 4
    rotors = ANY_ROTOR
    on_rigid = False

    @abstractmethod
    def wrench(self, up: Tensor, params: Tensor) -> Tensor:
        """Return force [N] and torque about the centre of mass [N m] of every link, link axes, (E, L, 6).

        Args:
            up: World z, axes of each link, (E, L, 3).
            params: (E, P).
        """


class LinkFluidEffect(Effect):
    """Fluid that moves with each link: an added mass along each axis, without weight."""

    acts_on = "inertia"
    order, single = 5, "fluid of links"
    rotors = ANY_ROTOR
    on_rigid = False

    @abstractmethod
    def added_mass(self, num_links: int, params: Tensor) -> Tensor:
        """Return added masses [kg] and inertias [kg m²] of every link at its centre of mass, link axes, (E, L, 6).

        Args:
            num_links: L.
            params: (E, P).
        """
