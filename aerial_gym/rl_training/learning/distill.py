"""Distillation: a student learns the teacher's actions at states that the student visits.

The teacher may observe simulation-only quantities, the student those of the real vehicle. The teacher acts in most rows at
first, the student in all at the end; the teacher labels every state. The student's standard deviation is fitted to its
distance from the teacher, as exploration for a later ``ppo``.

Letters: T steps of a segment, E environments, U entries of an action.

Source:
    Ross, Gordon, Bagnell (2011), A reduction of imitation learning and structured prediction to no-regret online learning,
    algorithm 3.1 (DAgger), with a share of rows in place of a probability.
"""

from collections.abc import Mapping
from math import log

import torch
from torch import Tensor

from aerial_gym.registry.state import add_prefix
from aerial_gym.rl_training.learner_settings import DistillCfg
from aerial_gym.rl_training.learning.learner import FlatAdam, Learner, low_precision
from aerial_gym.rl_training.policies.actor_critic import ActorCritic
from aerial_gym.rl_training.policies.policy import Policy
from aerial_gym.rl_training.settings import TrainingCfg
from aerial_gym.task import Task


class Distill(Learner):
    """A student, its optimiser, and the simulation's current observation."""

    GAUGES = ("learning_rate", "std", "difference", "flown_by_teacher")
    """The difference is the root of the mean square of an action's entry; the last is a share of the rows."""

    def __init__(self, cfg: TrainingCfg, task: Task, network: ActorCritic, teacher: Policy) -> None:
        super().__init__(cfg, task, network)
        self._distill, self._teacher = cfg.section(DistillCfg), teacher
        self._adam = FlatAdam(network.actor, max_norm=self._distill.max_grad_norm)
        self._memory, self._taught = network.empty_memory(task.num_envs), teacher.empty_memory(task.num_envs)
        self._rows = torch.arange(task.num_envs, device=task.device)

    @property
    def keys(self) -> set[str]:
        """Keys of the observation that student or teacher see."""
        return {*self.network.shapes, *self._teacher.shapes}

    def iterate(self) -> None:
        """Simulate one segment, label it by the teacher, and fit the student."""
        cfg, actor = self._distill, self.network.actor
        teaching = self._linear_schedule(1.0, -1.0)  # none is left to it in the second half
        rate = self._linear_schedule(cfg.learning_rate, cfg.end_learning_rate)
        with torch.no_grad():
            seen, begins, memory, wanted = self._simulate_segment(self._rows < teaching * self._task.num_envs)
            prepared = actor.body.network_inputs(seen)
        told = []
        for _ in range(cfg.num_epochs):
            order = torch.rand(self._task.num_envs, generator=self.generator, device=self._task.device).argsort()
            for chosen in order.tensor_split(cfg.num_minibatches):
                part = {key: value.index_select(1, chosen) for key, value in prepared.items()}
                distribution, _ = self.network.sequence_outputs(part, memory[chosen], begins[:, chosen])
                goal = wanted[:, chosen]
                with low_precision():
                    gradient = self._adam.gradient(-distribution.log_prob(goal).mean())
                self._adam.step(gradient, rate)
                actor.log_std.data.clamp_(min=log(cfg.min_std))
                told.append((distribution.mean.detach() - goal).square().mean())
        self.network.update_normalizers(seen)
        numbers = (rate, actor.log_std.data.exp().mean(), torch.stack(told).mean().sqrt(), teaching.clamp_min(0.0))
        self.gauges.copy_(torch.stack(numbers))

    def _simulate_segment(self, led: Tensor) -> tuple[dict[str, Tensor], Tensor, Tensor, Tensor]:
        """Simulate T steps, with the teacher's actions in the rows of ``led``.

        Returns:
            What the student saw by key, (T, E, ...); whether an episode began there, bool, (T, E); what it remembered before
            the first step, (E, M); what the teacher would have done, (T, E, U).
        """
        task, before = self._task, self._memory.clone()
        memory, begins, observation = before, self._begins, self._observation
        seen, began, wanted, ends = [], [], [], []
        for _ in range(self._distill.horizon):
            mean, memory = self.network.actor.explore(observation, memory, begins)
            goal, taught = self._teacher.explore(observation, self._taught, begins)
            self._taught.copy_(taught)
            goal = goal.clamp(-1.0, 1.0)
            seen.append({key: observation[key].clone() for key in self.network.shapes})
            began.append(begins)
            wanted.append(goal)
            observation, _, terminated, truncated, info = task.step(
                torch.where(led.unsqueeze(-1), goal, mean.clamp(-1.0, 1.0))
            )
            begins = terminated | truncated
            ends.append((begins, info["episode_return"], info["episode_length"]))
        self._count_episodes(*(torch.stack(column) for column in zip(*ends, strict=True)))
        stacked = {key: torch.stack([each[key] for each in seen]) for key in seen[0]}
        flown = stacked, torch.stack(began), before, torch.stack(wanted)
        for key, value in self._observation.items():
            value.copy_(observation[key])
        self._memory.copy_(memory)
        self._begins.copy_(begins)
        return flown

    def state_tensors(self) -> dict[str, Tensor]:
        """Return the tensors of a saved state besides network and task; they keep their memory."""
        own: Mapping[str, Tensor] = {"memory": self._memory, "taught": self._taught}
        return super().state_tensors() | own | add_prefix("adam", self._adam.state_tensors())
