"""A task: a simulation seen as a vectorised Gymnasium environment whose rows are reset where their episodes end.

Letters: E environments, U entries of an action, O entries of an observation.
"""

from functools import partial
from types import TracebackType

import numpy as np
import torch
from gymnasium import spaces
from torch import Tensor

from aerial_gym.config.task import TaskCfg
from aerial_gym.env_manager import EnvManager
from aerial_gym.errors import CapabilityError, ConfigError, UnknownNameError
from aerial_gym.task.observations import OBSERVATIONS, ObservationTerm, TaskState
from aerial_gym.task.rewards import REWARDS
from aerial_gym.task.step_graph import StepGraph, check_terms, fuse

Observation = dict[str, Tensor]
"""``observations``: (E, O) float32."""


StepResult = tuple[Observation, Tensor, Tensor, Tensor, dict[str, Tensor]]
"""Observation, reward, terminated, truncated, info."""


class Task:
    """Observation, reward and termination around an ``EnvManager``.

    ``step`` returns the observation *after* the masked reset; the last one of a finished episode stands in
    ``info["final_observation"]``, in the rows where ``terminated | truncated``. ``info["time_outs"]`` marks episodes that
    ended by their length alone, for bootstrapping the value. ``episode_return``, ``episode_length`` [steps] and ``distance``
    to the target [m] are those before the reset.

    On a GPU the whole step is one CUDA graph, recorded at the first ``reset``: the tensors that ``step`` returns are then
    overwritten by the next one; clone what must stay. ``captured`` says whether it is so.
    """

    def __init__(self, cfg: TaskCfg, env: EnvManager, *, capture: bool | None = None) -> None:
        """Take the configuration and a built simulation.

        Args:
            cfg: Terms, reward, target, length of an episode.
            env: The simulation.
            capture: Whether to hold the step in a CUDA graph; if not given, on CUDA devices.

        Raises:
            CapabilityError: If a capture is asked for on the CPU.
        """
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
        stds = [std for (_, std), width in zip(self._terms, widths, strict=True) for _ in range(width)]
        self._noise_std = torch.tensor(stds, device=self.device)
        self._gtd = env.gtd
        self._observe, self._judge = self._observation, self._judgement
        self._graph: StepGraph[StepResult] | None = None
        if capture and self.device.type != "cuda":
            raise CapabilityError(f"capture needs a CUDA device; this task runs on {self.device}")
        self._capture_at_reset = self.device.type == "cuda" if capture is None else capture

    @property
    def captured(self) -> bool:
        """Whether a step is the replay of a CUDA graph."""
        return self._graph is not None

    def capture(self) -> None:
        """Record the whole step as one CUDA graph; call ``reset`` before the next step.

        Raises:
            CapabilityError: If a term waits for the GPU (its name is in the message), or there is no GPU.
        """
        if self.device.type != "cuda":
            raise CapabilityError(f"capture needs a CUDA device; this task runs on {self.device}")
        self._capture_at_reset = False
        self.env.reset()
        state = self.state()
        terms = {
            f"observation term {e.term!r}": partial(OBSERVATIONS[e.term].value, state) for e in self.cfg.observations
        }
        check_terms(terms | {f"reward {self.cfg.reward!r}": partial(self._reward, state, self._params, state.crashed)})
        self._observe, self._judge = fuse(self._observation), fuse(self._judgement)
        shape = (self.num_envs, self.env.robot_manager.num_actions)
        self._graph = StepGraph(self._step, shape, self.env.generator)
        self.env.restart(self.env.seed)

    def reset(self, *, seed: int | None = None) -> tuple[Observation, dict[str, Tensor]]:
        """Start every environment anew, with the random numbers of ``seed`` if one is given; return observation and info."""
        if self._capture_at_reset:
            self.capture()
        if seed is not None:
            self.env.restart(seed)
        self.env.reset()
        self.episode_return.zero_()
        self.env.render()
        return {"observations": self._noisy(self._observe(*vars(self.state()).values()))}, {}

    def stagger(self) -> None:
        """Give every environment a random age, so that episodes end one by one: a batch then holds all their phases."""
        steps, age = self.cfg.episode_len_steps, self._gtd["sim_steps"]
        age.copy_(torch.randint(steps, age.shape, device=self.device, generator=self.env.generator))

    def step(self, actions: Tensor) -> StepResult:
        """Advance by one action, (E, U); return observation, reward (E,), terminated, truncated (E,) bool, info."""
        return self._step(actions) if self._graph is None else self._graph.replay(actions)

    def _step(self, actions: Tensor) -> StepResult:
        gtd = self._gtd
        self.env.step(actions)
        final, reward, terminated, truncated, distance, total = self._judge(
            gtd["sim_steps"], self.episode_return, *vars(self.state()).values()
        )
        info = {
            "final_observation": self._noisy(final),
            "time_outs": truncated,
            "episode_return": total,
            "episode_length": gtd["sim_steps"].clone(),
            "distance": distance,
        }
        gtd["crashes"].copy_(terminated)
        gtd["truncations"].copy_(truncated)
        self.episode_return.copy_(total).masked_fill_(terminated | truncated, 0.0)
        self.env.post_reward_calculation_step()
        after = self._noisy(self._observe(*vars(self.state()).values()))
        return {"observations": after}, reward, terminated, truncated, info

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

    def _observation(self, *state: Tensor) -> Tensor:
        """Return the terms side by side, (E, O), without their noise."""
        at = TaskState.of(state)
        return torch.cat([term.value(at) for term, _ in self._terms], dim=-1)

    def _judgement(self, steps: Tensor, episode_return: Tensor, *state: Tensor) -> tuple[Tensor, ...]:
        """Return last observation, reward, terminated, truncated, distance [m] and return of the episode."""
        at = TaskState.of(state)
        distance = (at.target - at.position).norm(dim=-1)
        terminated = at.crashed | (distance > self.cfg.max_distance)
        truncated = (steps >= self.cfg.episode_len_steps) & ~terminated
        reward = self._reward(at, self._params, terminated)
        return self._observation(*state), reward, terminated, truncated, distance, episode_return + reward

    def _noisy(self, observation: Tensor) -> Tensor:
        if all(std == 0.0 for _, std in self._terms):
            return observation
        noise = torch.randn(observation.shape, device=self.device, generator=self.env.generator)
        return observation + self._noise_std * noise

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
