"""Real objects that tests begin with, in one line each."""

from pathlib import Path

import torch

from aerial_gym.config.controller import ControllerCfg
from aerial_gym.config.environment import EnvironmentCfg
from aerial_gym.config.robot import RobotCfg
from aerial_gym.config.sim import SimCfg
from aerial_gym.env_manager import EnvManager, SimBuilder


def simulation(
    robot: str | Path | RobotCfg | None, controller: str | ControllerCfg = "no_control", *, sim: str | SimCfg = "base_sim",
    env: str | Path | EnvironmentCfg = "empty_env", num_envs: int = 2, device: str | torch.device = "cpu", **options,
) -> EnvManager:  # fmt: skip
    """Return a simulation, built and not yet reset; names may stand for configurations, options are those of ``build_env``."""
    return SimBuilder().build_env(
        sim_name=sim, env_name=env, robot_name=robot, controller_name=controller, num_envs=num_envs,
        device=device, **options,
    )  # fmt: skip
