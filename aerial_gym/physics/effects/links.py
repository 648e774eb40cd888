"""Effects on each link of a vehicle with joints: drag, buoyancy and added mass.

Axes of a link are those of the body in the reference pose.
Letters: E environments, L links (the base first), P parameters.
"""

from collections.abc import Sequence
from dataclasses import replace
from typing import ClassVar, Self

import torch
from torch import Tensor

from aerial_gym.config.robot import RobotCfg
from aerial_gym.errors import ConfigError
from aerial_gym.math.rows import length_of_vectors
from aerial_gym.physics.effects.base import Parameter
from aerial_gym.physics.effects.kinds import LinkEffect, LinkFluidEffect, LinkWrenchEffect
from aerial_gym.physics.effects.water import buoyancy_wrench


class LinkParameters:
    """Parameters of effects on links: one value for all links with mass, or one for a named link.

    Letters: E environments, L links (the base first), P parameters.
    """

    name: ClassVar[str]
    parameters: tuple[Parameter, ...]
    columns: ClassVar[tuple[Parameter, ...]]  # Numbers of a link, in words with 'each link'; C of them
    quantity: ClassVar[str]  # What acts at the centre of mass of a link, in a word

    def __init__(self, names: Sequence[str] | None = None, links: Sequence[str] = ()) -> None:
        """Store the names of the parameters (None: those of all links) and the links of a vehicle, the base first."""
        self._links = {link: number for number, link in enumerate(links)}
        if names is not None:
            columns = {parameter.name: parameter for parameter in self.columns}
            parts = [name.rpartition(".") for name in names]
            self.parameters = tuple(
                replace(columns[own], name=name, meaning=columns[own].meaning.replace("each link", link or "each link"))
                for name, (link, _, own) in zip(names, parts, strict=True)
            )

    def bind_robot(self, robot: RobotCfg) -> Self:
        """Return the effect with the parameters that the robot file names."""
        if robot.joints is None:
            return self  # refused elsewhere
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
                    f"effect {self.name}.{name}: {link} has no mass, at whose centre {self.quantity} acts. Give it a mass, "
                    f"or the {self.quantity} to a link that it carries"
                )
        return type(self)(names, links)

    def _places(self, link: int) -> dict[str, int]:
        """Return the index among the parameters of each column of a link, without missing ones."""
        places = {parameter.name: place for place, parameter in enumerate(self.parameters)}
        name = next((name for name, number in self._links.items() if number == link), "")
        places_found = {
            column.name: places.get(f"{name}.{column.name}", places.get(column.name)) for column in self.columns
        }
        return {column: place for column, place in places_found.items() if place is not None}

    def numbers(self, num_links: int, params: Tensor) -> Tensor:
        """Return the numbers of every link, (E, L, C), from parameters (E, P)."""
        zero, each = params.shape[1], [self._places(link) for link in range(num_links)]
        places = [own.get(column.name, zero) for own in each for column in self.columns]
        chosen = torch.tensor(places, device=params.device)
        rows = torch.nn.functional.pad(params, (0, 1)).index_select(1, chosen)
        return rows.unflatten(1, (num_links, len(self.columns)))


_LETTERS = {
    "l": ("N s/m", 0.01, "force per speed along"),
    "q": ("N s²/m²", 0.01, "force per speed squared along"),
    "a": ("N m s/rad", 1e-4, "torque per rate about"),
    "b": ("N m s²/rad²", 1e-4, "torque per rate squared about"),
}


class LinkDrag(LinkParameters, LinkEffect):
    """Drag of links of an articulated vehicle, linear and quadratic, along and about each axis of the link.

    ``F_i = -(l_i + q_i |v|) v_i`` at the centre of mass of the link and ``tau_i = -(a_i + b_i |w|) w_i``, with v the
    velocity of that centre through the air: for each link what ``rotor_drag`` and ``quadratic_drag`` are for a rigid body.
    The wind is that at the vehicle. A parameter is of all links with mass, the base among them (``qx``), or of one in its
    place (``arm.qx``, ``base.qx``); what a robot file leaves out is zero. Axes of a link are those of the body in the
    reference pose.
    Source: Hoerner (1965), Fluid-Dynamic Drag, chapter 1, with one area per axis.
    """

    name = "link_drag"
    summary = "drag of each link of a vehicle with joints: linear and quadratic, along and about each axis of the link"
    columns: ClassVar[tuple[Parameter, ...]] = tuple(
        Parameter(f"{letter}{axis}", unit, 0.0, 1e4, scale, f"{words} {axis} of each link")
        for letter, (unit, scale, words) in _LETTERS.items()
        for axis in "xyz"
    )
    parameters = columns
    quantity = "drag"
    excitation = "links that move through the air at several speeds"
    confused_with = ("rotor_drag", "quadratic_drag")
    instead = ("rotor_drag", "quadratic_drag", "hull_drag")
    follows = ("velocity",)

    def damping(self, velocity: Tensor, params: Tensor) -> Tensor:
        """Return ``l + q |v|`` and ``a + b |w|``, (E, L, 6)."""
        linear, quadratic, turning, whirling = self.numbers(velocity.shape[1], params).split(3, dim=-1)
        along, about = (length_of_vectors(part) for part in velocity.split(3, dim=-1))
        return torch.cat((linear + quadratic * along, turning + whirling * about), dim=-1)


