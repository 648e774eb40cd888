"""Base of the learners: networks, the simulation's current observation, and sums for the host.

Letters: T steps of a segment, E environments.
"""

from collections.abc import Iterable, Mapping
from typing import ClassVar

import torch
from torch import Tensor

from aerial_gym.registry.state import add_prefix
from aerial_gym.rl_training.policies.actor_critic import ActorCritic
from aerial_gym.rl_training.ranks import ALONE, Ranks
from aerial_gym.rl_training.settings import TrainingCfg
from aerial_gym.task import Task

SUMS: tuple[str, ...] = ("env_steps", "episodes", "episode_return", "episode_length")
"""Steps, and number, returns and lengths of the episodes that ended, since the start of the training."""


class Learner:
    """Base of the learners. ``iterate`` never waits and works on fixed tensors."""

    GAUGES: ClassVar[tuple[str, ...]]  # Names of the numbers of the last update

    captures = True  # Whether `iterate` is held in a CUDA graph on a GPU

    def __init__(self, cfg: TrainingCfg, task: Task, network: ActorCritic, ranks: Ranks = ALONE) -> None:
        """Take settings, a task without a graph of its own, a network on its device, and the processes of the training."""
        self._cfg, self._task, self.network, self.ranks = cfg, task, network, ranks
        device = task.device
        self.generator = torch.Generator(device).manual_seed(cfg.seed + ranks.rank)
        """Of exploration and of the order of samples, in each process others."""
        self._begins = torch.ones(task.num_envs, dtype=torch.bool, device=device)
        self._observation: dict[str, Tensor] = {}
        self.time_share = torch.zeros((), dtype=torch.float64, device=device)
        """Share of the time that is used, written by the host; 0 where steps alone limit the training."""
        self.sums = torch.zeros(len(SUMS), dtype=torch.float64, device=device)  # `SUMS` since the start
        self.gauges = torch.zeros(len(self.GAUGES), dtype=torch.float64, device=device)  # `GAUGES` of the last update

    def restart_episodes(self) -> None:
        """Restart every episode, at random ages."""
        observation, _ = self._task.reset()
        self._task.stagger()
        self._observation = {key: observation[key].clone() for key in self.keys}

    @property
    def keys(self) -> Iterable[str]:
        """Return the keys of the observation that are looked at."""
        return self.network.shapes

    def iterate(self) -> None:
        """Simulate one segment and update the networks."""
        raise NotImplementedError

    def _count_episodes(self, ended: Tensor, episode_return: Tensor, episode_length: Tensor) -> None:
        """Add the steps of a segment, and the episodes that ended, to the sums; each (T, E)."""
        of_ended = [ended, episode_return * ended, episode_length * ended]
        self.sums[0].add_(ended.numel() * self.ranks.size)
        self.sums[1:].add_(self.ranks.sum_(torch.stack([values.sum(dtype=torch.float64) for values in of_ended])))

    def _linear_schedule(self, first: float, last: float) -> Tensor:
        """Return a float32 that changes linearly from ``first`` to ``last`` over the time or steps of the training."""
        share = self.time_share
        if self._cfg.max_env_steps is not None:
            share = torch.maximum(share, self.sums[0] / self._cfg.max_env_steps)
        return (first + (last - first) * share.clamp(0.0, 1.0)).float()

    def state_tensors(self) -> dict[str, Tensor]:
        """Return the tensors of a saved state besides network and task; they keep their memory."""
        return {"begins": self._begins, "sums": self.sums} | add_prefix("observation", self._observation)

    def tensors_of_all_processes(self) -> list[Tensor]:
        """Return the tensors that all processes share."""
        return [*self.network.parameters(), *self.network.buffers(), self.sums]

    @torch.no_grad()
    def join(self) -> None:
        """Copy the shared tensors from rank 0."""
        self.ranks.share_(self.tensors_of_all_processes())


def last_observations(info: Mapping[str, Tensor], keys: Iterable[str]) -> dict[str, Tensor]:
    """Return the observations before a reset, by key, as far as the task gives them."""
    named = {"observations": "final_observation"} | {key: f"final_{key}" for key in keys if key != "observations"}
    return {key: info[name] for key, name in named.items() if name in info and key in keys}
