"""Smooth tracks through drawn points, by their acceleration or without: ``python examples/tasks/smooth_track.py [STARTS]``.

Flies ``polynomial_tracking_task`` by ``LeePilot``, and the same at twice the speed and four times the acceleration: another
track is a line of configuration. Prints the mean distance over whole flights [m], the first second left out.
"""

import sys
from dataclasses import replace

import torch
from lee_pilot import LeePilot

from aerial_gym import SimBuilder, task_registry
from aerial_gym.config.task import TaskCfg
from aerial_gym.task import Task

CFG = task_registry.get("polynomial_tracking_task")
assert CFG.command is not None
QUICK = replace(CFG.command, params={**CFG.command.params, "max_speed": 5.0, "max_acceleration": 16.0})


def make_task(cfg: TaskCfg, starts: int) -> Task:
    """Return the task of a configuration, on a CPU."""
    env = SimBuilder().build_env(
        sim_name=cfg.sim,
        env_name=cfg.env,
        robot_name=cfg.robot,
        controller_name=cfg.controller,
        num_envs=starts,
        device="cpu",
        seed=1,
    )
    return Task(cfg, env)


def fly(cfg: TaskCfg, starts: int, *, lead: bool) -> tuple[float, float]:
    """Return the mean distance to the target after the first second [m], and the largest speed of a target [m/s]."""
    with make_task(cfg, starts) as task, torch.no_grad():
        pilot, distances, fastest = LeePilot(task, lead=lead), [], 0.0
        observation, _ = task.reset()
        for step in range(cfg.episode_len_steps - 1):
            observation, *_, info = task.step(pilot(observation))
            fastest = max(fastest, float(task.values.own["target_velocity"].norm(dim=-1).max()))
            if step >= 100:
                distances.append(info["distance"].mean())
    return float(torch.stack(distances).mean()), fastest


if __name__ == "__main__":
    starts = int(sys.argv[1]) if len(sys.argv) > 1 else 64
    for name, cfg in (("as registered", CFG), ("twice as quick", replace(CFG, command=QUICK))):
        for lead, label in ((False, "by place and velocity"), (True, "and by acceleration")):
            distance, fastest = fly(cfg, starts, lead=lead)
            print(f"{name}, {label}: {distance:.2f} m off at up to {fastest:.1f} m/s")
