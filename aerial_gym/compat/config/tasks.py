"""Task configurations: flat classes with names of what to build, sizes and reward parameters.

Only for tasks of this package: a task class of a user's own reads its configuration class itself.
"""

from functools import cache
from operator import attrgetter
from typing import Any

from aerial_gym.compat.config import fields
from aerial_gym.config.task import POLICY, CurriculumCfg, TaskCfg
from aerial_gym.config.task_terms import CommandCfg
from aerial_gym.control import CONTROLLERS
from aerial_gym.control.laws import LAWS
from aerial_gym.errors import ConfigError
from aerial_gym.robots.catalog import robot_by_name
from aerial_gym.task import ACTIONS, OBSERVATIONS, task_registry
from aerial_gym.task.terms.term import ACTION


def _num_actions(cfg: TaskCfg) -> int:
    width = ACTIONS.get(cfg.action.transform).width
    if width is not None:
        return width
    law = CONTROLLERS.get(cfg.controller).law
    return len(LAWS[law].action) if law in LAWS else robot_by_name(cfg.robot).num_rotors


def _num_observations(cfg: TaskCfg) -> int | None:
    """Return the number of observation entries; None if only the built task determines it."""
    total = 0
    for entry in cfg.observations[POLICY]:
        width = OBSERVATIONS.get(entry.term).width if entry.term in OBSERVATIONS else None
        if width is None:
            return None
        total += (_num_actions(cfg) if width == ACTION else width) * entry.history
    return total


def _reward_numbers(cfg: TaskCfg) -> dict[str, float]:
    """Return the parameters of all reward terms, ``term.number``, their weights, and the crash reward."""
    entries: dict[str, float] = {}
    for name, reward in cfg.rewards.items():
        entries |= {f"{name}.{key}": value for key, value in reward.params.items() if isinstance(value, (int, float))}
        entries[f"{name}.weight"] = reward.weight
    return entries | ({} if cfg.crash_reward is None else {"crash": cfg.crash_reward.value})


def _reward_changes(values: fields.Values) -> fields.Changes:
    entries: fields.Changes = {}
    for key, value in values["reward_parameters"].items():
        name, _, number = key.partition(".")
        place = f"rewards.{name}.weight" if number == "weight" else f"rewards.{name}.params.{number}"
        entries["crash_reward.value" if key == "crash" else place] = float(value)
    return entries


def _target_limit_reader(name: str) -> Any:
    """Return the lower or upper share of the bounds for random targets; None without random targets."""
    return lambda cfg: None if cfg.command is None else cfg.command.params.get(name)


def _target_changes(values: fields.Values) -> fields.Changes:
    low, high = values["target_min_ratio"], values["target_max_ratio"]
    if low is None or high is None:
        raise ConfigError("target_min_ratio and target_max_ratio: give both, or neither")
    params = {"low": tuple(map(float, low)), "high": tuple(map(float, high))}
    return {"command": CommandCfg(generator="drawn_point", params=params)}


_CURRICULUM = (
    ("min_level", "min_level"), ("max_level", "max_level"), ("check_after", "check_after_log_instances"),
    ("raise_by", "increase_step"), ("lower_by", "decrease_step"), ("raise_above", "success_rate_for_increase"),
    ("lower_below", "success_rate_for_decrease"),
)  # fmt: skip
assert {name for name, _ in _CURRICULUM} | {"start_level"} == set(CurriculumCfg.__dataclass_fields__)

TABLE = fields.ConfigTable(
    kind="task",
    fields=(
        *(fields.native_field(f"{kind}_name", kind, attrgetter(kind),
                  remark="the name of something registered, here or by the script")
          for kind in ("sim", "env", "robot", "controller")),
        *fields.same_fields("num_envs"),
        fields.native_field("episode_len_steps", "episode_len_steps", lambda c: c.episode_len_steps,
                remark="an episode has exactly as many steps; there one more"),
        fields.native_field("reward_parameters", "rewards", _reward_numbers, _reward_changes,
                "by the names of the task file, reward and number (near.height); four tasks there ignored theirs"),
        fields.native_field("target_min_ratio", "command: low", _target_limit_reader("low"), _target_changes,
                "of the generator drawn_point"),
        fields.native_field("target_max_ratio", "command: high", _target_limit_reader("high"), _target_changes, "likewise"),
        *(fields.native_field(f"curriculum.{script_name}", f"curriculum.{native}",
                  lambda c, native=native: None if c.curriculum is None else getattr(c.curriculum, native))
          for native, script_name in _CURRICULUM),
        fields.unchangeable_field("observation_space_dim", _num_observations, "follows from `observations:` of a task file"),
        fields.unchangeable_field("action_space_dim", _num_actions, "follows from the action and the controller"),
        fields.class_only_field("device", "make_task(device=...)", lambda _: "auto"),
        fields.class_only_field("seed", "make_task(seed=...)", lambda _: 0, "of this task alone; nothing global is seeded"),
        fields.class_only_field("return_state_before_reset", 'info["final_observation"]', lambda _: False),
        fields.idle_field("privileged_observation_space_dim", 0, "a group of observations of its own name, such as `critic`"),
        fields.idle_field("args", {}, "the command line is the script's own"),
        fields.idle_field("use_warp", True, "sensors always are Warp's"),
        fields.idle_field("headless", True, "there is no viewer window"),
    ),
)  # fmt: skip
"""Translation of the attributes of a task configuration class."""


@cache
def task_class_config(name: str) -> type:
    """Return the configuration class of a registered task, the same one at every call."""
    return TABLE.make_class("task_config", task_registry.get(name))


def translate_task(cls: Any, name: str) -> TaskCfg:
    """Return the translated task of a configuration class; a class of no registered task modifies the task of a name."""
    return TABLE.translate(cls, getattr(cls, fields.STANDS_FOR, task_registry.get(name)))
