"""A task as Stable-Baselines3 sees environments: NumPy arrays, which cost a copy to the host in every step.

Letters: E environments, O entries of an observation, U of an action.
"""

from collections.abc import Sequence
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from aerial_gym.extras import optional_import
from aerial_gym.task import Task

with optional_import("this adapter"):
    from stable_baselines3.common.vec_env import VecEnv  # pyright: ignore[reportMissingImports]


class Sb3Env(VecEnv):
    """E environments that are reset in the step in which their episodes end, at random ages first.

    Rows that ended have ``terminal_observation``, ``TimeLimit.truncated`` and ``episode`` in their info: Stable-Baselines3 adds
    the discounted value of the last observation where an episode was truncated, and logs returns and lengths.
    """

    def __init__(self, task: Task) -> None:
        self.task, self._actions = task, torch.zeros(task.num_envs, task.num_actions, device=task.device)
        self.render_mode = None
        super().__init__(task.num_envs, task.observation_space["observations"], task.action_space)

    def reset(self) -> NDArray[np.float32]:
        """Restart all episodes, with the seed of a preceding ``seed`` call; return observations (E, O)."""
        observation, _ = self.task.reset(seed=self._seeds[0])
        self.task.stagger()
        self._reset_seeds()
        return _host_copy(observation["observations"])

    def step_async(self, actions: NDArray[np.float32]) -> None:
        """Take the actions (E, U) of the next ``step_wait``."""
        self._actions = torch.as_tensor(actions, dtype=torch.float32, device=self.task.device)

    def step_wait(self) -> tuple[NDArray[Any], NDArray[Any], NDArray[Any], list[dict[str, Any]]]:
        """Advance; return observations (E, O), rewards (E,), whether episodes ended (E,), and an info for each row."""
        observation, reward, terminated, truncated, info = self.task.step(self._actions)
        ended, infos = _host_copy(terminated | truncated), [{} for _ in range(self.num_envs)]
        if ended.any():
            names = ("final_observation", "time_outs", "episode_return", "episode_length")
            last, late, total, length = (_host_copy(info[name]) for name in names)
            for row in np.flatnonzero(ended):
                infos[row] = {
                    "terminal_observation": last[row],
                    "TimeLimit.truncated": bool(late[row]),
                    "episode": {"r": float(total[row]), "l": int(length[row])},
                }
        return _host_copy(observation["observations"]), _host_copy(reward), ended, infos

    def close(self) -> None:
        """Release the simulation."""
        self.task.close()

    def get_attr(self, attr_name: str, indices: Any = None) -> list[Any]:
        """Return an attribute, which all environments have in common, once for each."""
        return [getattr(self, attr_name)] * len(self._environment_indices(indices))

    def set_attr(self, attr_name: str, value: Any, indices: Any = None) -> None:
        """Set an attribute of all environments."""
        setattr(self, attr_name, value)

    def env_method(self, method_name: str, *args: Any, indices: Any = None, **kwargs: Any) -> list[Any]:
        """Call a method once for all environments; return its result once per environment."""
        return [getattr(self, method_name)(*args, **kwargs)] * len(self._environment_indices(indices))

    def env_is_wrapped(self, wrapper_class: type, indices: Any = None) -> list[bool]:
        """Return False for each environment."""
        return [False] * len(self._environment_indices(indices))

    def _environment_indices(self, indices: int | Sequence[int] | None) -> list[int]:
        return list(self._get_indices(indices))


def _host_copy(tensor: Tensor) -> NDArray[Any]:
    """Return a copy: the next step writes into the same tensors."""
    return tensor.detach().cpu().numpy().copy()
