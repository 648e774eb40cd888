"""Check that draws of a vehicle's total mass and inertia leave a possible base, as its links keep their declared mass."""

from collections.abc import Sequence
from itertools import product
from math import isfinite
from typing import TYPE_CHECKING

import torch
from torch import Tensor

from aerial_gym.errors import ConfigError
from aerial_gym.robots.robot_draws import RobotDraws

if TYPE_CHECKING:
    from aerial_gym.physics.articulated.articulation import Articulation


def check_base_draws(randomized: RobotDraws, articulation: "Articulation", params: Sequence[Tensor]) -> None:
    """Raise ``ConfigError`` where a corner of the ranges of ``body.`` leaves a base that flies without mass or inertia."""
    drawn = [each for each in randomized.drawn if each.name.startswith("body.")]
    ends, columns = [], []
    for each in drawn:
        numbers = each.cfg.components(each.columns.stop - each.columns.start)
        for column, (low, high, _, _) in enumerate(numbers, each.columns.start):
            if isfinite(low) and isfinite(high):
                ends.append((low, high))
                columns.append(column)
    if not columns or not articulation.tree.floating:
        return
    corners = torch.tensor(list(product(*ends)), dtype=torch.float64)
    values = corners.new_zeros(len(corners), randomized.width)
    randomized.neutral(values)
    values[:, columns] = corners
    rows = (each[:1].to(corners).expand(len(corners), -1) for each in params)
    links = articulation.to(corners).links(randomized.follow(values, *rows).vehicle)
    mass, least = links.mass[:, 0].min().item(), torch.linalg.eigvalsh(links.inertia[:, 0]).min().item()
    if not (mass > 0.0 and least > 0.0):
        names, carried = ", ".join(each.name for each in drawn), float(articulation.link_mass.sum())
        raise ConfigError(
            f"randomize: {names}: the links weigh {carried:.6g} kg whatever is drawn, and leave a base of {mass:.3g} kg and a "
            f"principal moment of {least:.3g} kg m² at a corner of the ranges. Both must be > 0: give narrower ranges"
        )
