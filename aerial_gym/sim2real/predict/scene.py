"""The scene of a flight: ground, ceiling, another vehicle.

An effect that needs one of them can be tested only where every flight has it. Letters: E rows.
"""

from collections.abc import Sequence
from math import inf, nan
from typing import TypedDict

import numpy as np
import torch
from torch import Tensor

from aerial_gym.errors import DataError
from aerial_gym.physics import EFFECTS
from aerial_gym.physics.effects import WindEffect
from aerial_gym.sim2real.arrays import Array
from aerial_gym.sim2real.findings import Finding
from aerial_gym.sim2real.logs.flights import Flight, names_of

NEEDED = {
    "position": "a position (columns p_x, p_y, p_z)",
    "lin_vel": "velocity or position (a load swings as its vehicle moves, and air acts by the speed through it)",
    "ceiling_height": "the height of the ceiling (column ceiling_z; a high one where there is none)",
    "other_position": "the position of the other vehicle (columns other_p_x, other_p_y, other_p_z, or its own log)",
    "battery": "battery voltage; log it in volts (column vbat)",
}
"""Quantities that an effect may need of a flight, with the columns that give them."""


class Heights(TypedDict):
    """As ``build_model`` takes them [m], world, (E, 1)."""

    ground_height: Tensor
    ceiling_height: Tensor | None


def lacks_of_scene(name: str, flights: Sequence[Flight]) -> Finding | None:
    """Return the part of its scene that the flights lack for an effect; None if they have all."""
    return _without(name, EFFECTS.get(name).needs, flights)


def lacks_of_air(name: str, flights: Sequence[Flight]) -> Finding | None:
    """Return the quantity that the flights lack to show an effect of the air; None if they have it, or for other effects.

    A declared effect acts all the same, on the speed of the hubs as the vehicle turns. To look for one by that alone would
    call air what is anything else.
    """
    effect = EFFECTS.get(name)
    airborne = isinstance(effect, WindEffect) or "velocity" in effect.follows
    return _without(name, ("lin_vel",) if airborne else (), flights)


def _without(name: str, needs: Sequence[str], flights: Sequence[Flight]) -> Finding | None:
    for need in needs:
        without = [flight for flight in flights if getattr(flight, need) is None]
        if without:
            return Finding("logs_lack", name, {"flights": names_of(without, flights), "need": need})
    return None


def check_scene(names: Sequence[str], flights: Sequence[Flight]) -> None:
    """Raise ``DataError`` if the flights lack something that a declared effect needs."""
    for name in names:
        if reason := lacks_of_scene(name, flights):
            where, need = reason.values["flights"], NEEDED[str(reason.values["need"])]
            raise DataError(f"the robot file declares {name}, but the flights do not tell it: {where}: without {need}")


def heights(flights: Sequence[Flight], rows: Sequence[int]) -> Heights:
    """Return the heights of ground and ceiling [m], (E, 1), for so many rows of each flight; None: no ceiling known."""

    def column(values: list[float]) -> Tensor:
        return torch.from_numpy(np.repeat(values, rows)).unsqueeze(-1)

    ceilings = [flight.ceiling_height for flight in flights]
    known = any(ceiling is not None for ceiling in ceilings)
    return {
        "ground_height": column([flight.ground_height for flight in flights]),
        "ceiling_height": column([nan if c is None else c for c in ceilings]) if known else None,
    }


def other_along(flight: Flight) -> Array:
    """Return the place of the other vehicle along a flight [m], world, (T, 3); far below where it is not known: no wake."""
    below = np.array([0.0, 0.0, -inf])
    if flight.other_position is None:
        return np.tile(below, (flight.num_rows, 1))
    return np.where(np.isnan(flight.other_position).any(axis=1, keepdims=True), below, flight.other_position)
