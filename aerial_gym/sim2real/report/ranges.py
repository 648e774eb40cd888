"""Randomisation ranges from the confidence intervals of identified parameters, for the training of policies."""

from collections.abc import Sequence
from dataclasses import replace
from math import isfinite

from aerial_gym.config.randomize import RandomizeCfg
from aerial_gym.config.robot import RobotCfg
from aerial_gym.physics import EFFECTS
from aerial_gym.sim2real.judge.verdict import NamedEffect

WIDEST = 4.0  # Truncation of the distributions in standard deviations; one draw in 16,000 lies beyond


def uncertainty_ranges(robot: RobotCfg, effects: Sequence[NamedEffect]) -> dict[str, RandomizeCfg]:
    """Return a joint normal distribution of the identified parameters, by the names of quantities.

    Correlations are kept, so well-known combinations such as sums stay certain.
    """
    ranges = {}
    for entry in effects:
        effect = EFFECTS.get(entry.name)
        for parameter, (least, most) in zip(effect.parameters, effect.bounds(robot), strict=True):
            std, value = entry.std.get(parameter.name, 0.0), entry.params.get(parameter.name)
            if value is None or parameter.kind != "number" or not (isfinite(std) and std > 0.0):
                continue
            ranges[f"effects.{entry.name}.{parameter.name}"] = RandomizeCfg(
                how="value",
                distribution="normal",
                mean=value,
                std=std,
                low=max(least, parameter.low, value - WIDEST * std),
                high=min(most, parameter.high, value + WIDEST * std),
            )
    for entry in effects:
        for parameter, correlations in entry.correlation.items():
            name = f"effects.{entry.name}.{parameter}"
            if name in ranges:
                shares = {f"effects.{other}": share for other, share in correlations.items()}
                kept = {other: share for other, share in shares.items() if other in ranges}
                ranges[name] = replace(ranges[name], correlation=kept)
    return ranges
