"""Cells of the physical effects: three sizes of each effect that a robot and its backend can hold.

A vehicle holds many effects at once, all neutral but one. Two that exclude each other are on different vehicles.
"""

import json
from collections.abc import Collection, Iterator, Mapping
from dataclasses import replace

import torch

from aerial_gym.config.environment import EnvironmentCfg
from aerial_gym.config.robot import RobotCfg
from aerial_gym.config.sim import SimCfg
from aerial_gym.config.task import TaskCfg
from aerial_gym.errors import CapabilityError, ConfigError
from aerial_gym.physics import EFFECTS
from aerial_gym.physics.capabilities import choose_backend, robot_needs
from aerial_gym.physics.effects import Effect, ImuEffect, Parameter
from aerial_gym.physics.model import check_effects
from aerial_gym.rl_training.robustness.cell import Cell, CellGroup, Variant
from aerial_gym.rl_training.robustness.wording import cell_label, variant_label

SIZES = {"small": 0.5, "moderate": 1.0, "large": 2.0}
"""Changes as multiples of a parameter's ``scale``, which is a moderate change."""

SIZED_BY = {
    "slung_payload": ("mass",), "slung_payload_rod": ("mass",), "command_curve": ("offset", "gain", "power"),
}  # fmt: skip
"""Parameters that change an effect's size, where its neutral values do not show that."""

FAILURE = {"time": 1.0, "duration": 0.5}  # Begin and duration of failures in flight [s]
DRAG = "rotor_drag"  # Effect through which wind acts on a robot without drag of its own
DRAG_CAUSES = {DRAG, "quadratic_drag", "hull_drag", "h_force_flapping", "blade_element", "link_drag"}
SET = {
    "motor_time_constant": "rotor lag",
    "motor_asymmetry": "rotor lag",
}  # Numbers that effects set, also neutral ones


def effect_groups(
    cfg: TaskCfg, robot: RobotCfg, env: EnvironmentCfg, sim: SimCfg, *, sizes: Mapping[str, float],
    weak: Collection[float],
) -> tuple[list[CellGroup], dict[str, str]]:  # fmt: skip
    """Return the groups of cells, and the effects that cannot be flown with the reason for each.

    Args:
        sizes: Multiples of a moderate change, by name.
        weak: Missing shares of one rotor's thrust.
    """
    held: list[dict[str, Effect]] = []  # Effects by what a vehicle has one of, else by name
    not_flown: dict[str, str] = {}
    for name in EFFECTS:
        effect = EFFECTS.get(name)
        if reason := effect_obstacle(effect, cfg, robot, env, sim):
            not_flown[name] = reason
            continue
        place = next((each for each in held if _slot(effect) not in each), None)
        if place is None:
            held.append(place := {})
        place[_slot(effect)] = effect
    groups = []
    for effects in held:
        whole = _neutral_robot(robot, effects.values())
        cells = [cell for effect in effects.values() for cell in _cells(effect.bind_robot(whole), whole, sizes)]
        cells += [_weak_rotor(whole, share) for share in weak if "weak_motor" in effects]
        added = (f"robot.effects.{n}={json.dumps(row)}" for n, row in whole.effects.items() if n not in robot.effects)
        settings = (*added, f"robot.effects_source={whole.effects_source}")
        neutral = Cell(name=f"neutral/{len(groups) + 1}", label=cell_label("neutral", 0.0), subject="neutral")
        groups.append(CellGroup(cells=(neutral, *cells), settings=settings, compared=True))
    return groups, not_flown


def _slot(effect: Effect) -> str:
    """Return the name of the place that an effect takes on a vehicle, such as its one load; its own name by default."""
    return effect.single or SET.get(effect.name, effect.name)


def _neutral_robot(robot: RobotCfg, effects: Collection[Effect]) -> RobotCfg:
    """Return a robot that also holds effects, neutral where its file lacks them; with drag where they hold a wind."""
    rows = dict(robot.effects)
    drag = [EFFECTS.get(DRAG)] if any(effect.acts_on == "environment" for effect in effects) else []
    for effect in (*effects, *drag):
        neutral = zip((each.name for each in effect.parameters), effect.neutral(robot), strict=True)
        rows.setdefault(effect.name, dict(neutral))
    return replace(robot, effects=rows, effects_source=robot.effects_source or "neutral, for a robustness test")


