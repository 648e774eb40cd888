"""The intervals of what was found in flights, as ranges from which episodes draw: a policy then trains on what is uncertain."""

from collections.abc import Sequence
from dataclasses import replace
from math import isfinite

from aerial_gym.config.randomize import RandomizeCfg
from aerial_gym.config.robot import RobotCfg
from aerial_gym.physics import EFFECTS
from aerial_gym.sim2real.judge.verdict import NamedEffect

WIDEST = 4.0
"""Standard deviations at which a draw ends: beyond lies one number in 16,000."""


def found_ranges(robot: RobotCfg, effects: Sequence[NamedEffect]) -> dict[str, RandomizeCfg]:
    """Return a joint normal distribution of the parameters with a standard deviation, by the names of quantities.

    What the flights know only of two together, such as a sum, stays as certain as it is.

    Args:
        robot: Whose bounds hold.
        effects: What the flights ask for.
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
    """Return a corrected robot that draws what was found from its intervals at every reset."""
    return replace(robot, randomize={**robot.randomize, **found_ranges(robot, effects)})
