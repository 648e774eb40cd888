"""Effects on each link of a vehicle with joints.

Axes of a link are those of the body in the reference pose. Effects leave out links without mass.
Letters: E environments, L links (the base first), P parameters.
"""

from abc import abstractmethod

from torch import Tensor

from aerial_gym.physics.effects.base import ANY_ROTOR, Effect


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
