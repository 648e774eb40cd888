"""The surroundings of a flight: ground, ceiling and another vehicle.

An effect that needs a quantity is testable only if every flight has it. A log without another vehicle states that there is
none, so one flight with it suffices. Letters: E rows.
"""

from collections.abc import Sequence
from math import inf, nan
from typing import TypedDict

import numpy as np
import torch
from torch import Tensor

from aerial_gym.errors import DataError
from aerial_gym.physics import EFFECTS
from aerial_gym.sim2real.arrays import Array
from aerial_gym.sim2real.findings import Finding
from aerial_gym.sim2real.logs.flights import Flight, flight_names

NEEDED = {
    "position": "a position (columns p_x, p_y, p_z)",
    "lin_vel": "velocity or position (a load swings as its vehicle moves, and air acts by the speed through it)",
    "ceiling_height": "the height of the ceiling (column ceiling_z; a high one where there is none)",
    "other_position": "the position of the other vehicle (columns other_p_x, other_p_y, other_p_z, or its own log)",
    "rotor_speed": "measured rotor speeds (columns rotor_1, rotor_2, ...)",
    "rotor_command": "rotor commands (columns cmd_1, cmd_2, ...)",
    "battery": "battery voltage; log it in volts (column vbat)",
}
"""Quantities that an effect may need, with the columns that provide them."""


class SurfaceHeights(TypedDict):
    """Heights for ``build_model`` [m], world, (E, 1)."""

    ground_height: Tensor
    ceiling_height: Tensor | None


def finding_on_absent_data(name: str, needs: Sequence[str], flights: Sequence[Flight]) -> Finding | None:
    """Return a finding on the first quantity that an effect needs and flights lack; None if all are there."""
    for need in needs:
        without = [flight for flight in flights if getattr(flight, need) is None]
        fly_alone = need == "other_position" and all(flight.pair is None for flight in without)
        if without and (not fly_alone or len(without) == len(flights)):
            return Finding("logs_lack", name, {"flights": flight_names(without, flights), "need": need})
    return None


def check_scene(names: Sequence[str], flights: Sequence[Flight]) -> None:
    """Raise ``DataError`` if the flights lack a quantity that a declared effect needs."""
    for name in names:
        if reason := finding_on_absent_data(name, EFFECTS.get(name).needs, flights):
            where, need = reason.values["flights"], NEEDED[str(reason.values["need"])]
            raise DataError(f"the robot file declares {name}, which these flights cannot show: {where}: without {need}")


def surface_heights(flights: Sequence[Flight], rows: Sequence[int]) -> SurfaceHeights:
    """Return the heights of ground and ceiling [m], (E, 1), for the numbers of rows per flight; None: no ceiling known."""

    def height_column(values: list[float]) -> Tensor:
        return torch.from_numpy(np.repeat(values, rows)).unsqueeze(-1)

    ceilings = [flight.ceiling_height for flight in flights]
    known = any(ceiling is not None for ceiling in ceilings)
    return {
        "ground_height": height_column([flight.ground_height for flight in flights]),
        "ceiling_height": height_column([nan if c is None else c for c in ceilings]) if known else None,
    }


def other_vehicle_track(flight: Flight) -> Array:
    """Return the other vehicle's position along a flight [m], world, (T, 3); far below where unknown, to cast no wake."""
    below = np.array([0.0, 0.0, -inf])
    if flight.other_position is None:
        return np.tile(below, (flight.num_rows, 1))
    return np.where(np.isnan(flight.other_position).any(axis=1, keepdims=True), below, flight.other_position)
