"""Link and motion that a policy knows from its training, for ``aerial-gym preflight --policy``."""

from pathlib import Path

import numpy as np
import torch

from aerial_gym.export.layout import policy_layout
from aerial_gym.interop import usual_settings
from aerial_gym.rl_training.policies.load import load_policy
from aerial_gym.sim2real.preflight.link import TrainingLink
from aerial_gym.sim2real.preflight.ranges import TrainingConditions
from aerial_gym.task import Task, task_registry

ENVS, STEPS, SEED = 128, 400, 1_000_003  # Flights whose motion is the range, and their seed
EXTREMES = (0.0005, 0.9995)  # Quantiles that are the ends of a range

AXES = ("roll", "pitch", "yaw")


@usual_settings
@torch.no_grad()
def training_conditions(source: str | Path) -> TrainingConditions:
    """Return the conditions of a policy's training.

    The policy flies its task from random starts. Ranges are those of its observations and commands.
    """
    policy, cfg = load_policy(source)
    with task_registry.make_task(
        cfg.task, num_envs=ENVS, seed=SEED, robot=cfg.robot, controller=cfg.controller, encoder=cfg.encoder,
        settings=cfg.settings,
    ) as task:  # fmt: skip
        layout = policy_layout(policy, cfg, task, name="policy", source=str(source))
        robot = task.env.robot_manager.cfg
        observation, _ = task.reset()
        policy.reset()
        rows = []
        for _ in range(STEPS):
            observation, _, terminated, truncated, _ = task.step(policy(observation))
            policy.reset(terminated | truncated)
            rows.append(_motion_of_task(task, layout.command))
    names = rows[0].keys()
    ends = {name: np.quantile(np.concatenate([row[name] for row in rows]), EXTREMES) for name in names}
    latency = 0.5 * sum(layout.action_delay_steps) / layout.rate_hz
    return TrainingConditions(
        link=TrainingLink(rate=layout.rate_hz, latency=latency), source=str(source), robot=robot,
        ranges={name: (float(low), float(high)) for name, (low, high) in ends.items()},
    )  # fmt: skip


def _motion_of_task(task: Task, command: tuple[str, ...]) -> dict[str, np.ndarray]:
    """Return the quantities of a step by the names of ``motion_of_log``, (E,) each."""
    gtd = task.env.gtd
    angles, velocity, rate, action = (
        gtd[key].reshape(task.num_envs, -1).cpu().numpy()
        for key in ("robot_euler_angles", "robot_body_linvel", "robot_body_angvel", "robot_actions")
    )
    motion = {"roll [rad]": angles[:, 0], "pitch [rad]": angles[:, 1]}
    motion |= {f"velocity {name} [m/s]": velocity[:, k] for k, name in enumerate(("forward", "left", "up"))}
    motion |= {f"{name} rate [rad/s]": rate[:, k] for k, name in enumerate(AXES)}
    for name in AXES:
        if f"{name} rate [rad/s]" in command:
            motion[f"commanded {name} rate [rad/s]"] = action[:, command.index(f"{name} rate [rad/s]")]
    return motion | {"rotor speed [rad/s]": gtd["rotor_speed"].reshape(-1).cpu().numpy()}
