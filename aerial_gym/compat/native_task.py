"""Tasks of this package with the interface of the Aerial Gym Simulator's. Letters: E environments, U entries of an action."""

import random
from collections.abc import Sequence
from functools import cache
from typing import Any

import gymnasium
import numpy as np
import torch
from torch import Tensor

from aerial_gym.compat.config.fields import copy_class
from aerial_gym.compat.config.tasks import TABLE, translate_task
from aerial_gym.compat.sim_builder import SimBuilder
from aerial_gym.errors import CapabilityError, ConfigError
from aerial_gym.task import Task, task_registry


class BaseTask(gymnasium.Env):
    """Base of a script's task class, which builds its simulation in its own constructor.

    ``reset`` and ``step`` return observations, rewards, terminations, truncations, infos. It is a Gymnasium environment by its
    class only, so that wrappers of scripts take it.
    """

    def __init__(self, task_config: Any) -> None:
        """Keep the configuration, and seed Python's, NumPy's and torch's generators if it has a seed of at least 0."""
        self.task_config = task_config
        seed = getattr(task_config, "seed", None)
        if seed is not None and seed >= 0:
            self.seed(seed)

    def seed(self, seed: int) -> None:
        """Seed Python's, NumPy's and torch's own generators."""
        random.seed(seed)
        np.random.seed(seed % 2**32)
        torch.manual_seed(seed)

    def render(self, mode: str = "human") -> Any:
        """Show the environments; subclasses must define it."""
        raise NotImplementedError(f"{type(self).__name__}.render: the task class must define it")

    def reset(self) -> Any:
        """Reset every environment; subclasses must define it."""
        raise NotImplementedError(f"{type(self).__name__}.reset: the task class must define it")

    def reset_idx(self, env_ids: Any) -> Any:
        """Reset some environments; subclasses must define it."""
        raise NotImplementedError(f"{type(self).__name__}.reset_idx: the task class must define it")

    def step(self, actions: Any) -> Any:
        """Advance by one action; subclasses must define it."""
        raise NotImplementedError(f"{type(self).__name__}.step: the task class must define it")

    def close(self) -> None:
        """Release the device memory of ``sim_env``, if there is one."""
        env = getattr(self, "sim_env", None)
        if env is not None:
            env.delete_env()


FiveTuple = tuple[dict[str, Tensor], Tensor, Tensor, Tensor, dict[str, Tensor]]
"""Observations, rewards, terminations, truncations, infos."""

HOOKS = (
    "compute_rewards_and_crashes", "process_obs_for_task", "process_image_observation", "get_return_tuple",
    "check_and_update_curriculum_level",
)  # fmt: skip
"""Hooks of that simulator's task classes for rewards and observations, which this task never calls."""


class NativeTask(gymnasium.Env):
    """A task of ours: ``reset`` and ``step`` return five things, observations hold rewards and flags too.

    ``infos`` is ours: ``final_observation``, ``time_outs`` and more, which there are missing.
    """

    task_name = ""  # Name in ``aerial_gym.task_registry``

    def __init_subclass__(cls, **more: Any) -> None:
        """Refuse a class with hooks that this task never calls."""
        super().__init_subclass__(**more)
        unused_hooks = [name for name in HOOKS if name in vars(cls)]
        if unused_hooks:
            raise ConfigError(
                f"class {cls.__name__}: {unused_hooks[0]} would not be called: rewards and observations of "
                f"{cls.task_name or 'a task'} are terms of a task file. Derive the class from BaseTask to write them yourself"
            )

    def __init__(
        self, task_config: Any, seed: int | None = None, num_envs: int | None = None, headless: bool | None = None,
        device: str | torch.device | None = None, use_warp: bool | None = None,
    ) -> None:  # fmt: skip
        """Build the simulation that a configuration class names, and the task in it; arguments go before the class.

        ``task_config`` is then a subclass of the given one, with the given arguments.

        Raises:
            ConfigError: If the class has a field that is unknown, or a number is impossible.
        """
        self.task_config = copy_class(task_config)
        overrides = {"seed": seed, "num_envs": num_envs, "headless": headless, "device": device, "use_warp": use_warp}
        for name, value in overrides.items():
            if value is not None:
                setattr(self.task_config, name, value)
        cfg, given = translate_task(self.task_config, self.task_name), TABLE.values(self.task_config)
        self.sim_env = SimBuilder().build_env(
            cfg.sim, str(cfg.env), cfg.robot, cfg.controller, given.get("device", "auto"),
            num_envs=cfg.num_envs, seed=int(given.get("seed", 0)), randomize=cfg.randomize,
        )  # fmt: skip
        self.task = Task(cfg, self.sim_env.env)
        self._pre_reset = bool(given.get("return_state_before_reset", False))
        self.num_envs, self.device = self.task.num_envs, self.task.device
        self.observation_space, self.action_space = self.task.observation_space, self.task.action_space

    def reset(self, *, seed: int | None = None, options: object = None) -> FiveTuple:
        """Reset every environment, with all random numbers from a seed if given; rewards and flags are zero."""
        del options  # Gymnasium's wrappers pass it
        obs, info = self.task.reset(seed=seed)
        zero = torch.zeros(self.num_envs, device=self.device)
        return self._five_tuple(obs, zero, zero.bool(), zero.bool(), info)

    def step(self, actions: Tensor) -> FiveTuple:
        """Advance by one action, (E, U); finished environments are reset, and their observation is the new one."""
        obs, reward, terminated, truncated, info = self.task.step(actions)
        if self._pre_reset:
            obs = {"observations": info["final_observation"]}
        return self._five_tuple(obs, reward, terminated, truncated, info)

    def reset_idx(self, env_ids: Tensor | Sequence[int]) -> None:
        """Refuse: finished environments are reset by ``step``, all of them by ``reset``."""
        raise CapabilityError(
            f"{self.task_name}.reset_idx({env_ids!r}): step() resets the environments that are done, reset() all of them"
        )

    def render(self) -> None:
        """Show nothing; images are in ``sim_env.global_tensor_dict`` after every step."""

    def close(self) -> None:
        """Release device memory."""
        self.sim_env.delete_env()

    def _five_tuple(
        self, obs: dict[str, Tensor], reward: Tensor, terminated: Tensor, truncated: Tensor, info: dict[str, Tensor]
    ) -> FiveTuple:
        more = {
            "priviliged_obs": torch.zeros(self.num_envs, 0, device=self.device),
            "collisions": terminated.unsqueeze(-1).float(), "rewards": reward, "terminations": terminated,
            "truncations": truncated,
        }  # fmt: skip
        return obs | more, reward, terminated, truncated, info


@cache
def task_class(name: str) -> type[NativeTask]:
    """Return the class of a registered task; the same one at every call."""
    task_registry.get(name)
    camel = "".join(part.capitalize() for part in name.split("_"))
    return type(camel, (NativeTask,), {"task_name": name, "__doc__": f"The task ``{name}``."})


PositionSetpointTask = task_class("position_setpoint_task")
NavigationTask = task_class("navigation_task")
