"""Task configurations: flat classes with names of what to build, sizes and reward parameters.

Only for tasks of this package: a task class of a user's own reads its configuration class itself.
"""

from typing import Any

from aerial_gym.compat.config.fields import STANDS_FOR, Changes, Table, Values, carried, derived, idle, kept
from aerial_gym.config.task import CurriculumCfg, TaskCfg
from aerial_gym.control import CONTROLLERS
from aerial_gym.control.laws import LAWS
from aerial_gym.env_manager import robot_by_name
from aerial_gym.task import task_registry
from aerial_gym.task.actions import ACTIONS
from aerial_gym.task.observations import OBSERVATIONS


def _num_actions(cfg: TaskCfg) -> int:
    width = ACTIONS[cfg.action].width
    if width is not None:
        return width
    law = CONTROLLERS.get(cfg.controller).law
    return len(LAWS[law].action) if law in LAWS else robot_by_name(cfg.robot).num_rotors


def _num_observations(cfg: TaskCfg) -> int:
    widths = (OBSERVATIONS[entry.term].width for entry in cfg.observations)
    return sum(_num_actions(cfg) if width is None else width for width in widths)


def _curriculum(name: str, theirs: str) -> Any:
    return carried(
        f"curriculum.{theirs}",
        f"curriculum.{name}",
        lambda cfg: None if cfg.curriculum is None else getattr(cfg.curriculum, name),
    )


def _reward(values: Values) -> Changes:
    return {"reward_params": {name: float(value) for name, value in values["reward_parameters"].items()}}


_NAMED = "the name of something registered, here or by the script"
_CURRICULUM = (
    ("min_level", "min_level"),
    ("max_level", "max_level"),
    ("check_after", "check_after_log_instances"),
    ("raise_by", "increase_step"),
    ("lower_by", "decrease_step"),
    ("raise_above", "success_rate_for_increase"),
    ("lower_below", "success_rate_for_decrease"),
)
assert {name for name, _ in _CURRICULUM} | {"start_level"} == set(CurriculumCfg.__dataclass_fields__)

TABLE = Table(
    kind="task",
    fields=(
        carried("sim_name", "sim", lambda c: c.sim, remark=_NAMED),
        carried("env_name", "env", lambda c: c.env, remark=_NAMED),
        carried("robot_name", "robot", lambda c: c.robot, remark=_NAMED),
        carried("controller_name", "controller", lambda c: c.controller, remark=_NAMED),
        carried("num_envs", "num_envs", lambda c: c.num_envs),
        carried("episode_len_steps", "episode_len_steps", lambda c: c.episode_len_steps,
                remark="an episode has exactly as many steps; there one more"),
        carried("reward_parameters", "reward_params", lambda c: dict(c.reward_params), _reward,
                "the names of the YAML file; four tasks there ignored theirs"),
        carried("target_min_ratio", "target_ratio_low", lambda c: c.target_ratio_low),
        carried("target_max_ratio", "target_ratio_high", lambda c: c.target_ratio_high),
        *(_curriculum(ours, theirs) for ours, theirs in _CURRICULUM),
        derived("observation_space_dim", _num_observations, "follows from `observations:` of a task file"),
        derived("action_space_dim", _num_actions, "follows from the action and the controller"),
        kept("device", "make_task(device=...)", lambda _: "auto"),
        kept("seed", "make_task(seed=...)", lambda _: 0, "of this task alone; nothing global is seeded"),
        kept("return_state_before_reset", 'info["final_observation"]', lambda _: False),
        idle("privileged_observation_space_dim", 0, "there is no such group yet"),
        idle("args", {}, "the command line is the script's own"),
        idle("use_warp", True, "sensors always are Warp's"),
        idle("headless", True, "there is no viewer window"),
    ),
    idle_sections={},
)  # fmt: skip
"""What becomes of the attributes of a task configuration class."""

_made: dict[str, type] = {}


def task_class_config(name: str) -> type:
    """Return the configuration class that stands for a registered task; the same one at every call."""
    if name not in _made:
        _made[name] = TABLE.class_of("task_config", task_registry.get(name))
    return _made[name]


def task_of(cls: Any, name: str) -> TaskCfg:
    """Return our task for a configuration class; one that stands for none changes the task of a name."""
    return TABLE.translate(cls, getattr(cls, STANDS_FOR, task_registry.get(name)))
