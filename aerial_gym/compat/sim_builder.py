"""The simulation builder of the Aerial Gym Simulator: its argument order, its registries, configuration classes."""

from dataclasses import replace
from typing import Any

import torch

from aerial_gym.compat.config.environments import num_envs_and_crash_reset
from aerial_gym.compat.config.fields import copy_class
from aerial_gym.compat.config.robots import has_no_gravity
from aerial_gym.compat.env_manager import EnvManager
from aerial_gym.compat.registries import controller_registry, env_config_registry, robot_registry, sim_config_registry
from aerial_gym.config.randomize import Randomize
from aerial_gym.config.sim import SimCfg
from aerial_gym.env_manager import SIMS
from aerial_gym.env_manager import SimBuilder as Builder
from aerial_gym.robots.catalog import robot_by_name


class SimBuilder:
    """Builds an environment manager from registered names."""

    def __init__(self) -> None:
        self._manager: EnvManager | None = None

    def build_env(
        self, sim_name: str, env_name: str, robot_name: str, controller_name: str,
        device: str | torch.device = "auto", args: object = None, num_envs: int | None = None,
        use_warp: bool | None = None, headless: bool | None = None, *, seed: int | None = None,
        randomize: Randomize | None = None,
    ) -> EnvManager:  # fmt: skip
        """Return a simulation, built and not yet reset.

        Args:
            env_name, robot_name: Registered name, or a file of ours.
            args, use_warp, headless: Without effect.
            num_envs: Number of environments; that of the environment class if not given.
            seed: Seed of every random number of the simulation; if not given that of ``torch.manual_seed``, which scripts call.
            randomize: Draws at resets, by the names of quantities; they replace those of the controller's gains.

        Raises:
            UnknownNameError: If a name is not registered; the message lists the registered ones.
            ConfigError: If a configuration class has a field that is unknown or means nothing here.
        """
        if not isinstance(robot_name, str):
            robot_by_name(robot_name)  # refuses several
        env_class = env_config_registry.config_class(env_name)
        default_envs, reset_on_collision = num_envs_and_crash_reset(env_class)
        robot_class = robot_registry.config_class(robot_name)
        sim = sim_config_registry.native_config(sim_name)
        if has_no_gravity(robot_class):
            sim = replace(sim if isinstance(sim, SimCfg) else SIMS.get(sim), gravity=0.0)
        env = Builder().build_env(
            sim_name=sim, env_name=env_config_registry.native_config(env_name),
            robot_name=robot_registry.native_config(robot_name),
            controller_name=controller_registry.native_controller(controller_name),
            randomize={**controller_registry.gain_randomization(controller_name), **(randomize or {})},
            num_envs=default_envs if num_envs is None else num_envs, device=device,
            seed=torch.initial_seed() % 2**31 if seed is None else seed,
        )  # fmt: skip
        self._manager = EnvManager(
            env, cfg=_class_with_num_envs(env_class, env.num_envs),
            sim_config=sim_config_registry.config_class(sim_name), robot_config=robot_class,
            reset_on_collision=reset_on_collision,
        )  # fmt: skip
        return self._manager

    def delete_env(self) -> None:
        """Release the device memory of the last environment."""
        if self._manager is not None:
            self._manager.delete_env()
            self._manager = None


def _class_with_num_envs(env_class: Any, num_envs: int) -> Any:
    """Return a subclass with the built number of environments, which scripts read from the class."""
    cfg = copy_class(env_class)
    if hasattr(cfg, "env"):
        cfg.env.num_envs = num_envs
    return cfg
