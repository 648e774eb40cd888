"""A task as skrl sees an environment; its tensors stay on the device.

Letters: E environments, O entries of an observation, S of a critic's observation, U of an action.
"""

from typing import Any

from gymnasium import spaces
from torch import Tensor

from aerial_gym.extras import optional_import
from aerial_gym.task import Task

with optional_import("this adapter"):
    from skrl.envs.wrappers.torch import Wrapper  # pyright: ignore[reportMissingImports]


class SkrlEnv(Wrapper):
    """E environments that are reset in the step in which their episodes end, at random ages first.

    skrl bootstraps an episode that was truncated (``time_limit_bootstrap=True``) with the value of the observation that it
    is given next: that of the start of the next episode. ``info["final_observation"]`` holds the last one.
    """

    def __init__(self, task: Task, *, state: str | None = None) -> None:
        super().__init__(task)
        self._task, self._state_key, self._state = task, state, None
        self._info: dict[str, Any] = {}

    @property
    def observation_space(self) -> spaces.Space:
        """Of one environment."""
        return self._task.observation_space["observations"]

    @property
    def state_space(self) -> spaces.Space | None:
        """Critic's space of one environment; None if equal to the policy's."""
        return None if self._state_key is None else self._task.observation_space[self._state_key]

    @property
    def action_space(self) -> spaces.Space:
        """Of one environment."""
        return self._task.action_space

    def reset(self) -> tuple[Tensor, dict[str, Any]]:
        """Restart all episodes; return observations (E, O) and info."""
        observation, info = self._task.reset()
        self._task.stagger()
        return self._clone_observation(observation), dict(info)

    def step(self, actions: Tensor) -> tuple[Tensor, Tensor, Tensor, Tensor, dict[str, Any]]:
        """Advance by actions (E, U); return observations (E, O), rewards, terminated and truncated (E, 1), info."""
        observation, reward, terminated, truncated, info = self._task.step(actions.detach())
        numbers = (value.view(-1, 1).clone() for value in (reward, terminated, truncated))
        reward, terminated, truncated = numbers
        return self._clone_observation(observation), reward, terminated, truncated, info

    def _clone_observation(self, observation: dict[str, Tensor]) -> Tensor:
        """Return copies, as the next step on a GPU rewrites the tensors that skrl keeps."""
        self._state = None if self._state_key is None else observation[self._state_key].clone()
        return observation["observations"].clone()

    def state(self) -> Tensor | None:
        """Return the critic's observation, (E, S)."""
        return self._state

    def render(self, *args: object, **kwargs: object) -> None:
        """Show nothing."""

    def close(self) -> None:
        """Release the simulation."""
        self._task.close()
