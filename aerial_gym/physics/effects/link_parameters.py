"""Parameters of effects on links: one value for all links with mass, or one for a named link.

Letters: E environments, L links (the base first), P parameters.
"""

from collections.abc import Sequence
from dataclasses import replace
from typing import ClassVar, Self

import torch
from torch import Tensor

from aerial_gym.config.robot import RobotCfg
from aerial_gym.errors import ConfigError
from aerial_gym.physics.effects.parameter import Parameter


class LinkParameters:
    """Parameters of an effect per link: each of ``columns`` for all links with mass, or for one named link.

    Their names are ``qx`` for all links (with the base), and ``arm.qx`` or ``base.qx`` for one; missing ones are zero.
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

    def has(self, link: int, *columns: str) -> bool:
        """Return whether a link has a parameter in any of some columns."""
        return not self._places(link).keys().isdisjoint(columns)

    def numbers(self, num_links: int, params: Tensor) -> Tensor:
        """Return the numbers of every link, (E, L, C), from parameters (E, P)."""
        zero, each = params.shape[1], [self._places(link) for link in range(num_links)]
        places = [own.get(column.name, zero) for own in each for column in self.columns]
        chosen = torch.tensor(places, device=params.device)
        rows = torch.nn.functional.pad(params, (0, 1)).index_select(1, chosen)
        return rows.unflatten(1, (num_links, len(self.columns)))
