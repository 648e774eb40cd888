"""Terms of a task from its configuration: look-up of names, check of numbers and controller."""

from collections.abc import Iterable, Mapping
from typing import Any

import torch
from torch import Tensor

from aerial_gym.config.task import TaskCfg
from aerial_gym.config.task_terms import ObservationCfg, RewardCfg, TerminationCfg
from aerial_gym.errors import AerialGymError, CapabilityError, ConfigError, UnknownNameError
from aerial_gym.task.terms.actions import ACTIONS, Action
from aerial_gym.task.terms.catalog import OBSERVATIONS, REWARDS, TERMINATIONS
from aerial_gym.task.terms.observations import tensor_term
from aerial_gym.task.terms.term import (
    ACTION,
    BoundTerm,
    Term,
    TermRegistry,
    bind_term,
    call_term,
    check_params,
    check_result,
)
from aerial_gym.task.values import Values

Observed = list[tuple[BoundTerm, ObservationCfg, int]]  # Terms of a group with their widths

UNTRACED = (
    *("vec_root_tensor", "robot_state_tensor", "robot_clearance", "robot_contact_force"),
    *("robot_link_state_tensor", "robot_link_body_angvel", "robot_link_clearance"),
)
"""Quantities computed from the motion without gradients, besides all sensor data."""

SENSORS = "SensorManager"  # Owner of that


def check_terms(cfg: TaskCfg) -> None:
    """Raise one error that names all actions, rewards, observations and terminations of a task with a wrong name or number."""
    parts = [(ACTIONS, f"action {cfg.action.transform}", cfg.action.transform, cfg.action.params)]
    for registry, kind, entries in ((REWARDS, "reward", cfg.rewards), (TERMINATIONS, "termination", cfg.terminations)):
        parts += [
            (registry, f"{kind} {name!r} ({each.term})", each.term, each.params) for name, each in entries.items()
        ]
    observations = [each for group in cfg.observations.values() for each in group if each.term in OBSERVATIONS]
    parts += [(OBSERVATIONS, f"observation term {each.term!r}", each.term, each.params) for each in observations]
    errors: list[AerialGymError] = []
    for registry, label, term, params in parts:
        try:
            check_params(registry.get(term).value, params, label)
        except AerialGymError as error:
            errors.append(error)
    if len(errors) > 1:
        raise ConfigError(*dict.fromkeys(fault for error in errors for fault in error.args))


def resolve_action(cfg: TaskCfg, command: tuple[str, ...]) -> tuple[Action, dict[str, Any]]:
    """Return the transform of the actions and its numbers."""
    name = cfg.action.transform
    action = ACTIONS.get(name)
    _check_command(f"action {name}: gives", action.command, cfg, command)
    return action, check_params(action.value, cfg.action.params, f"action {name}")


def resolve_groups(cfg: TaskCfg, values: Values, *, num_commands: int) -> dict[str, Observed]:
    """Return the observation terms of each group with the entries that each returns."""
    rows = values.gtd["sim_steps"].shape[0]
    resolved: dict[str, Observed] = {}
    for group, entries in cfg.observations.items():
        resolved[group] = []
        for number, entry in enumerate(entries):
            term, first = _observation_term(entry.term, values), [other.term for other in entries].index(entry.term)
            label = f"observation term {entry.term!r}" + ("" if number == first else f" ({number})")
            bound = bind_term(term, entry.params, label if group == "policy" else f"{label} of {group!r}")
            values.term_inputs(bound)
            declared = num_commands if term.width == ACTION else term.width
            resolved[group].append((bound, entry, term_width(bound, values, rows=rows, width=declared)))
    return resolved


def _observation_term(name: str, values: Values) -> Term:
    if name in OBSERVATIONS:
        return OBSERVATIONS.get(name)
    try:
        values.find(name, "observation term")
    except UnknownNameError:
        OBSERVATIONS.get(name)  # raises with the known names
        raise
    return tensor_term(name)


def resolve_rewards(cfg: TaskCfg, values: Values, command: tuple[str, ...]) -> dict[str, tuple[BoundTerm, RewardCfg]]:
    """Return the reward terms by name."""
    return {
        name: (_resolve_term(REWARDS, f"reward {name!r}", entry, cfg, values, command), entry)
        for name, entry in cfg.rewards.items()
    }


def resolve_terminations(
    cfg: TaskCfg, values: Values, command: tuple[str, ...]
) -> dict[str, tuple[BoundTerm, TerminationCfg]]:
    """Return the terminations by name."""
    return {
        name: (_resolve_term(TERMINATIONS, f"termination {name!r}", entry, cfg, values, command), entry)
        for name, entry in cfg.terminations.items()
    }


def _resolve_term(
    registry: TermRegistry, label: str, cfg: RewardCfg | TerminationCfg, task: TaskCfg, values: Values,
    command: tuple[str, ...],
) -> BoundTerm:  # fmt: skip
    """Return a term with one result for each environment: a truth value of a termination, a number of a reward."""
    entry = registry.get(cfg.term)
    _check_command(f"{label}: term {cfg.term} is about", entry.command, task, command)
    bound = bind_term(entry, cfg.params, f"{label} ({cfg.term})")
    values.term_inputs(bound)
    truth = registry is TERMINATIONS  # (E, 1) would be spread to (E, E) in silence
    check_result(bound.label, call_term(bound, values), (values.gtd["sim_steps"].shape[0],), "(E,)", truth=truth)
    return bound


def _check_command(label: str, needed: tuple[str, ...] | None, cfg: TaskCfg, command: tuple[str, ...]) -> None:
    if needed is not None and needed != command:
        raise ConfigError(f"{label} {', '.join(needed)}; controller {cfg.controller} takes {', '.join(command)}")


def check_gradients(
    rewards: Iterable[BoundTerm], observations: Iterable[BoundTerm], values: Values, *, images: Iterable[str]
) -> None:
    """Refuse terms that follow from the motion without gradient; in rewards also booleans, which cause jumps."""
    for image in images:
        raise CapabilityError(f"image {image!r}: has no gradient, and differentiable=True asks for one. Leave it out")
    for terms, jumps in ((rewards, True), (observations, False)):
        for term in terms:
            name = _input_without_gradient(term, values, jumps=jumps)
            if name is not None:
                raise CapabilityError(
                    f"{term.label}: reads {name}, which has no gradient, and differentiable=True asks for one. Leave the term "
                    "out, or compute it from env.gradient_tensors"
                )


def _input_without_gradient(term: BoundTerm, values: Values, *, jumps: bool, seen: tuple[str, ...] = ()) -> str | None:
    """Return the first input of a term, or of its buffers, that has no gradient; None if all have one."""
    for name in term.reads:
        sensed = name in values.measured or (name in values.gtd and values.gtd.spec(name).owner == SENSORS)
        if sensed or name in UNTRACED or (jumps and name != "begun" and values[name].dtype == torch.bool):
            return name
        if name in values.updates and name not in seen:
            source = _input_without_gradient(values.updates[name], values, jumps=jumps, seen=(*seen, name))
            if source is not None:
                return source
    return None


def term_width(term: BoundTerm, values: Mapping[str, Tensor], *, rows: int, width: int | None) -> int:
    """Return the entries of an observation term per environment, by calling it once; ``width`` is the declared number."""
    value = call_term(term, values)
    if width is None:
        if not isinstance(value, Tensor) or value.dim() != 2 or value.shape[0] != rows:
            check_result(term.label, value, (rows, -1), "(E, W)")
        width = value.shape[1]
    check_result(term.label, value, (rows, width), "(E, width)")
    return width
