"""Drag of links of an articulated vehicle, linear and quadratic, along and about each axis of the link.

``F_i = -(l_i + q_i |v|) v_i`` at the centre of mass of the link and ``tau_i = -(a_i + b_i |w|) w_i``, with v the velocity of
that centre through the air: for each link what ``rotor_drag`` and ``quadratic_drag`` are for a rigid body. The wind is that at
the vehicle. A parameter is of all links with mass, the base among them (``qx``), or of one in its place (``arm.qx``,
``base.qx``); what a robot file leaves out is zero. Axes of a link are those of the body in the reference pose.
Source: Hoerner (1965), Fluid-Dynamic Drag, chapter 1, with one area per axis.
Letters: E environments, L links, P parameters.
"""

from typing import ClassVar

import torch
from torch import Tensor

from aerial_gym.physics.effects.kinds.link import LinkEffect
from aerial_gym.physics.effects.link_parameters import LinkParameters
from aerial_gym.physics.effects.parameter import Parameter

_LETTERS = {
    "l": ("N s/m", 0.01, "force per speed along"),
    "q": ("N s²/m²", 0.01, "force per speed squared along"),
    "a": ("N m s/rad", 1e-4, "torque per rate about"),
    "b": ("N m s²/rad²", 1e-4, "torque per rate squared about"),
}

_LINEAR, _QUADRATIC, _TURNING, _WHIRLING = (tuple(f"{letter}{axis}" for axis in "xyz") for letter in _LETTERS)


class LinkDrag(LinkParameters, LinkEffect):
    """Twelve coefficients for all links or for one; an effect bound to a robot has those of its file."""

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
        along, about = (_length(part) for part in velocity.split(3, dim=-1))
        return torch.cat((linear + quadratic * along, turning + whirling * about), dim=-1)


def _length(vector: Tensor) -> Tensor:
    """Return lengths (..., 1) of vectors (..., 3), with zero gradient at rest."""
    square = (vector * vector).sum(-1, keepdim=True)
    moving = square > 0.0
    return torch.where(moving, square, torch.ones_like(square)).sqrt() * moving
