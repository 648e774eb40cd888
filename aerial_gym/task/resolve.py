"""Terms of a task from its configuration: look-up of names, check of numbers and controller."""

from collections.abc import Iterable, Mapping
from typing import Any

import torch

from aerial_gym.config.task import TaskCfg
from aerial_gym.config.task_terms import ObservationCfg, RewardCfg, TerminationCfg
from aerial_gym.errors import CapabilityError, ConfigError, UnknownNameError
from aerial_gym.task.step.term_checks import check_number, check_truth, term_width
from aerial_gym.task.terms.actions import ACTIONS, Action
from aerial_gym.task.terms.catalog import OBSERVATIONS, REWARDS, TERMINATIONS
from aerial_gym.task.terms.observations import tensor_term
from aerial_gym.task.terms.term import ACTION, BoundTerm, Term, TermRegistry, bind, check_params
from aerial_gym.task.values import Values

Observed = list[tuple[BoundTerm, ObservationCfg, int]]
"""Terms of a group with their widths."""

UNTRACED = (
    *("vec_root_tensor", "robot_state_tensor", "robot_clearance", "robot_contact_force"),
    *("robot_link_state_tensor", "robot_link_body_angvel", "robot_link_clearance"),
)
"""Quantities computed from the motion without gradients, besides all sensor data."""

SENSORS = "SensorManager"
"""Owner of that."""


def resolve_action(cfg: TaskCfg, command: tuple[str, ...]) -> tuple[Action, dict[str, Any]]:
    """Return the transform of the actions and its numbers.

    Raises:
        UnknownNameError: If there is no such transform.
        ConfigError: If its numbers do not fit, or its command does not suit the controller.
    """
    name = cfg.action.transform
    action = ACTIONS.get(name)
    _check_command(f"action {name}: gives", action.command, cfg, command)
    return action, check_params(action.value, cfg.action.params, f"action {name}")


def resolve_groups(cfg: TaskCfg, values: Values, *, num_commands: int) -> dict[str, Observed]:
    """Return the observation terms of each group with the entries that each returns.

    Raises:
        UnknownNameError: If a term, key or buffer does not exist.
        ConfigError: If numbers or shapes do not fit.
    """
    rows = values.gtd["sim_steps"].shape[0]
    resolved: dict[str, Observed] = {}
    for group, entries in cfg.observations.items():
        resolved[group] = []
        for number, entry in enumerate(entries):
            term = _observation(entry.term, values)
            label = f"observation term {entry.term!r}" + ("" if number == _first(entries, entry) else f" ({number})")
            bound = bind(term, entry.params, label if group == "policy" else f"{label} of {group!r}")
            values.term_inputs(bound)
            said = num_commands if term.width == ACTION else term.width
            resolved[group].append((bound, entry, term_width(bound, values, rows=rows, width=said)))
    return resolved


def _first(entries: tuple[ObservationCfg, ...], entry: ObservationCfg) -> int:
    return next(i for i, other in enumerate(entries) if other.term == entry.term)


def _observation(name: str, values: Values) -> Term:
    if name in OBSERVATIONS:
        return OBSERVATIONS.get(name)
    try:
        values.find(name, "observation term")
    except UnknownNameError:
        OBSERVATIONS.get(name)  # raises with the known names
        raise
    return tensor_term(name)


def resolve_rewards(cfg: TaskCfg, values: Values, command: tuple[str, ...]) -> dict[str, tuple[BoundTerm, RewardCfg]]:
    """Return the reward terms by name.

    Raises:
        UnknownNameError: If a term or one of its inputs does not exist.
        ConfigError: If numbers, shapes or the controller do not fit.
    """
    resolved = {}
    for name, entry in cfg.rewards.items():
        bound = _bound(REWARDS, entry.term, entry.params, f"reward {name!r}", cfg, values, command)
        check_number(bound, values, rows=values.gtd["sim_steps"].shape[0])
        resolved[name] = (bound, entry)
    return resolved


def resolve_terminations(
    cfg: TaskCfg, values: Values, command: tuple[str, ...]
) -> dict[str, tuple[BoundTerm, TerminationCfg]]:
    """Return the terminations by name, with the errors of ``resolve_rewards``."""
    resolved = {}
    for name, entry in cfg.terminations.items():
        bound = _bound(TERMINATIONS, entry.term, entry.params, f"termination {name!r}", cfg, values, command)
        check_truth(bound, values, rows=values.gtd["sim_steps"].shape[0])
        resolved[name] = (bound, entry)
    return resolved


def _bound(
    registry: TermRegistry,
    term: str,
    params: Mapping[str, object],
    label: str,
    cfg: TaskCfg,
    values: Values,
    command: tuple[str, ...],
) -> BoundTerm:
    entry = registry.get(term)
    _check_command(f"{label}: term {term} is about", entry.command, cfg, command)
    bound = bind(entry, params, f"{label} ({term})")
    values.term_inputs(bound)
    return bound


def _check_command(label: str, needed: tuple[str, ...] | None, cfg: TaskCfg, command: tuple[str, ...]) -> None:
    if needed is not None and needed != command:
        raise ConfigError(f"{label} {', '.join(needed)}; controller {cfg.controller} takes {', '.join(command)}")


def check_gradients(
    rewards: Iterable[BoundTerm], observations: Iterable[BoundTerm], values: Values, *, images: Iterable[str]
) -> None:
    """Refuse terms that follow from the motion without gradient.

    Args:
        rewards: Terms of the reward, in which booleans cause jumps.
        observations: Terms of all groups, in which booleans are allowed.
        images: Names of raw images among the observations.

    Raises:
        CapabilityError: If there is one; the message has its name and its input.
    """
    for image in images:
        raise CapabilityError(f"image {image!r}: has no gradient, and differentiable=True asks for one. Leave it out")
    for terms, jumps in ((rewards, True), (observations, False)):
        for term in terms:
            name = _without_gradient(term, values, jumps=jumps)
            if name is not None:
                raise CapabilityError(
                    f"{term.label}: reads {name}, which has no gradient, and differentiable=True asks for one. Leave the term "
                    "out, or compute it from env.gradient_tensors"
                )


def _without_gradient(term: BoundTerm, values: Values, *, jumps: bool, seen: tuple[str, ...] = ()) -> str | None:
    """Return the first input of a term, or of its buffers, that has no gradient; None if all have one."""
    for name in term.reads:
        sensed = name in values.measured or (name in values.gtd and values.gtd.spec(name).owner == SENSORS)
        if sensed or name in UNTRACED or (jumps and name != "begun" and values[name].dtype == torch.bool):
            return name
        if name in values.updates and name not in seen:
            source = _without_gradient(values.updates[name], values, jumps=jumps, seen=(*seen, name))
            if source is not None:
                return source
    return None
