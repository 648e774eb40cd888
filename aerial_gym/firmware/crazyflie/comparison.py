"""Comparison of the firmware's controllers with those here, while it flies to random goals. Letters: E environments."""

from collections.abc import Iterator
from pathlib import Path

import torch
from torch import Tensor

from aerial_gym.errors import ConfigError
from aerial_gym.firmware.comparison import Difference, compare_flight
from aerial_gym.firmware.crazyflie.environment import TWINS, CrazyflieEnv, make_hover_env
from aerial_gym.math.quaternion import yaw_from_quat

GOAL_STEPS = 100  # Environment steps between new goals: 1 s

REACH, TURN = 0.08, 0.05
"""Largest distance [m] and yaw [rad] of goals from the start: no limit acts that only firmware or controller has, of the tilt,
of integrals, or under saturation."""


def compare_controller(
    name: str, *, checkout: Path | None, robot: str | Path = "crazyflie_21", instances: int = 4, duration: float = 4.0,
    seed: int = 0,
) -> Difference:  # fmt: skip
    """Return the difference of rotor commands over ``duration`` [s]; raise ``ConfigError`` if no controller here follows."""
    if name not in TWINS:
        raise ConfigError(f"controller {name!r}: none here follows it. Take one of {', '.join(TWINS)}")
    env = make_hover_env(robot, name, checkout=checkout, instances=instances, seed=seed)
    return compare_flight(env, name, _goals(env, round(duration / env.dt), seed))


def _goals(env: CrazyflieEnv, steps: int, seed: int) -> Iterator[Tensor]:
    generator, reach = torch.Generator().manual_seed(seed), torch.tensor([REACH, REACH, REACH, TURN])
    start = goal = torch.cat((env.gtd["robot_position"], yaw_from_quat(env.gtd["robot_orientation"])[:, None]), dim=-1)
    for step in range(steps):
        if step % GOAL_STEPS == 0:
            goal = start + (2.0 * torch.rand(env.num_envs, 4, generator=generator) - 1.0) * reach
        yield goal
