"""Effects on each link of a vehicle that bends: their kinds, and parameters of all links or of one.

Axes of a link are those of the body in the reference pose. Links without mass feel nothing.
Letters: E environments, L links, the base first, P parameters.
"""

from abc import abstractmethod
from collections.abc import Sequence
from dataclasses import replace
from typing import ClassVar, Self, cast

import torch
import warp as wp
from torch import Tensor

from aerial_gym.config.robot import RobotCfg
from aerial_gym.errors import ConfigError
from aerial_gym.math.warp_functions import vector_of
from aerial_gym.physics.effects.base import ANY_ROTOR, Effect, Parameter


class LinkEffect(Effect):
    """A damping of each link of a vehicle that bends, by its motion through the air. A vehicle has one at most.

    The force on a link at its centre of mass is ``-D_i u_i`` per axis of the link, u its velocity through the air, and the
    torque likewise by its angular velocity. The engine takes u at the end of a step and D at its start, so that no D is too
    large for a step.
    """

    acts_on = "wrench"
    twin = "warp_damping"
    rotors = ANY_ROTOR
    on_rigid = False

    @abstractmethod
    def damping(self, velocity: Tensor, params: Tensor) -> Tensor:
        """Return D of every link [N s/m, N m s/rad], at least 0, (E, L, 6).

        Args:
            velocity: Of the centres of mass of the links through the air [m/s] and their angular velocity [rad/s], axes of
                each link, (E, L, 6); the base is the first link.
            params: (E, P).
        """

    def warp_damping(self, link: int) -> wp.Function | None:
        """Return the twin of ``damping`` for one link, or None: the effect does nothing to it.

        Args:
            link: Its number; 0 is the base.

        Returns:
            A ``wp.func`` (velocity: wp.spatial_vector, params: vector of P) -> D, ``wp.spatial_vector``.
        """
        del link
        return None


class LinkWrenchEffect(Effect):
    """A force and torque on each link of a vehicle that bends, by how it is turned."""

    acts_on = "wrench"
    twin = "warp_wrench"
    rotors = ANY_ROTOR
    on_rigid = False

    @abstractmethod
    def wrench(self, up: Tensor, params: Tensor) -> Tensor:
        """Return force [N] and torque about the centre of mass [N m] of every link, axes of the link, (E, L, 6).

        Args:
            up: World z, axes of each link, (E, L, 3).
            params: (E, P).
        """

    def warp_wrench(self, link: int) -> wp.Function | None:
        """Return the twin of ``wrench`` for one link, or None: the effect does nothing to it.

        Args:
            link: Its number; 0 is the base.

        Returns:
            A ``wp.func`` (up: wp.vec3, params: vector of P) -> force and torque, ``wp.spatial_vector``.
        """
        del link
        return None


class LinkFluidEffect(Effect):
    """Fluid that each link of a vehicle that bends sets in motion with it: as if it had another mass along each axis.

    It stands beside the mass of the link in the equations of motion, and weighs nothing. A vehicle has one at most.
    """

    acts_on = "inertia"
    twin = "warp_added"
    rotors = ANY_ROTOR
    on_rigid = False

    @abstractmethod
    def added(self, num_links: int, params: Tensor) -> Tensor:
        """Return added masses [kg] and inertias [kg m²] of every link at its centre of mass, axes of the link, (E, L, 6).

        Args:
            num_links: L.
            params: (E, P).
        """

    def warp_added(self, link: int) -> wp.Function | None:
        """Return the twin of ``added`` for one link, or None: the effect does nothing to it.

        Args:
            link: Its number; 0 is the base.

        Returns:
            A ``wp.func`` (params: vector of P) -> masses and inertias, ``wp.spatial_vector``.
        """
        del link
        return None


class ByLink:
    """Parameters of each of ``columns``: of all links with mass, the base among them, or of one in its place.

    They are called ``qx``, or with the name of a link ``arm.qx``, ``base.qx``; what a robot file leaves out is zero.
    """

    name: ClassVar[str]
    parameters: tuple[Parameter, ...]
    columns: ClassVar[tuple[Parameter, ...]]
    """Numbers of a link, in words with 'each link'; C of them."""
    what: ClassVar[str]
    """What acts at the centre of mass of a link, in a word."""

    def __init__(self, names: Sequence[str] | None = None, links: Sequence[str] = ()) -> None:
        """Take the names of the parameters, None for those of all links, and the links of a vehicle, the base first."""
        self._links = {link: number for number, link in enumerate(links)}
        if names is not None:
            columns = {parameter.name: parameter for parameter in self.columns}
            parts = [name.rpartition(".") for name in names]
            self.parameters = tuple(
                replace(columns[own], name=name, meaning=columns[own].meaning.replace("each link", link or "each link"))
                for name, (link, _, own) in zip(names, parts, strict=True)
            )

    def of(self, robot: RobotCfg) -> Self:
        """Return the effect with the parameters that the robot file names."""
        if robot.joints is None:
            return self  # which is refused
        names = tuple(robot.effects.get(self.name, {}))
        bare = {joint.name for joint in robot.joints.layout if joint.link is None}
        links, columns = robot.joints.link_names, [parameter.name for parameter in self.columns]
        for name in names:
            link, _, own = name.rpartition(".")
            if own not in columns or (link and link not in links):
                raise ConfigError(
                    f"effect {self.name}: no parameter {name!r}. Give one of {', '.join(columns)} for all links, or with the "
                    f"name of a link before it ({links[-1]}.{columns[0]}). Links: {', '.join(links)}"
                )
            if link in bare:
                raise ConfigError(
                    f"effect {self.name}.{name}: {link} has no mass, at whose centre {self.what} acts. Give the link a mass, "
                    f"or the {self.what} to a link that it carries"
                )
        return type(self)(names, links)

    def _places(self, link: int) -> dict[str, int]:
        """Return the place among the parameters of each column of a link, but of those that are zero."""
        places = {parameter.name: place for place, parameter in enumerate(self.parameters)}
        name = next((name for name, number in self._links.items() if number == link), "")
        found = {column.name: places.get(f"{name}.{column.name}", places.get(column.name)) for column in self.columns}
        return {column: place for column, place in found.items() if place is not None}

    def has(self, link: int, *columns: str) -> bool:
        """Return whether a link has a number in one of some columns."""
        return not self._places(link).keys().isdisjoint(columns)

    def numbers(self, num_links: int, params: Tensor) -> Tensor:
        """Return the numbers of every link, (E, L, C), from parameters (E, P)."""
        zero, each = params.shape[1], [self._places(link) for link in range(num_links)]
        places = [[own.get(column.name, zero) for column in self.columns] for own in each]
        return torch.nn.functional.pad(params, (0, 1))[:, torch.tensor(places, device=params.device)]

    def warp_numbers(self, link: int, *columns: str) -> wp.Function:
        """Return a function from the parameters to up to three numbers of a link, ``wp.vec3``; zero where there is none."""
        places, params_type = self._places(link), vector_of(len(self.parameters))
        found = [places.get(column) for column in columns] + [None] * (3 - len(columns))
        has_x, has_y, has_z = (place is not None for place in found)
        x, y, z = (cast(int, place) if place is not None else 0 for place in found)

        @wp.func
        def numbers(params: params_type) -> wp.vec3:
            three = wp.vec3()
            if wp.static(has_x):
                three[0] = params[wp.static(x)]
            if wp.static(has_y):
                three[1] = params[wp.static(y)]
            if wp.static(has_z):
                three[2] = params[wp.static(z)]
            return three

        return numbers
