"""The navigation task with changed settings, for tests."""

from dataclasses import replace

from aerial_gym import SimBuilder, task_registry
from aerial_gym.task import Task


def make(num_envs: int = 6, *, seed: int = 0, camera: bool = False, **changes: object) -> Task:
    """Return it; without its camera, which takes most of its time, unless asked for."""
    cfg = task_registry.get("navigation_task")
    if not camera:
        blind = tuple(entry for entry in cfg.observations if entry.term != "nearest_in_cells")
        cfg = replace(cfg, robot="base_quadrotor", observations=blind)
    cfg = replace(cfg, **changes)  # type: ignore[arg-type]
    env = SimBuilder().build_env(
        sim_name=cfg.sim,
        env_name=cfg.env,
        robot_name=cfg.robot,
        controller_name=cfg.controller,
        num_envs=num_envs,
        device="cpu",
        seed=seed,
    )
    return Task(cfg, env)
