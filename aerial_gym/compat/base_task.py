"""The base class of tasks that scripts write themselves."""

import random
from typing import Any

import gymnasium
import numpy as np
import torch


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
