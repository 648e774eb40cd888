"""The position task with changed settings, and the reward of given states, for tests."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import torch
from torch import Tensor

from aerial_gym import ROBOTS, Task, task_registry
from aerial_gym.config.sensor_mount import SensorMountCfg
from aerial_gym.config.task import TaskCfg
from aerial_gym.config.task_terms import (
    ActionCfg,
    CommandCfg,
    FaultCfg,
    ImageCfg,
    ObservationCfg,
    RewardCfg,
    TerminationCfg,
)
from aerial_gym.task.step.judge import EpisodeEnds
from tests.builders import simulation


def make(num_envs: int = 4, *, seed: int = 0, first_env: int = 0, **changes: object) -> Task:
    if "policy" in changes:
        changes["observations"] = {"policy": changes.pop("policy")}
    cfg = replace(task_registry.get("position_setpoint_task"), **changes)
    return build_task(cfg, num_envs, seed=seed, first_env=first_env)


def build_task(cfg: TaskCfg, num_envs: int, *, robot=None, device="cpu", capture=None, gradients=None, **given) -> Task:
    """Return a task of a configuration, with a robot that need not be registered; ``gradients``: in this float type."""
    given |= {"sim": cfg.sim, "env": cfg.env, "num_envs": num_envs, "device": device, "randomize": cfg.randomize}
    given |= {"differentiable": gradients is not None, "dtype": gradients or torch.float32}
    robot = robot or cfg.robot
    if cfg.num_vehicles > 1:
        robot, given["robots"] = None, [{"name": robot, "count": cfg.num_vehicles}]
    return Task(cfg, simulation(robot, cfg.controller, **given), capture=capture)


def put(task: Task, positions: Tensor | Sequence[Sequence[float]]) -> None:
    """Put the robots at rest somewhere; a hover of one step moves them by less than 5 mm."""
    state = task.env.robot_manager.tensors.state
    state.position.copy_(torch.as_tensor(positions))
    state.lin_vel.zero_()


def begin(name: str, num_envs: int, **given: Any) -> Task:
    task = task_registry.make_task(name, num_envs=num_envs, device="cpu", **given)
    task.reset()
    return task


def camera_task(num_envs: int, **given: Any) -> Task:
    """Return a task with a small camera between obstacles, its raw images and their nearest distances, both with a past."""
    cfg = replace(
        task_registry.get("position_setpoint_task"),
        env="env_with_obstacles",
        observations={"policy": (ObservationCfg(term="attitude"), ObservationCfg(term="nearest_in_cells", history=2))},
        images={"depth": ImageCfg(history=2), "exact": ImageCfg(dtype="float32")},
        episode_len_steps=50,
    )
    small = replace(ROBOTS.get("base_quadrotor"), sensors=(SensorMountCfg(sensor="st_vl53l5cx", rate_hz=6.0),))
    return build_task(cfg, num_envs, robot=small, **given)


def rich(num_envs: int, **given: Any) -> Task:
    """Return a task in which everything that remembers is used, and everything that is drawn."""
    params = {"curve": "lemniscate", "size": (1.0, 1.0, 0.0), "period": 4.0, "random_phase": True}
    cfg = replace(
        task_registry.get("position_setpoint_task"),
        command=CommandCfg(generator="trajectory", params=params),
        action=ActionCfg(delay_steps=(0, 3), filter_time_s=0.05),
        observations={
            "policy": (
                ObservationCfg(term="position_error_world", noise_std=0.01, delay_steps=(0, 4), history=3, scale=0.5),
                ObservationCfg(term="velocity_error_world", delay_steps=2, fault="jump"),
                ObservationCfg(term="attitude", noise_std=0.02, dropout=0.3, dropout_value=-2.0),
                ObservationCfg(term="policy_action"),
            ),
            "critic": (
                ObservationCfg(term="position_error_world", history=2),
                ObservationCfg(term="previous_distance"),
                ObservationCfg(term="rotor_speed", scale=1e-3),
            ),
        },
        faults={"jump": FaultCfg(how="jump", begin_steps=(1, 3), duration_steps=(1, 4), size=0.5, share=0.7)},
        rewards={
            "near": RewardCfg(term="distance_bell", params={"height": 1.0, "width": 1.0}),
            "progress": RewardCfg(term="progress", params={"closer": 1.0, "further": 1.0}, times=("near",)),
        },
        terminations={
            "contact": TerminationCfg(term="contact", kind="crash"),
            "there": TerminationCfg(term="at_target", kind="success", when="counts", params={"radius": 0.5}),
        },
    )
    return build_task(cfg, num_envs, **given)


def term_reward(task: Task, values: Mapping[str, Tensor], *, crash: Tensor | None = None) -> Tensor:
    """Return the reward of a task's terms for given states, (E,), in the float type of the states."""
    no = torch.zeros(len(values["robot_position"]), dtype=torch.bool)
    ended = no if crash is None else crash
    ends = EpisodeEnds(crash=ended, success=no, terminated=ended, truncated=no, arrived=no, causes=[])
    return task._judge._reward_terms(values, ends)[1]
