"""The navigation task with changed settings, for tests."""

from dataclasses import replace

from aerial_gym import Task, task_registry
from aerial_gym.config.task import TaskCfg
from tests.unit.task.hover import build_task


def make_cfg(cfg: TaskCfg, *, camera: bool = True, success_radius: float | None = None, **changes: object) -> TaskCfg:
    if not camera:
        blind = tuple(entry for entry in cfg.observations["policy"] if entry.term != "nearest_in_cells")
        cfg = replace(cfg, robot="base_quadrotor", observations={"policy": blind})
    goal = cfg.terminations["goal"]
    goal = replace(goal, params={"radius": success_radius or goal.params["radius"]})
    cfg = replace(cfg, terminations={**cfg.terminations, "goal": goal})
    return replace(cfg, **changes)


def make(num_envs: int = 6, *, seed: int = 0, camera: bool = False, **changes: object) -> Task:
    """Return it; without its camera, which takes most of its time, unless asked for."""
    return build_task(make_cfg(task_registry.get("navigation_task"), camera=camera, **changes), num_envs, seed=seed)