class LinkBuoyancy(LinkParameters, LinkWrenchEffect):
    """Buoyancy of links: the weight of displaced water pushes each link of an articulated vehicle up.

    ``F = rho V g`` along world z at the link's centre of buoyancy, ``x y z`` along the axes of the link (those of the body
    in the reference pose) from its centre of mass: with the link in whatever way it is turned and joints bend. For each
    link what ``buoyancy`` is for a rigid hull, by the same formula; there the centre is told from the body origin, as that
    of a hull is drawn, and the whole is one body in flights and fits. A litre of fresh water is 9.81 N, and a link of mass
    m is neutral at m g. Parameters are of all links with mass, or of one (``LinkParameters``).
    Source: Fossen (2021), Handbook of Marine Craft Hydrodynamics and Motion Control, section 4.1 (submerged vehicles).
    """

    name = "link_buoyancy"
    summary = "upward force of the water that each link of a vehicle with joints displaces, at its centre of buoyancy"
    columns: ClassVar[tuple[Parameter, ...]] = (
        Parameter("force", "N", 0.0, 1e5, 0.1, "weight of the water that each link displaces"),
        *(
            Parameter(axis, "m", -5.0, 5.0, 0.01, f"centre of buoyancy of each link from its centre of mass, {axis}")
            for axis in "xyz"
        ),
    )
    parameters = columns
    quantity = "buoyancy"
    excitation = "attitudes and angles of joints that differ"
    confused_with = ("buoyancy", "payload_mass", "com_offset")
    instead = ("buoyancy",)
    medium = "water"

    def wrench(self, up: Tensor, params: Tensor) -> Tensor:
        """Return ``F up`` and ``b x F up``."""
        own = self.numbers(up.shape[1], params)
        return buoyancy_wrench(own[..., :1], own[..., 1:], up)


class LinkAddedMass(LinkParameters, LinkFluidEffect):
    """Added mass of links: water that accelerates with each link of an articulated vehicle.

    Each link has added masses A = diag(mx my mz) at its centre of mass, along its axes (those of the body in the reference
    pose), and added inertias B = diag(jx jy jz) about them. With the velocity v of that centre through water in steady
    uniform motion, and the angular velocity w of the link, Kirchhoff's equations are, in axes of the link::

        F_water = -(A (a - w x v) + w x (A v))         a the acceleration of the centre in the world
        T_water = -(B w' + w x (B w) + v x (A v))      about the centre

    The last term, Munk's moment, turns a slender link across its motion. The terms of acceleration add to the mass of the
    link in the equations of motion, without weight, so an accelerometer senses them by the motion only. The energy of the
    water is ``1/2 v A v + 1/2 w B w`` for each link; interaction between links is neglected. This is the counterpart of
    ``added_mass`` and ``added_inertia`` for a rigid hull. Those scale the response of one body to a force; links also push
    each other, so here the water is part of the inertia. Parameters are of all links with mass, or of one
    (``LinkParameters``). The engine's side of it is ``articulated.link_fluid``.
    Source: Lamb (1932), Hydrodynamics, articles 121-124 (Kirchhoff's equations); Fossen (2021), Handbook of Marine Craft
    Hydrodynamics and Motion Control, section 6.3.
    """

    name = "link_added_mass"
    summary = (
        "water that each link of a vehicle with joints accelerates: added mass and inertia along each axis of the link"
    )
    columns: ClassVar[tuple[Parameter, ...]] = (
        *(Parameter(f"m{axis}", "kg", 0.0, 1e4, 0.1, f"added mass along {axis} of each link") for axis in "xyz"),
        *(Parameter(f"j{axis}", "kg m²", 0.0, 1e4, 1e-3, f"added inertia about {axis} of each link") for axis in "xyz"),
    )
    parameters = columns
    quantity = "added mass"
    excitation = "accelerations of links along and about each axis"
    confused_with = ("payload_mass", "inertia_error", "thrust_coefficient")
    instead = ("added_mass", "added_inertia")
    medium = "water"

    def added_mass(self, num_links: int, params: Tensor) -> Tensor:
        """Return the diagonals of A and B of every link, (E, L, 6)."""
        return self.numbers(num_links, params)
