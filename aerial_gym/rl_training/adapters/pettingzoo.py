"""A task of several vehicles as PettingZoo's parallel environment: one agent for each vehicle, ``vehicle_0`` and so on.

Letters: O entries of an observation, S of a state, U of an action.
"""

from typing import Any, ClassVar, TypeVar

import numpy as np
import torch
from gymnasium import spaces
from numpy.typing import NDArray

from aerial_gym.errors import ConfigError
from aerial_gym.extras import optional_import
from aerial_gym.task import Task

with optional_import("this adapter"):
    from pettingzoo import ParallelEnv  # pyright: ignore[reportMissingImports]

Numbers = NDArray[np.float32]
Value = TypeVar("Value")


class VehiclesParallelEnv(ParallelEnv):  # pyright: ignore[reportGeneralTypeIssues]
    """One environment of a task. An agent leaves where its episode ends; ``reset`` brings all back.

    In an environment without ``reset_together``, the vehicle of an agent that left begins again and gets zero actions.
    """

    metadata: ClassVar[dict[str, Any]] = {"name": "aerial_gym", "render_modes": [], "is_parallelizable": True}

    def __init__(self, task: Task, *, state: str = "observations") -> None:
        """Take a task with one environment; ``state`` is the key of the observations that make up ``state()``."""
        if task.env.num_envs != 1:
            raise ConfigError(f"VehiclesParallelEnv: num_envs = {task.env.num_envs}: must be 1. Use the task for more")
        self.task, self._state_key, self.render_mode = task, state, None
        self.possible_agents = [f"vehicle_{number}" for number in range(task.num_vehicles)]
        self.agents: list[str] = []
        seen, (width,) = task.observation_space["observations"], task.observation_shapes[state]
        self.observation_spaces = dict.fromkeys(self.possible_agents, seen)
        self.action_spaces = {
            name: spaces.Box(-1.0, 1.0, shape=(task.num_actions,), dtype=np.float32) for name in self.possible_agents
        }
        self.state_space = spaces.Box(-np.inf, np.inf, shape=(task.num_vehicles * width,), dtype=np.float32)
        self._state = np.zeros(self.state_space.shape, dtype=np.float32)

    def observation_space(self, agent: str) -> spaces.Space:
        """Return the space of an agent's observations (O,)."""
        return self.observation_spaces[agent]

    def action_space(self, agent: str) -> spaces.Space:
        """Return the space of an agent's actions (U,), each entry -1 to 1."""
        return self.action_spaces[agent]

    def reset(
        self, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[dict[str, Numbers], dict[str, dict[str, Any]]]:
        """Begin an episode of all agents, with a new seed if given; return observations and empty infos by agent."""
        del options
        observation, _ = self.task.reset(seed=seed)
        self.agents = list(self.possible_agents)
        self._state = _numbers(observation[self._state_key]).ravel()
        return dict(zip(self.agents, _numbers(observation["observations"]), strict=True)), {
            name: {} for name in self.agents
        }

    def step(self, actions: dict[str, Numbers]) -> tuple[
        dict[str, Numbers], dict[str, float], dict[str, bool], dict[str, bool], dict[str, dict[str, Any]]
    ]:  # fmt: skip
        """Advance by actions (U,) of all agents; return observation, reward, terminated, truncated and info by agent."""
        rest = np.zeros(self.task.num_actions, dtype=np.float32)
        given = torch.from_numpy(np.stack([actions.get(name, rest) for name in self.possible_agents]))
        observation, reward, terminated, truncated, info = self.task.step(given.to(self.task.device))
        ended = (terminated | truncated).unsqueeze(-1)
        seen = _numbers(torch.where(ended, info["final_observation"], observation["observations"]))
        self._state = _numbers(observation[self._state_key]).ravel()
        flags = {key: value.tolist() for key, value in info.items() if value.dtype == torch.bool}
        infos = [{key: values[row] for key, values in flags.items()} for row in range(len(seen))]
        terminations, truncations = self._by_agent(terminated.tolist()), self._by_agent(truncated.tolist())
        result = self._by_agent(list(seen)), self._by_agent(reward.tolist()), terminations, truncations
        told = self._by_agent(infos)
        self.agents = [name for name in self.agents if not (terminations[name] or truncations[name])]
        return *result, told

    def _by_agent(self, values: list[Value]) -> dict[str, Value]:
        """Return values of all vehicles by agent, of those whose episodes go on."""
        return {name: value for name, value in zip(self.possible_agents, values, strict=True) if name in self.agents}

    def state(self) -> Numbers:
        """Return the observations under the key of the state, of all vehicles side by side, (S,)."""
        return self._state

    def render(self) -> None:
        """Show nothing."""

    def close(self) -> None:
        """Release the simulation."""
        self.task.close()


def _numbers(values: torch.Tensor) -> Numbers:
    return values.detach().cpu().numpy().copy()
