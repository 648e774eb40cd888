"""Proximal policy optimisation: roll the simulation out, estimate advantages, follow the clipped objective.

All data are on the device and nothing waits for it: ``Ppo.iterate`` can be one CUDA graph, simulation included, and the
same code runs step by step on a CPU. With several processes each simulates its own environments; gradients, divergence,
normalisers and sums are combined over all (``Ranks``), so that networks and rates are equal in each.

Letters: T steps of a segment, E environments, U entries of an action, M numbers of memory.

Source:
    Schulman, Wolski, Dhariwal, Radford, Klimov (2017), Proximal policy optimization algorithms, arXiv 1707.06347.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from math import log

import torch
from torch import Tensor

from aerial_gym.registry.state import add_prefix
from aerial_gym.rl_training.learner_settings import PpoCfg
from aerial_gym.rl_training.learning.learner import (
    FlatAdam,
    Learner,
    bound_excess,
    generalized_advantages,
    last_observations,
    low_precision,
)
from aerial_gym.rl_training.policies.actor_critic import ActorCritic
from aerial_gym.rl_training.policies.policy import Gaussian
from aerial_gym.rl_training.ranks import ALONE, Ranks
from aerial_gym.rl_training.settings import TrainingCfg
from aerial_gym.task import Task

RATE_STEP = 1.5  # Factor of the learning rate: up below half the divergence threshold, down above twice, as in rl-games
LOWEST_RATE = 1e-6  # Least learning rate, as in rl-games
TINY = 1e-8  # Keeps advantages that are all alike from being divided by 0


def clipped_objective(log_ratio: Tensor, advantage: Tensor, *, clip_range: float) -> Tensor:
    """Return ``min(r A, clip(r, 1 - e, 1 + e) A)`` of each sample, with r the probability ratio; eq. 7 of the source."""
    ratio = log_ratio.exp()
    return torch.minimum(ratio * advantage, ratio.clamp(1.0 - clip_range, 1.0 + clip_range) * advantage)


def squared_error(value: Tensor, target: Tensor, old_value: Tensor, *, clip_range: float | None) -> Tensor:
    """Return ``(V - R)²`` of each sample, or its maximum with that of the value clipped around the old one."""
    error = (value - target) ** 2
    if clip_range is None:
        return error
    clipped = old_value + (value - old_value).clamp(-clip_range, clip_range)
    return torch.maximum(error, (clipped - target) ** 2)


def adapt_rate(rate: Tensor, divergence: Tensor, *, threshold: float, highest: Tensor) -> Tensor:
    """Return the learning rate adapted to the KL divergence of an update, all scalars ()."""
    rate = torch.where(divergence > 2.0 * threshold, rate / RATE_STEP, rate)
    rate = torch.where(divergence < 0.5 * threshold, rate * RATE_STEP, rate)
    return torch.minimum(rate.clamp_min(LOWEST_RATE), highest)


@dataclass(frozen=True, kw_only=True)
class RolloutSegment:
    """One segment of every environment, (T, E, ...); the memory is that of its start."""

    observation: Mapping[str, Tensor]  # By key, (T + 1, E, ...): the last one is where the next segment begins
    final: Mapping[str, Tensor]  # After each step, before a reset, (T, E, ...), by key; last image for an end
    begins: Tensor  # Whether an episode begins with the observation, bool, (T + 1, E)
    memory: Tensor  # Memory before the first step, (E, M)
    acting: Tensor  # Memory of the policy after the last step, (E, M')
    action: Tensor
    mean: Tensor  # Of the distribution that the action was drawn from
    reward: Tensor
    terminated: Tensor  # Bool
    episode_return: Tensor
    episode_length: Tensor  # Of the episodes so far; counted where they end


@dataclass(frozen=True, kw_only=True)
class Samples:
    """Samples of an update."""

    prepared: Mapping[str, Tensor]  # Observations as the networks take them, by key, (T, E, ...)

    in_time: Mapping[str, Tensor]
    """``begins``, ``action``, ``mean``, ``log_prob``, ``advantage``, and normalised ``value`` (before learning) and ``target``
    (what it is to become), (T, E, ...)."""

    memory: Tensor  # Memory before the first step, (E, M)

    def select(self, environments: Tensor) -> "Samples":
        """Return the samples of selected environments, int64 (E',)."""
        prepared, in_time = (
            {name: value.index_select(1, environments) for name, value in values.items()}
            for values in (self.prepared, self.in_time)
        )
        return Samples(prepared=prepared, in_time=in_time, memory=self.memory.index_select(0, environments))


class Ppo(Learner):
    """Proximal policy optimisation: network, optimiser, and the simulation's current observation."""

    GAUGES = ("learning_rate", "std", "divergence", "policy_loss", "value_loss")
    """The last three are means over the minibatches of the last pass over the samples."""

    def __init__(self, cfg: TrainingCfg, task: Task, network: ActorCritic, ranks: Ranks = ALONE) -> None:
        super().__init__(cfg, task, network, ranks)
        self._ppo = ppo = cfg.section(PpoCfg)
        self._adam = FlatAdam(network, max_norm=ppo.max_grad_norm)
        self._memory = network.empty_memory(task.num_envs)
        self._rate = torch.full((), ppo.learning_rate, device=task.device)

    def iterate(self) -> None:
        """Simulate one segment and update the networks."""
        with torch.no_grad():
            flown = self._simulate_segment()
            samples = self._segment_samples(flown)
            old_log_std = self.network.actor.log_std.clone()
            highest = self._linear_schedule(self._ppo.max_learning_rate, self._ppo.end_learning_rate)
        for _ in range(self._ppo.num_epochs):
            self._run_epoch(samples, old_log_std, highest)
        self.network.update_normalizers({key: value[:-1] for key, value in flown.observation.items()}, self.ranks)

    def _simulate_segment(self) -> RolloutSegment:
        """Simulate T steps with exploration, and store the start of the next segment."""
        task, keys = self._task, self.network.shapes
        noise = torch.randn(
            (self._ppo.horizon, task.num_envs, task.num_actions), generator=self.generator, device=task.device
        )
        memory = self._memory.clone()
        acting, _ = memory.split(self.network.memory_sizes, dim=-1)
        seen, begins, finals, steps = [dict(self._observation)], [self._begins], [], []
        for t in range(self._ppo.horizon):
            mean, action, command, acting = self._draw_action_and_command(seen[-1], acting, begins[-1], noise[t])
            observation, reward, terminated, truncated, info = task.step(command)
            finals.append(last_observations(info, keys))
            begins.append(terminated | truncated)
            steps.append((action, mean, reward, terminated, info["episode_return"], info["episode_length"]))
            seen.append({key: observation[key] for key in keys})
        action, mean, reward, terminated, total, length = (torch.stack(column) for column in zip(*steps, strict=True))
        flown = RolloutSegment(
            observation={key: torch.stack([each[key] for each in seen]) for key in keys},
            final={key: torch.stack([each[key] for each in finals]) for key in finals[0]}, begins=torch.stack(begins),
            memory=memory, acting=acting, action=action, mean=mean, reward=reward, terminated=terminated,
            episode_return=total, episode_length=length,
        )  # fmt: skip
        for key, value in self._observation.items():
            value.copy_(seen[-1][key])
        self._begins.copy_(begins[-1])
        return flown

    def _draw_action_and_command(
        self, seen: Mapping[str, Tensor], memory: Tensor, begins: Tensor, noise: Tensor
    ) -> tuple[Tensor, Tensor, Tensor, Tensor]:
        """Return the mean action, one drawn about it, that as the simulation takes it, and the policy's memory."""
        actor = self.network.actor
        mean, memory = actor.explore(seen, memory, begins)
        action = Gaussian(mean, actor.log_std).sample(noise)
        return mean, action, action.clamp(-1.0, 1.0), memory

    def _segment_samples(self, flown: RolloutSegment) -> Samples:
        """Estimate advantages and returns of a segment, and count it."""
        ppo, network, ended = self._ppo, self.network, flown.begins[1:]
        prepared = network.network_inputs(flown.observation)
        before = {key: value[:-1] for key, value in prepared.items()}
        values, final, remembered = self._segment_values(prepared, before | network.network_inputs(flown.final), flown)
        advantage = generalized_advantages(
            ppo.reward_scale * flown.reward, values[:-1], torch.where(ended, final, values[1:]), flown.terminated,
            ended, discount=ppo.discount, decay=ppo.gae_lambda,
        )  # fmt: skip
        value = values[:-1]
        if ppo.normalize_value:
            network.scale.update((advantage + value).flatten(), self.ranks)
        self._memory.copy_(network.join_memory(flown.acting, remembered[-2]))
        self._count_episodes(ended, flown.episode_return, flown.episode_length)
        var, mean = self.ranks.var_mean(advantage.flatten())
        return Samples(
            memory=flown.memory,
            prepared=before,
            in_time={
                "begins": flown.begins[:-1], "action": flown.action, "mean": flown.mean,
                "log_prob": Gaussian(flown.mean, network.actor.log_std).log_prob(flown.action),
                "advantage": (advantage - mean) / (var.sqrt() + TINY), "value": network.scale(value),
                "target": network.scale(advantage + value),
            },
        )  # fmt: skip

    def _segment_values(
        self, prepared: Mapping[str, Tensor], final: Mapping[str, Tensor], flown: RolloutSegment
    ) -> tuple[Tensor, Tensor, Tensor]:
        """Return values of observations (T + 1, E) and of final ones (T, E), and the critic's memory after each."""
        values, remembered = self.network.values(prepared, flown.memory, flown.begins)
        return values, self.network.next_values(final, remembered[:-1]), remembered

    def _run_epoch(self, samples: Samples, old_log_std: Tensor, highest: Tensor) -> None:
        """Run one epoch over all samples, in random order of environments, and adapt the learning rate."""
        ppo, log_std, told = self._ppo, self.network.actor.log_std, []
        order = torch.rand(self._task.num_envs, generator=self.generator, device=self._task.device).argsort()
        for chosen in order.tensor_split(ppo.num_minibatches):
            gradient, numbers = self._loss_gradient(samples, chosen, old_log_std)
            told.append(numbers)
            self._adam.step(self.ranks.mean_(gradient), self._rate)
            log_std.data.clamp_(min=log(ppo.min_std))
        numbers = self.ranks.mean_(torch.stack(told).mean(0))
        self._rate.copy_(adapt_rate(self._rate, numbers[0], threshold=ppo.kl_threshold, highest=highest))
        self.gauges.copy_(torch.cat((torch.stack((self._rate, log_std.data.exp().mean())), numbers)))

    def _loss_gradient(self, samples: Samples, chosen: Tensor, old_log_std: Tensor) -> tuple[Tensor, Tensor]:
        """Return the gradient of the loss (P,) over the samples of some environments, (E',); divergence and losses, (3,)."""
        ppo, part = self._ppo, samples.select(chosen)
        old = part.in_time
        distribution, value = self.network.sequence_outputs(part.prepared, part.memory, old["begins"])
        log_ratio = distribution.log_prob(old["action"]) - old["log_prob"]
        policy_loss = -clipped_objective(log_ratio, old["advantage"], clip_range=ppo.clip_range).mean()
        limit = ppo.clip_range if ppo.clip_value else None
        value_loss = 0.5 * squared_error(value, old["target"], old["value"], clip_range=limit).mean()
        loss = policy_loss + ppo.value_coef * value_loss
        if ppo.bound_coef:
            loss = loss + ppo.bound_coef * bound_excess(distribution.mean).mean()
        if ppo.entropy_coef:
            loss = loss - ppo.entropy_coef * distribution.entropy()
        with torch.no_grad():
            divergence = distribution.divergence(old["mean"], old_log_std).mean()
            numbers = torch.stack((divergence, policy_loss, value_loss))
        with low_precision():
            return self._adam.gradient(loss), numbers

    def state_tensors(self) -> dict[str, Tensor]:
        """Return the tensors of a saved state besides network and task; they keep their memory."""
        own = {"memory": self._memory, "rate": self._rate}
        return super().state_tensors() | own | add_prefix("adam", self._adam.state_tensors())

    def tensors_to_share(self) -> list[Tensor]:
        """Return the tensors that all processes share."""
        return [*super().tensors_to_share(), *self._adam.state_tensors().values(), self._rate]
