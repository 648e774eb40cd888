"""Warnings about randomisation ranges at whose ends a controller cannot hover, before the first draw.

Each quantity of ``randomize:``, such as mass, thrust, centre of mass, rotor lag, wind or dead time, is set to each end of
its range, the others as declared. All ends are one batch of the linearised hover loop.
Letters: K drawn numbers, B ends of ranges.
"""

import logging
from collections.abc import Iterator, Sequence
from dataclasses import replace

import torch
from torch import Tensor

from aerial_gym.config.controller import ControllerCfg
from aerial_gym.config.randomize import Randomize
from aerial_gym.config.robot import RobotCfg
from aerial_gym.control.hover import HOVER_RANGE, HOVER_SPAN, trim_axes
from aerial_gym.control.loop_check import fault_of_unstable_loop, hover_error_text, hover_remedy
from aerial_gym.control.stability import ClosedLoop, HoverResult, hover_model
from aerial_gym.physics.effects import EFFECTS, DelayEffect
from aerial_gym.physics.model import robot_effects
from aerial_gym.physics.vehicle import vehicle_from_config
from aerial_gym.robots.robot_draws import RobotDraws, add_effects_to_randomise

SPREAD = 3.0  # Standard deviations at which a normal range ends: 99.7 % of its draws are within


def report_range_faults(
    robot: RobotCfg, controller: ControllerCfg, *, gravity: float, dt: float, integrator: str, names: tuple[str, str],
    randomize: Randomize,
) -> None:  # fmt: skip
    """Warn of ranges at whose ends a vehicle is unstable or leaves ``HOVER_RANGE``, with the remedy.

    Args:
        randomize: Random quantities by name; ``check_closed_loop`` checks gains.
    """
    if not trim_axes(controller) or not randomize:
        return
    ends = hovers_at_range_ends(
        robot, controller, randomize, gravity=gravity, dt=dt, integrator=integrator, names=names
    )
    faults = [each for each in ends if not each[2].is_within_range]
    if faults:
        texts = [hover_error_text(one) if one.stable else fault_of_unstable_loop(one, dt) for _, _, one in faults]
        said = "; ".join(f"{name} = {end}: {text}" for (name, end, _), text in zip(faults, texts, strict=True))
        helps = dict.fromkeys(hover_remedy(hover) for _, _, hover in faults if hover.stable)
        logging.getLogger(__name__).warning(
            f"robot {names[0]} with controller {names[1]} at dt = {dt:g} s does not hover within {HOVER_RANGE:g} m for "
            f"{HOVER_SPAN:g} s at these ends of drawn ranges: {said}. {'. '.join((*helps, 'Narrow the ranges (randomize:)'))}"
        )


def hovers_at_range_ends(
    robot: RobotCfg, controller: ControllerCfg, randomize: Randomize, *, gravity: float, dt: float, integrator: str,
    names: tuple[str, str],
) -> Iterator[tuple[str, str, HoverResult]]:  # fmt: skip
    """Yield quantity, end and hover of every end of every drawn range; arguments as for ``report_range_faults``."""
    robot = add_effects_to_randomise(robot, randomize)
    declared = vehicle_from_config(robot, num_envs=1, dtype=torch.float64)
    effects = robot_effects(robot, num_envs=1, device=torch.device("cpu"), dtype=torch.float64, rigid=True)
    ranges = RobotDraws(
        _vehicle_quantities(randomize, {effect.name for effect, _ in effects}), robot, declared, effects, {}
    )
    for ends in _group_by_delay(list(_range_ends(ranges))):
        values = torch.stack([row for _, _, row in ends])
        params = [rows.expand(len(ends), -1) for _, rows in effects]
        followed = ranges.apply_draws(values, *params)
        acting = [(effect, rows) for (effect, _), rows in zip(effects, followed.params, strict=True)]
        model = hover_model(robot, followed.vehicle, gravity=gravity, effects=acting)
        loop = ClosedLoop(robot, controller, gravity=gravity, integrator=integrator, names=names, model=model)
        for (name, end, _), hover in zip(ends, loop.hover_of_each_vehicle(dt), strict=True):
            yield name, end, hover


def _vehicle_quantities(randomize: Randomize, effects: set[str]) -> Randomize:
    """Return the drawn quantities of the vehicle and of some effects; correlations do not change the ends."""
    chosen = {}
    for name, each in randomize.items():
        family, *rest = name.split(".")
        missing = family == "effects" and rest[0] in EFFECTS and rest[0] not in effects  # on links, at rest here
        if family not in ("gains", "sensors") and not missing:
            chosen[name] = replace(each, correlation={})
    return chosen


End = tuple[str, str, Tensor]  # Quantity, value of its end, and all numbers with it, (K,)


def _range_ends(ranges: RobotDraws) -> Iterator[End]:
    """Yield the ends of every range: all components low, all high, and of rotors that differ every second one low."""
    neutral = torch.zeros(1, ranges.width, dtype=torch.float64)
    ranges.fill_neutral(neutral)
    for each in ranges.drawn:
        width = each.columns.stop - each.columns.start
        numbers = each.cfg.component_distributions(width)
        low = neutral.new_tensor([max(low, mean - SPREAD * std) if std else low for low, _, mean, std in numbers])
        high = neutral.new_tensor([min(high, mean + SPREAD * std) if std else high for _, high, mean, std in numbers])
        ends = [low, high]
        if each.cfg.each_rotor:
            turns = torch.arange(width) // (width // each.shape[0]) % 2 == 0
            ends.append(torch.where(turns, low, high))
        for end in ends:
            row = neutral[0].clone()
            row[each.columns] = end
            yield each.name, _format_end(end), row


def _format_end(end: Tensor) -> str:
    numbers = [f"{number:.3g}" for number in end.tolist()]
    return numbers[0] if len(set(numbers)) == 1 else f"({', '.join(numbers)})"


def _group_by_delay(ends: Sequence[End]) -> Iterator[list[End]]:
    """Yield the ends of ranges in groups of equal dead time: each end of a random dead time alone."""
    alone = [end for end in ends if _is_delay(end[0])]
    together = [end for end in ends if not _is_delay(end[0])]
    yield from ([together] if together else [])
    yield from ([end] for end in alone)


def _is_delay(name: str) -> bool:
    family, *rest = name.split(".")
    return family == "effects" and isinstance(EFFECTS.get(rest[0]), DelayEffect)
