"""A task as rsl_rl (the package rsl-rl-lib) sees environments; its tensors stay on the device.

Letters: E environments, U entries of an action.
"""

from typing import Any

import torch
from torch import Tensor

from aerial_gym.extras import optional_import
from aerial_gym.task import Task

with optional_import("this adapter"):
    from rsl_rl.env import VecEnv  # pyright: ignore[reportMissingImports]
    from tensordict import TensorDict  # pyright: ignore[reportMissingImports]


class RslRlEnv(VecEnv):
    """E environments that are reset in the step in which their episodes end, at random ages first.

    ``extras["time_outs"]`` says which were truncated: rsl_rl adds the discounted value of the observation before that step.
    The keys of an observation are groups of ``obs_groups``: ``{"actor": ["observations"], "critic": ["critic"]}``.
    """

    def __init__(self, task: Task) -> None:
        self._task, self.device, self.cfg = task, task.device, {"task": str(task.cfg)}
        self.num_envs, self.num_actions = task.num_envs, task.num_actions
        self.max_episode_length = task.cfg.episode_len_steps
        observation, _ = task.reset()
        task.stagger()
        self._seen = self._clone_observation(observation)

    @property
    def episode_length_buf(self) -> Tensor:
        """Age of the episodes [steps], int64 (E,)."""
        return self._task.env.rows.bodies["sim_steps"].long()

    @episode_length_buf.setter
    def episode_length_buf(self, age: Tensor) -> None:
        self._task.set_ages(age)

    def get_observations(self) -> TensorDict:
        """Return the present observations by key."""
        return self._seen

    def step(self, actions: Tensor) -> tuple[TensorDict, Tensor, Tensor, dict[str, Any]]:
        """Advance by actions (E, U); return observations, rewards (E,), whether episodes ended (E,), and extras."""
        observation, reward, terminated, truncated, info = self._task.step(actions)
        self._seen = self._clone_observation(observation)
        return self._seen, reward.clone(), terminated | truncated, {"time_outs": info["time_outs"].clone()}

    def _clone_observation(self, observation: dict[str, Tensor]) -> TensorDict:
        """Return copies, as the next step on a GPU rewrites the tensors that rsl_rl keeps."""
        kept = {key: value.clone() for key, value in observation.items()}
        return TensorDict(kept, batch_size=torch.Size([self.num_envs]), device=self.device)
