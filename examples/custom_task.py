"""A task of one's own in one file: fly a figure eight nose first.

    aerial-gym train --task examples/custom_task.py:FIGURE_EIGHT --trainer ppo --max-time-s 60 --out runs/eight
    aerial-gym evaluate --policy runs/eight

Terms are pure functions: what stands before the ``*`` is read, keys of ``print(env.gtd)`` or buffers of the task, (E, ...);
what stands behind it are numbers that the task gives. They are traced into one kernel with all others.
"""

import torch
from torch import Tensor

from aerial_gym import task_registry
from aerial_gym.config.task import TaskCfg
from aerial_gym.config.task_terms import ActionCfg, CommandCfg, EndRewardCfg, ObservationCfg, RewardCfg, TerminationCfg
from aerial_gym.math.quaternion import quat_rotate, quat_rotate_inverse
from aerial_gym.task import OBSERVATIONS, REWARDS, TERMINATIONS


@OBSERVATIONS.term(width=3)
def way_body(target_velocity: Tensor, robot_orientation: Tensor) -> Tensor:
    """Return the target's velocity [m/s], body frame, (E, 3)."""
    return quat_rotate_inverse(robot_orientation, target_velocity)


@REWARDS.term()
def nose_along_the_way(target_velocity: Tensor, robot_orientation: Tensor, *, power: int = 1) -> Tensor:
    """Return ``max(cos a, 0) ** power``, (E,), with the angle a between body x and the target's velocity."""
    forward = torch.zeros_like(target_velocity) + torch.cat(
        [torch.ones_like(target_velocity[:, :1]), torch.zeros_like(target_velocity[:, :2])], dim=-1
    )
    nose = quat_rotate(robot_orientation, forward)
    speed = target_velocity.norm(dim=-1).clamp_min(1e-6)
    return ((nose * target_velocity).sum(dim=-1) / speed).clamp_min(0.0) ** power


@TERMINATIONS.term()
def upside_down(robot_orientation: Tensor) -> Tensor:
    """Return whether the body's z axis points below the horizon, (E,)."""
    x, y, _, _ = robot_orientation.unbind(-1)
    return 1.0 - 2.0 * (x * x + y * y) < 0.0


FIGURE_EIGHT = TaskCfg(
    summary="follow a point on a figure eight, nose first",
    sim="base_sim",
    env="empty_env",
    robot="base_quadrotor",
    controller="lee_attitude_control",
    num_envs=4096,
    episode_len_steps=800,
    command=CommandCfg(
        generator="trajectory",
        params={"curve": "lemniscate", "size": (1.5, 1.5, 0.0), "period": 8.0, "random_phase": True},
    ),
    action=ActionCfg(delay_steps=(0, 2), filter_time_s=0.01),
    observations={
        "policy": (
            ObservationCfg(term="position_error_body", noise_std=0.005),
            ObservationCfg(term="velocity_error_world"),
            ObservationCfg(term="rotation_rows"),
            ObservationCfg(term="ang_vel_body", noise_std=0.02, scale=0.5),
            ObservationCfg(term="way_body"),
            ObservationCfg(term="policy_action"),
        ),
        "critic": (
            ObservationCfg(term="position_error_body"),
            ObservationCfg(term="velocity_error_world"),
            ObservationCfg(term="rotation_rows"),
            ObservationCfg(term="ang_vel_body", scale=0.5),
            ObservationCfg(term="way_body"),
            ObservationCfg(term="rotor_speed", scale=1e-3),
            ObservationCfg(term="action_delay"),
        ),
    },
    rewards={
        "near": RewardCfg(term="distance_bell", params={"height": 1.0, "width": 4.0}),
        "distance": RewardCfg(term="distance_linear", params={"offset": 2.0, "scale": 4.0}),
        "nose": RewardCfg(term="nose_along_the_way", times=("near",)),
        "calm": RewardCfg(term="still", params={"height": 0.2}),
    },
    crash_reward=EndRewardCfg(value=-10.0),
    terminations={
        "lost": TerminationCfg(term="far_from_target", kind="crash", params={"distance": 4.0}),
        "upside_down": TerminationCfg(term="upside_down", kind="crash"),
    },
    source="an example: ours",
)

task_registry.register("figure_eight_task", FIGURE_EIGHT)