def effect_obstacle(effect: Effect, cfg: TaskCfg, robot: RobotCfg, env: EnvironmentCfg, sim: SimCfg) -> str:
    """Return why an effect cannot be flown; empty if it can."""
    terms = {entry.term for entries in cfg.observations.values() for entry in entries}
    own = [EFFECTS.get(name) for name in robot.effects]
    rivals = [other.name for other in own if _slot(other) == _slot(effect) and other.name != effect.name]
    measured = isinstance(effect, ImuEffect) and any("imu" in term for term in terms)
    drawn = (*robot.randomize, *env.randomize, *cfg.randomize)
    for reason, holds in {
        "the task draws it already": any(name.startswith(f"effects.{effect.name}.") for name in drawn),
        f"the robot has {' and '.join(rivals)} in its place": bool(rivals),
        "acts in water": effect.medium == "water" and all(other.medium != "water" for other in own),
        "changes no observation of this policy": effect.acts_on == "sensor" and not measured,
        "needs a vehicle above": "other_position" in effect.needs,
        "this environment has no ground": effect.cause == "ground_effect" and env.ground_height is None,
        "this environment has no ceiling": "ceiling_height" in effect.needs and env.ceiling_height is None,
    }.items():
        if holds:
            return reason
    try:
        whole = _neutral_robot(robot, [effect])
        check_effects(whole)
        choose_backend(sim.backend, needs=robot_needs(whole, torch.device("cpu"), integrator=sim.integrator))
    except (ConfigError, CapabilityError) as error:
        return str(error).removeprefix(f"effect {effect.name}: ")
    return ""


def _cells(effect: Effect, robot: RobotCfg, sizes: Mapping[str, float]) -> Iterator[Cell]:
    """Yield the cells of an effect of a robot."""
    sized = size_parameters(effect, robot)
    for name, size in sizes.items() if sized else [("failure", 1.0)]:
        variants = tuple(_variants(effect, robot, sized, size))
        if variants:
            label = cell_label(effect.name, size, sized)
            yield Cell(name=f"{effect.name}/{name}", label=label, subject=effect.name, variants=variants)


def size_parameters(effect: Effect, robot: RobotCfg) -> tuple[Parameter, ...]:
    """Return the parameters that change the size of an effect: those that are zero in a neutral one, if any is."""
    numbers = dict(zip((each.name for each in effect.parameters), effect.neutral(robot), strict=True))
    names = SIZED_BY.get(effect.name) or effect.shown_by
    sized = [each for each in effect.parameters if each.kind == "number" and (not names or each.name in names)]
    zero = [each for each in sized if numbers[each.name] == 0.0]
    return tuple(sized if names else zero or sized)


def _variants(effect: Effect, robot: RobotCfg, sized: Collection[Parameter], size: float) -> Iterator[Variant]:
    """Yield each rotor, parameter and sign of a change within the bounds of the parameter."""
    declared, limits = robot.effects[effect.name], dict(zip(effect.parameters, effect.bounds(robot), strict=True))
    shared = {(effect.name, name): moment for name, moment in FAILURE.items() if name in declared}
    if effect.acts_on == "environment" and not any(_has_drag(name, robot) for name in robot.effects):
        shared |= {(DRAG, each.name): each.scale for each in EFFECTS.get(DRAG).parameters}
    turning = [each.name for each in effect.parameters if each.kind == "rotor"]
    for rotor in range(1, robot.num_rotors + 1) if turning else (None,):
        base = shared | {(effect.name, name): float(rotor) for name in turning if rotor is not None}
        if not sized:
            yield Variant(values=base, label=variant_label(rotor))
        for each in sized:
            for change in (size * each.scale, -size * each.scale):
                value, (low, high) = declared[each.name] + change, limits[each]
                if max(low, each.low) <= value <= min(high, each.high):
                    yield Variant(
                        values=base | {(effect.name, each.name): value}, label=variant_label(rotor, each, change)
                    )


def _has_drag(name: str, robot: RobotCfg) -> bool:
    effect = EFFECTS.get(name)
    return effect.cause in DRAG_CAUSES and any(
        robot.effects[name][each.name] for each in size_parameters(effect, robot)
    )


def _weak_rotor(robot: RobotCfg, share: float) -> Cell:
    effect = EFFECTS.get("weak_motor")
    sized = size_parameters(effect, robot)
    variants = _variants(effect, robot, sized, share / sized[0].scale)
    weak = tuple(each for each in variants if each.values["weak_motor", "scale"] < robot.effects["weak_motor"]["scale"])
    return Cell(
        name=f"weak_rotor/{share:.0%}",
        label=f"one rotor {100.0 * share:.3g} % weak",
        subject="weak_motor",
        variants=weak,
    )
