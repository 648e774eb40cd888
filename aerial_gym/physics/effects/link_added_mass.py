"""Added mass of links: water that accelerates with each link of an articulated vehicle.

Each link has added masses A = diag(mx my mz) at its centre of mass, along its axes (those of the body in the reference pose),
and added inertias B = diag(jx jy jz) about them. With the velocity v of that centre through water in steady uniform motion,
and the angular velocity w of the link, Kirchhoff's equations are, in axes of the link::

    F_water = -(A (a - w x v) + w x (A v))         a the acceleration of the centre in the world
    T_water = -(B w' + w x (B w) + v x (A v))      about the centre

The last term, Munk's moment, turns a slender link across its motion. The terms of acceleration add to the mass of the link in
the equations of motion, without weight, so an accelerometer senses them by the motion only. The energy of the water is
``1/2 v A v + 1/2 w B w`` for each link; interaction between links is neglected. This is the counterpart of ``added_mass`` and
``added_inertia`` for a rigid hull. Those scale the response of one body to a force; links also push each other, so here the
water is part of the inertia. Parameters are of all links with mass, or of one (``on_links.LinkParameters``).
The engine's side of it is ``articulated.link_fluid``.
Source: Lamb (1932), Hydrodynamics, articles 121-124 (Kirchhoff's equations); Fossen (2021), Handbook of Marine Craft
Hydrodynamics and Motion Control, section 6.3.
Letters: E environments, L links, P parameters.
"""

from typing import ClassVar

from torch import Tensor

from aerial_gym.physics.effects.kinds.link import LinkFluidEffect
from aerial_gym.physics.effects.link_parameters import LinkParameters
from aerial_gym.physics.effects.parameter import Parameter

_MASSES, _INERTIAS = (tuple(f"{letter}{axis}" for axis in "xyz") for letter in "mj")


class LinkAddedMass(LinkParameters, LinkFluidEffect):
    """Mass and inertia of the water along and about each axis of each link."""

    name = "link_added_mass"
    summary = (
        "water that each link of a vehicle with joints accelerates: added mass and inertia along each axis of the link"
    )
    columns: ClassVar[tuple[Parameter, ...]] = (
        *(Parameter(name, "kg", 0.0, 1e4, 0.1, f"added mass along {name[1]} of each link") for name in _MASSES),
        *(
            Parameter(name, "kg m²", 0.0, 1e4, 1e-3, f"added inertia about {name[1]} of each link")
            for name in _INERTIAS
        ),
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
