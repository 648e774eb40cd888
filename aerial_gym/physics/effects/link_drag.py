"""Drag of every link of a vehicle that bends, linear and quadratic, along and about each axis of the link.

``F_i = -(l_i + q_i |v|) v_i`` at the centre of mass of the link and ``tau_i = -(a_i + b_i |w|) w_i``, with v the velocity of
that centre through the air: for each link what ``rotor_drag`` and ``quadratic_drag`` are for a rigid body. The wind is that at
the vehicle. A parameter is of all links with mass, the base among them (``qx``), or of one in its place (``arm.qx``,
``base.qx``); what a robot file leaves out is zero. Axes of a link are those of the body in the reference pose.
Source: Hoerner (1965), Fluid-Dynamic Drag, chapter 1, with one area per axis.
Letters: E environments, L links, P parameters.
"""

from collections.abc import Sequence
from dataclasses import replace
from typing import cast

import torch
import warp as wp
from torch import Tensor

from aerial_gym.config.robot import RobotCfg
from aerial_gym.errors import ConfigError
from aerial_gym.physics.effects.base import LinkEffect, Parameter
from aerial_gym.physics.fused.types import vector_of

_LETTERS = {
    "l": ("N s/m", 0.01, "force per speed along"),
    "q": ("N s²/m²", 0.01, "force per speed squared along"),
    "a": ("N m s/rad", 1e-4, "torque per rate about"),
    "b": ("N m s²/rad²", 1e-4, "torque per rate squared about"),
}

_OF_ALL = tuple(
    Parameter(name=f"{letter}{axis}", unit=unit, low=0.0, high=1e4, scale=scale, meaning=f"{words} {axis} of each link")
    for letter, (unit, scale, words) in _LETTERS.items()
    for axis in "xyz"
)
"""Columns of the law: l, q, a and b along and about x, y, z."""


class LinkDrag(LinkEffect):
    """Twelve coefficients, of all links or of one; as declared by a robot (``of``) those that its file names."""

    name = "link_drag"
    summary = "drag of each link of a vehicle with joints: linear and quadratic, along and about each axis of the link"
    parameters = _OF_ALL
    excitation = "links that move through the air at several speeds"
    confused_with = ("rotor_drag", "quadratic_drag")
    follows = ("velocity",)

    def __init__(self, names: Sequence[str] | None = None, links: Sequence[str] = ()) -> None:
        """Take the names of the parameters, None for those of all links, and the links of a vehicle, the base first."""
        self._links = {link: number for number, link in enumerate(links)}
        if names is not None:
            columns = {parameter.name: parameter for parameter in _OF_ALL}
            parts = [name.rpartition(".") for name in names]
            self.parameters = tuple(
                replace(columns[own], name=name, meaning=columns[own].meaning.replace("each link", link or "each link"))
                for name, (link, _, own) in zip(names, parts, strict=True)
            )

    def of(self, robot: RobotCfg) -> "LinkDrag":
        """Return the effect with the parameters that the robot file names."""
        if robot.joints is None:
            return self  # which is refused
        names = tuple(robot.effects.get(self.name, {}))
        bare = {joint.name for joint in robot.joints.layout if joint.link is None}
        links, columns = robot.joints.link_names, [parameter.name for parameter in _OF_ALL]
        for name in names:
            link, _, own = name.rpartition(".")
            if own not in columns or (link and link not in links):
                raise ConfigError(
                    f"effect {self.name}: no parameter {name!r}. Give one of {', '.join(columns)} for all links, or with the "
                    f"name of a link before it ({links[-1]}.{columns[0]}). Links: {', '.join(links)}"
                )
            if link in bare:
                raise ConfigError(
                    f"effect {self.name}.{name}: {link} has no mass, at whose centre drag acts. Give the link a mass, or the "
                    "drag to a link that it carries"
                )
        return LinkDrag(names, links)

    def columns_of(self, link: int) -> list[int | None]:
        """Return the place among the parameters of each of the twelve of a link; None for what is zero."""
        places = {parameter.name: place for place, parameter in enumerate(self.parameters)}
        name = next((name for name, number in self._links.items() if number == link), "")
        return [places.get(f"{name}.{column.name}", places.get(column.name)) for column in _OF_ALL]

    def damping(self, velocity: Tensor, params: Tensor) -> Tensor:
        """Return ``l + q |v|`` and ``a + b |w|``, (E, L, 6)."""
        zero = params.shape[1]
        places = [[zero if place is None else place for place in self.columns_of(k)] for k in range(velocity.shape[1])]
        padded = torch.nn.functional.pad(params, (0, 1))
        linear, quadratic, turning, whirling = padded[:, torch.tensor(places, device=params.device)].split(3, dim=-1)
        along, about = (_length(part) for part in velocity.split(3, dim=-1))
        return torch.cat((linear + quadratic * along, turning + whirling * about), dim=-1)

    def warp_damping(self, link: int) -> wp.Function | None:
        """Return the same in Warp; parameters that a link does not have cost nothing."""
        columns = self.columns_of(link)
        if all(place is None for place in columns):
            return None
        params_type = vector_of(len(self.parameters))
        whole = [_make_coefficients(columns[first : first + 3], params_type) for first in (0, 3, 6, 9)]
        linear, quadratic, turning, whirling = whole
        any_quadratic, any_whirling = (any(p is not None for p in columns[first : first + 3]) for first in (3, 9))

        @wp.func
        def link_drag(velocity: wp.spatial_vector, params: params_type) -> wp.spatial_vector:
            along = linear(params)
            about = turning(params)
            if wp.static(any_quadratic):
                along += wp.length(wp.spatial_top(velocity)) * quadratic(params)
            if wp.static(any_whirling):
                about += wp.length(wp.spatial_bottom(velocity)) * whirling(params)
            return wp.spatial_vector(along, about)

        return link_drag


def _length(vector: Tensor) -> Tensor:
    """Return lengths (..., 1) of vectors (..., 3), whose gradient at rest is zero."""
    square = (vector * vector).sum(-1, keepdim=True)
    moving = square > 0.0
    return torch.where(moving, square, torch.ones_like(square)).sqrt() * moving


def _make_coefficients(places: Sequence[int | None], params_type: type) -> wp.Function:
    """Return a function from the parameters to three of them; zero where there is no place."""
    present = [place is not None for place in places]
    x, y, z = (cast(int, place) if place is not None else 0 for place in places)
    has_x, has_y, has_z = present

    @wp.func
    def coefficients(params: params_type) -> wp.vec3:
        found = wp.vec3()
        if wp.static(has_x):
            found[0] = params[wp.static(x)]
        if wp.static(has_y):
            found[1] = params[wp.static(y)]
        if wp.static(has_z):
            found[2] = params[wp.static(z)]
        return found

    return coefficients
