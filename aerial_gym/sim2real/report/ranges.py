"""Randomisation ranges from the confidence intervals of identified parameters, for the training of policies."""

from collections.abc import Sequence
from dataclasses import replace
from math import isfinite

from aerial_gym.config.randomize import RandomizeCfg
from aerial_gym.config.robot import RobotCfg
from aerial_gym.physics import EFFECTS
from aerial_gym.sim2real.judge.verdict import NamedEffect

WIDEST = 4.0
"""Truncation of the distributions in standard deviations; one draw in 16,000 lies beyond."""


def found_ranges(robot: RobotCfg, effects: Sequence[NamedEffect]) -> dict[str, RandomizeCfg]:
    """Return a joint normal distribution of the identified parameters, by the names of quantities.

    Correlations are kept, so well-known combinations such as sums stay certain.

    Args:
        robot: Robot whose bounds limit the ranges.
        effects: Identified effects.
    """
    ranges = {}
    for found in effects:
        effect = EFFECTS.get(found.name)
        for parameter, (least, most) in zip(effect.parameters, effect.bounds(robot), strict=True):
            std, value = found.std.get(parameter.name, 0.0), found.params.get(parameter.name)
            if value is None or parameter.kind != "number" or not (isfinite(std) and std > 0.0):
                continue
            ranges[f"effects.{found.name}.{parameter.name}"] = RandomizeCfg(
                how="value",
                distribution="normal",
                mean=value,
                std=std,
                low=max(least, parameter.low, value - WIDEST * std),
                high=min(most, parameter.high, value + WIDEST * std),
            )
    for found in effects:
        for parameter, others in found.correlation.items():
            name = f"effects.{found.name}.{parameter}"
            if name in ranges:
                kept = {f"effects.{other}": share for other, share in others.items() if f"effects.{other}" in ranges}
                ranges[name] = replace(ranges[name], correlation=kept)
    return ranges


def with_found_ranges(robot: RobotCfg, effects: Sequence[NamedEffect]) -> RobotCfg:
    """Return a corrected robot that draws the identified parameters from their uncertainty at every reset."""
    return replace(robot, randomize={**robot.randomize, **found_ranges(robot, effects)})
