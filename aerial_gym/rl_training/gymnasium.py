"""A task as a ``gymnasium.vector.VectorEnv`` whose rows are reset in the step in which their episodes end.

``info`` is that of Gymnasium 0.29: ``final_observation`` and ``final_info`` in the rows that ended, and the masks
``_final_observation`` and ``_final_info``; Gymnasium 1 calls the former ``final_obs``.
Letters: E environments, O entries of an observation, U entries of an action.
"""

from typing import Any, Literal

import gymnasium
import numpy as np
import torch
from gymnasium import spaces
from gymnasium.vector.utils import batch_space
from numpy.typing import NDArray
from torch import Tensor

from aerial_gym.errors import ConfigError, ShapeError
from aerial_gym.task import Task

FINAL = "final_observation" if gymnasium.__version__.startswith("0.") else "final_obs"
"""Key of the last observations of episodes that ended."""

Array = Tensor | NDArray[Any]  # A torch tensor or a NumPy array


class GymnasiumVectorEnv(gymnasium.vector.VectorEnv):
    """E environments of one task; observations are its (E, O) tensor, or NumPy arrays."""

    def __init__(self, task: Task, *, output: Literal["numpy", "torch"] = "numpy") -> None:
        """Take a built task; actions may be tensors or arrays, for either output.

        Raises:
            ConfigError: If ``output`` is neither ``numpy`` nor ``torch``.
        """
        if output not in ("numpy", "torch"):
            raise ConfigError(f"GymnasiumVectorEnv.output = {output!r}: must be numpy or torch")
        self.task, self._torch_out = task, output == "torch"
        dictionary = task.observation_space
        assert isinstance(dictionary, spaces.Dict)
        # Set here and not by the base class: its constructor differs between Gymnasium 0.29 and 1.
        self.num_envs, self.is_vector_env, self.closed = task.num_envs, True, False
        self.viewer = self.spec = self.render_mode = None
        self.single_observation_space, self.single_action_space = dictionary["observations"], task.action_space
        self.observation_space = batch_space(self.single_observation_space, self.num_envs)
        self.action_space = batch_space(self.single_action_space, self.num_envs)
        if FINAL == "final_obs":
            self.metadata = {"autoreset_mode": gymnasium.vector.AutoresetMode.SAME_STEP}  # pyright: ignore[reportAttributeAccessIssue]

    def reset(  # pyright: ignore[reportIncompatibleMethodOverride]
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Array, dict[str, Any]]:
        """Restart every episode, with a new seed if given; return observations (E, O) and an empty info."""
        observation, _ = self.task.reset(seed=seed)
        return self._output_array(observation["observations"]), {}

    def step(  # pyright: ignore[reportIncompatibleMethodOverride]
        self, actions: Array
    ) -> tuple[Array, Array, Array, Array, dict[str, Any]]:
        """Advance by actions (E, U); return observations, rewards (E,), terminated, truncated (E,) bool, info."""
        observation, reward, terminated, truncated, info = self.task.step(self._action_tensor(actions))
        done = terminated | truncated
        told = self._torch_info(info, done) if self._torch_out else self._numpy_info(info, done)
        values = (observation["observations"], reward, terminated, truncated)
        first, second, third, fourth = (self._output_array(value) for value in values)
        return first, second, third, fourth, told

    def _action_tensor(self, actions: Array) -> Tensor:
        given = torch.as_tensor(actions, dtype=torch.float32, device=self.task.device)
        expected = self.action_space.shape
        if tuple(given.shape) != expected:
            raise ShapeError(f"actions has shape {tuple(given.shape)}, expected (E, U) = {expected}")
        return given

    def _output_array(self, value: Tensor) -> Array:
        return value if self._torch_out else value.cpu().numpy()

    def _torch_info(self, info: dict[str, Tensor], done: Tensor) -> dict[str, Any]:
        """Return tensors over all rows, valid only within the masks. Nothing is copied to the host."""
        episode = {"r": info["episode_return"], "l": info["episode_length"]}
        return {
            FINAL: info["final_observation"], f"_{FINAL}": done, "final_info": {"episode": episode},
            "_final_info": done, "time_outs": info["time_outs"],
        }  # fmt: skip

    def _numpy_info(self, info: dict[str, Tensor], done: Tensor) -> dict[str, Any]:
        """Return Gymnasium's object arrays: None in the rows of unfinished episodes."""
        told: dict[str, Any] = {
            "time_outs": info["time_outs"].cpu().numpy(),
            "_time_outs": np.ones(self.num_envs, bool),
        }
        mask = done.cpu().numpy()
        if not mask.any():
            return told
        last = info["final_observation"].cpu().numpy()
        total, length = info["episode_return"].cpu().numpy(), info["episode_length"].cpu().numpy()
        observations, infos = np.full(self.num_envs, None), np.full(self.num_envs, None)
        for row in np.flatnonzero(mask):
            observations[row] = last[row]
            infos[row] = {"episode": {"r": float(total[row]), "l": int(length[row])}}
        told |= {FINAL: observations, f"_{FINAL}": mask, "final_info": infos, "_final_info": mask.copy()}
        return told

    def close_extras(self, **kwargs: object) -> None:
        """Release the simulation; called by ``close``."""
        self.task.close()
