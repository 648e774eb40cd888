"""Buoyancy of links: the weight of displaced water pushes each link of an articulated vehicle up.

``F = rho V g`` along world z at the link's centre of buoyancy, ``x y z`` along the axes of the link (those of the body in the
reference pose) from its centre of mass: with the link in whatever way it is turned and joints bend. For each link what
``buoyancy`` is for a rigid hull, by the same formula; there the centre is told from the body origin, as that of a hull is
drawn, and the whole is one body in flights and fits. A litre of fresh water is 9.81 N, and a link of mass m is neutral at m g.
Parameters are of all links with mass, or of one (``on_links.LinkParameters``).
Source: Fossen (2021), Handbook of Marine Craft Hydrodynamics and Motion Control, section 4.1 (submerged vehicles).
Letters: E environments, L links, P parameters.
"""

from typing import ClassVar

from torch import Tensor

from aerial_gym.physics.effects.buoyancy import buoyancy_wrench
from aerial_gym.physics.effects.kinds.link import LinkWrenchEffect
from aerial_gym.physics.effects.link_parameters import LinkParameters
from aerial_gym.physics.effects.parameter import Parameter


class LinkBuoyancy(LinkParameters, LinkWrenchEffect):
    """Upward force at a point of each link."""

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
