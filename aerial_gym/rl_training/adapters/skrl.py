"""A task as skrl sees an environment, of one agent or of several; its tensors stay on the device.

Letters: E environments, O entries of an observation, S of a critic's observation, U of an action.
"""

from typing import Any

import torch
from gymnasium import spaces
from torch import Tensor

from aerial_gym.errors import ConfigError
from aerial_gym.extras import optional_import
from aerial_gym.task import Task

with optional_import("this adapter"):
    from skrl.envs.wrappers.torch import MultiAgentEnvWrapper, Wrapper  # pyright: ignore[reportMissingImports]


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


class SkrlVehiclesEnv(MultiAgentEnvWrapper):
    """E environments with an agent for each vehicle, ``vehicle_0`` and so on, for skrl's IPPO and MAPPO.

    Resets and truncated episodes are as those of ``SkrlEnv``. skrl's agents are of environments whose vehicles end together.
    """

    def __init__(self, task: Task, *, state: str = "observations") -> None:
        """Take the task, and the key of the observations that the critic of each agent sees."""
        if not task.env.cfg.reset_together and task.num_vehicles > 1:
            raise ConfigError(
                "SkrlVehiclesEnv: skrl needs agents that end together. Give the environment reset_together: true"
            )
        super().__init__(task)
        self._task, self._key = task, state
        names = [f"vehicle_{number}" for number in range(task.num_vehicles)]
        self._names, self._state = names, dict[str, Tensor]()
        self._spaces = {key: dict.fromkeys(names, task.observation_space[key]) for key in ("observations", state)}

    @property
    def num_envs(self) -> int:
        """Number of environments."""
        return self._task.env.num_envs

    @property
    def possible_agents(self) -> list[str]:
        """Names of all agents."""
        return self._names

    agents = possible_agents

    @property
    def observation_spaces(self) -> dict[str, spaces.Space]:
        """Of one environment, by agent."""
        return self._spaces["observations"]

    @property
    def state_spaces(self) -> dict[str, spaces.Space]:
        """Critic's spaces of one environment, by agent."""
        return self._spaces[self._key]

    @property
    def action_spaces(self) -> dict[str, spaces.Space]:
        """Of one environment, by agent."""
        return dict.fromkeys(self._names, self._task.action_space)

    def _by_agent(self, rows: Tensor) -> dict[str, Tensor]:
        """Return copies of rows by agent, (E, ...)."""
        columns = rows.unflatten(0, (-1, len(self._names))).unbind(1)
        return {name: column.clone() for name, column in zip(self._names, columns, strict=True)}

    def _observe(self, observation: dict[str, Tensor]) -> dict[str, Tensor]:
        self._state = self._by_agent(observation[self._key])
        return self._by_agent(observation["observations"])

    def reset(self) -> tuple[dict[str, Tensor], dict[str, Any]]:
        """Restart all episodes; return observations (E, O) by agent, and info."""
        observation, info = self._task.reset()
        self._task.stagger()
        return self._observe(observation), dict(info)

    def step(self, actions: dict[str, Tensor]) -> tuple[
        dict[str, Tensor], dict[str, Tensor], dict[str, Tensor], dict[str, Tensor], dict[str, Any]
    ]:  # fmt: skip
        """Advance by actions (E, U) by agent; return observations, rewards, terminated and truncated (E, 1) by agent, info."""
        given = torch.stack([actions[name].detach() for name in self._names], dim=1).flatten(0, 1)
        observation, *numbers, info = self._task.step(given)
        reward, terminated, truncated = (self._by_agent(value.unsqueeze(-1)) for value in numbers)
        return self._observe(observation), reward, terminated, truncated, info

    def state(self) -> dict[str, Tensor | None]:
        """Return the critic's observations (E, S) by agent."""
        return dict(self._state)

    def render(self, *args: object, **kwargs: object) -> None:
        """Show nothing."""

    def close(self) -> None:
        """Release the simulation."""
        self._task.close()
