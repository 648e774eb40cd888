"""A task: a simulation seen as a vectorised Gymnasium environment whose rows are reset where their episodes end.

Letters: E environments, U entries of an action, O entries of an observation.
"""

from types import TracebackType

import numpy as np
import torch
from gymnasium import spaces
from torch import Tensor

from aerial_gym.config.task import TaskCfg
from aerial_gym.env_manager import EnvManager
from aerial_gym.errors import ConfigError, UnknownNameError
from aerial_gym.task.observations import OBSERVATIONS, ObservationTerm, TaskState
from aerial_gym.task.rewards import REWARDS

Observation = dict[str, Tensor]
"""``observations``: (E, O) float32."""


class Task:
    """Observation, reward and termination around an ``EnvManager``.

    ``step`` returns the observation *after* the masked reset; the last one of a finished episode stands in
    ``info["final_observation"]``, in the rows where ``terminated | truncated``. ``info["time_outs"]`` marks episodes that
    ended by their length alone, for bootstrapping the value. ``episode_return``, ``episode_length`` [steps] and ``distance``
    to the target [m] are those before the reset.
    """

    def __init__(self, cfg: TaskCfg, env: EnvManager) -> None:
        """Take the configuration and a built simulation."""
        self.cfg, self.env = cfg, env
        self.num_envs, self.device = env.num_envs, env.device
        self._terms = _resolve_terms(cfg)
        self._reward, self._params = _resolve_reward(cfg)
        num_actions = env.robot_manager.num_actions
        widths = [num_actions if term.width is None else term.width for term, _ in self._terms]
        bound = np.full(sum(widths), np.inf, dtype=np.float32)
        self.observation_space = spaces.Dict({"observations": spaces.Box(-bound, bound, dtype=np.float32)})
        one = np.ones(num_actions, dtype=np.float32)
        self.action_space = spaces.Box(-one, one, dtype=np.float32)
        self.target_position = torch.tensor(cfg.target, device=self.device).expand(self.num_envs, 3).clone()
        self.episode_return = torch.zeros(self.num_envs, device=self.device)
        self._gtd = env.gtd

    def reset(self, *, seed: int | None = None) -> tuple[Observation, dict[str, Tensor]]:
        """Start every environment anew, with the random numbers of ``seed`` if one is given; return observation and info."""
        if seed is not None:
            self.env.generator.manual_seed(seed)
        self.env.reset()
        self.episode_return.zero_()
        self.env.render()
        return self._observe(), {}

    def stagger(self) -> None:
        """Give every environment a random age, so that episodes end one by one: a batch then holds all their phases."""
        steps, age = self.cfg.episode_len_steps, self._gtd["sim_steps"]
        age.copy_(torch.randint(steps, age.shape, device=self.device, generator=self.env.generator))

    def step(self, actions: Tensor) -> tuple[Observation, Tensor, Tensor, Tensor, dict[str, Tensor]]:
        """Advance by one action, (E, U); return observation, reward (E,), terminated, truncated (E,) bool, info."""
        self.env.step(actions)
        state = self.state()
        final = self._observe(state)["observations"]
        distance = (state.target - state.position).norm(dim=-1)
        terminated = state.crashed | (distance > self.cfg.max_distance)
        truncated = (self._gtd["sim_steps"] >= self.cfg.episode_len_steps) & ~terminated
        reward = self._reward(state, self._params, terminated)
        self.episode_return += reward
        info = {
            "final_observation": final,
            "time_outs": truncated,
            "episode_return": self.episode_return.clone(),
            "episode_length": self._gtd["sim_steps"].clone(),
            "distance": distance,
        }
        done = terminated | truncated
        self._gtd["crashes"].copy_(terminated)
        self._gtd["truncations"].copy_(truncated)
        self.episode_return.masked_fill_(done, 0.0)
        self.env.post_reward_calculation_step()
        return self._observe(), reward, terminated, truncated, info

    def state(self) -> TaskState:
        """Return the states of this instant."""
        gtd = self._gtd
        return TaskState(
            target=self.target_position,
            position=gtd["robot_position"],
            attitude=gtd["robot_orientation"],
            lin_vel=gtd["robot_linvel"],
            lin_vel_body=gtd["robot_body_linvel"],
            ang_vel_body=gtd["robot_body_angvel"],
            actions=gtd["robot_actions"],
            prev_actions=gtd["robot_prev_actions"],
            crashed=gtd["crashes"],
        )

    def _observe(self, state: TaskState | None = None) -> Observation:
        state = state or self.state()
        parts = []
        for term, noise_std in self._terms:
            value = term.value(state)
            if noise_std > 0.0:
                noise = torch.randn(value.shape, device=self.device, generator=self.env.generator)
                value = value + noise_std * noise
            parts.append(value)
        return {"observations": torch.cat(parts, dim=-1)}

    def close(self) -> None:
        """Release the simulation."""
        self.env.close()

    def __enter__(self) -> "Task":
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()


def _resolve_terms(cfg: TaskCfg) -> list[tuple[ObservationTerm, float]]:
    for entry in cfg.observations:
        if entry.term not in OBSERVATIONS:
            raise UnknownNameError(f"no observation term {entry.term!r}. Known: {', '.join(sorted(OBSERVATIONS))}")
    return [(OBSERVATIONS[entry.term], entry.noise_std) for entry in cfg.observations]


def _resolve_reward(cfg: TaskCfg):
    if cfg.reward not in REWARDS:
        raise UnknownNameError(f"no reward {cfg.reward!r}. Known: {', '.join(sorted(REWARDS))}")
    reward, names = REWARDS[cfg.reward]
    if set(cfg.reward_params) != set(names):
        raise ConfigError(f"reward {cfg.reward}: coefficients {sorted(cfg.reward_params)} given, needs {sorted(names)}")
    return reward, dict(cfg.reward_params)
