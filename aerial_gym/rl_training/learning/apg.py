"""Short-horizon actor-critic: the return of a short window is differentiated through the simulation itself.

The policy climbs the mean over rows of ``sum_k gamma^k r_k + gamma^n V(s_n)``, summed over the episodes of a window. The
gradient is computed through policy, controller and physics; it ends at the start of a window and of an episode. The critic
for the last state of a window, or of a truncated episode, is a slow copy (``target``) of one fitted to lambda-returns;
without ``terminal_value`` V is 0 and no critic is trained.

Letters: T steps of a window, E environments, U entries of an action.

Source:
    Xu, Makoviychuk, Narang, Ramos, Matusik, Garg, Macklin (2022), Accelerated policy learning with parallel differentiable
    simulation, ICLR, eq. 3 to 7 and algorithm 1.
"""

from collections.abc import Mapping
from copy import deepcopy
from dataclasses import dataclass
from math import log

import torch
from torch import Tensor, nn

from aerial_gym.errors import CapabilityError
from aerial_gym.registry.state import add_prefix
from aerial_gym.rl_training.learner_settings import ApgCfg
from aerial_gym.rl_training.learning.learner import (
    FlatAdam,
    Learner,
    bound_excess,
    clamp_action,
    generalized_advantages,
    last_observations,
)
from aerial_gym.rl_training.policies.actor_critic import ActorCritic
from aerial_gym.rl_training.policies.policy import Gaussian
from aerial_gym.rl_training.settings import TrainingCfg
from aerial_gym.task import Task

BETAS = (0.7, 0.95)  # Decay rates of Adam for the policy, as in Xu et al. (2022), table 4: its gradients grow


@dataclass(frozen=True, kw_only=True)
class Window:
    """Samples of a window, (T, E, ...); rewards, last observations and means keep their gradients."""

    observation: Mapping[str, Tensor]  # By key, before each step, without gradients
    final: Mapping[str, Tensor]  # After each step and before a reset, by key
    last: Mapping[str, Tensor]  # After the last step and its resets, (E, ...), without gradients, by key
    mean: Tensor  # Of the actions, (T, E, U)
    reward: Tensor
    terminated: Tensor  # Bool
    ended: Tensor  # By termination or truncation, bool
    episode_return: Tensor
    episode_length: Tensor  # Of the episodes so far; counted where they end


def window_return(reward: Tensor, value: Tensor, terminated: Tensor, ended: Tensor, *, discount: float) -> Tensor:
    """Return the discounted return of a window with the critic's value at its end, (E,).

    Args:
        reward: r, (T, E).
        value: V of the observation after each step and before a reset, (T, E). It counts in the last step and at truncations.
        terminated: Whether the episode ended for good, bool, (T, E): nothing follows.
        ended: Whether it ended, by termination or truncation, bool, (T, E).
        discount: gamma.

    Source:
        Xu et al. (2022), eq. 5.
    """
    judged = ended.clone()
    judged[-1] = True
    worth = torch.where(judged & ~terminated, discount * value, 0.0)
    factor, total = torch.ones_like(reward[0]), torch.zeros_like(reward[0])
    for now, over in zip(reward + worth, ended, strict=True):
        total = total + factor * now
        factor = torch.where(over, 1.0, discount * factor)
    return total


class Apg(Learner):
    """Short-horizon actor-critic: policy, critic, target critic, optimisers, and the simulation's current observation."""

    GAUGES = ("learning_rate", "std", "gradient_norm", "policy_loss", "value_loss")
    """The gradient is that of the policy, before it is limited; the loss of values is the mean over the last epoch."""

    def __init__(self, cfg: TrainingCfg, task: Task, network: ActorCritic) -> None:
        super().__init__(cfg, task, network)
        check_differentiable(task, cfg)
        self._apg = apg = cfg.section(ApgCfg)
        self.captures = apg.capture
        self.target = deepcopy(network).requires_grad_(False)  # Its critic judges the ends of windows
        self.target.scale = network.scale
        self._critics = (_critic_modules(network), _critic_modules(self.target))
        self._actor_adam = FlatAdam(network.actor, max_norm=apg.max_grad_norm, betas=BETAS)
        self._critic_adam = FlatAdam(self._critics[0], max_norm=apg.max_grad_norm)

    def restart_episodes(self) -> None:
        """Restart every episode, at random ages."""
        super().restart_episodes()
        self._task.detach_in_place()

    def iterate(self) -> None:
        """Simulate one window, ascend the gradient of its return, and fit the critic to its states."""
        window = self._simulate_window()
        loss, value = self._policy_loss(window)
        gradient = self._actor_adam.gradient(loss)
        norm = torch.linalg.vector_norm(gradient)  # the optimiser limits it in place
        rate = self._linear_schedule(self._apg.learning_rate, self._apg.end_learning_rate)
        self._actor_adam.step(gradient, rate)
        self.network.actor.log_std.data.clamp_(min=log(self._apg.min_std))
        with torch.no_grad():
            value_loss = torch.zeros_like(norm)
            if self._apg.terminal_value:
                value_loss = self._fit_critic(window, value.detach(), rate)
            self.network.update_normalizers(window.observation)
            self._count_episodes(window.ended, window.episode_return, window.episode_length)
            std = self.network.actor.log_std.exp().mean()
            self.gauges.copy_(torch.stack((rate, std, norm, loss.detach(), value_loss)))
            for key, value in self._observation.items():
                value.copy_(window.last[key])
        self._task.detach_in_place()

    def _simulate_window(self) -> Window:
        """Simulate T steps with exploration."""
        task, actor, keys = self._task, self.network.actor, self.network.shapes
        shape = (self._apg.horizon, task.num_envs, task.num_actions)
        noise = torch.randn(shape, generator=self.generator, device=task.device)
        seen: dict[str, Tensor] = dict(self._observation)
        observed, finals, steps = [], [], []
        for step in noise:
            mean, _ = actor.step(seen, actor.empty_memory(task.num_envs))
            action = clamp_action(Gaussian(mean, actor.log_std).sample(step))
            observed.append({key: value.detach() for key, value in seen.items()})
            observation, reward, terminated, truncated, info = task.step(action)
            finals.append(last_observations(info, keys))
            ended = terminated | truncated
            steps.append((mean, reward, terminated, ended, info["episode_return"], info["episode_length"]))
            seen = {key: observation[key] for key in keys}
        mean, reward, terminated, ended, total, length = (torch.stack(column) for column in zip(*steps, strict=True))
        return Window(
            observation={key: torch.stack([each[key] for each in observed]) for key in keys},
            final={key: torch.stack([each[key] for each in finals]) for key in keys},
            last={key: value.detach() for key, value in seen.items()}, mean=mean,
            reward=self._apg.reward_scale * reward, terminated=terminated, ended=ended, episode_return=total,
            episode_length=length,
        )  # fmt: skip

    def _policy_loss(self, window: Window) -> tuple[Tensor, Tensor]:
        """Return the negative return of a window per step, and the values (T, E) of the last observations."""
        value = (
            self._target_critic_values(window.final) if self._apg.terminal_value else torch.zeros_like(window.reward)
        )
        gained = window_return(window.reward, value, window.terminated, window.ended, discount=self._apg.discount)
        loss = -gained.mean() / self._apg.horizon
        if self._apg.bound_coef:
            loss = loss + self._apg.bound_coef * bound_excess(window.mean).mean()
        return loss, value

    def _target_critic_values(self, observation: Mapping[str, Tensor]) -> Tensor:
        """Return the target critic's values (T, E) of observations (T, E, ...), in units of the return."""
        prepared = self.network.network_inputs(observation)
        first = next(iter(prepared.values()))
        return self.target.next_values(prepared, first.new_zeros(*first.shape[:2], 0))

    def _fit_critic(self, window: Window, next_value: Tensor, rate: Tensor) -> Tensor:
        """Fit the critic to the returns of a window, update the target critic, and return the loss."""
        apg, network, shown = self._apg, self.network, window.observation
        value = self._target_critic_values(shown)
        advantage = generalized_advantages(
            window.reward.detach(), value, next_value, window.terminated, window.ended, discount=apg.discount,
            decay=apg.gae_lambda,
        )  # fmt: skip
        worth = (advantage + value).flatten()
        if apg.normalize_value:
            network.scale.update(worth)
        target, prepared = network.scale(worth), {k: v.flatten(0, 1) for k, v in network.network_inputs(shown).items()}
        critic_rate, losses = rate * (apg.critic_learning_rate / apg.learning_rate), []
        for _ in range(apg.critic_epochs):
            order = torch.rand(len(target), generator=self.generator, device=target.device).argsort()
            losses = [
                self._update_critic({key: value[rows] for key, value in prepared.items()}, target[rows], critic_rate)
                for rows in order.tensor_split(apg.critic_minibatches)
            ]
        for fast, slow in zip(*(critic.parameters() for critic in self._critics), strict=True):
            slow.lerp_(fast, apg.target_share)
        return torch.stack(losses).mean()

    def _update_critic(self, prepared: Mapping[str, Tensor], target: Tensor, rate: Tensor) -> Tensor:
        """Move the critic towards normalised values (N,) of observations (N, ...); return the loss before."""
        with torch.enable_grad():
            body = self.network.own_body
            assert body is not None
            features, _ = body(prepared, target.new_zeros(len(target), 0))
            loss = 0.5 * (self.network.value_head(features).squeeze(-1) - target).square().mean()
            gradient = self._critic_adam.gradient(loss)
        self._critic_adam.step(gradient, rate)
        return loss.detach()

    def state_tensors(self) -> dict[str, Tensor]:
        """Return the tensors of a saved state besides network and task; they keep their memory."""
        adams = {"actor": self._actor_adam.state_tensors(), "critic": self._critic_adam.state_tensors()}
        tensors = super().state_tensors() | add_prefix("target", dict(self._critics[1].named_parameters()))
        return tensors | {name: t for prefix, adam in adams.items() for name, t in add_prefix(prefix, adam).items()}


def check_differentiable(task: Task, cfg: TrainingCfg) -> None:
    """Refuse task terms without gradients through windows with resets."""
    if task.values.graph is None:
        raise CapabilityError(f"trainer apg: task {cfg.task} has no gradients. Make it with differentiable=True")
    drawn = ", ".join(task.env.robot_manager.draws())
    if drawn:
        raise CapabilityError(
            f"trainer apg: task {cfg.task} draws {drawn} at resets, over which no gradient goes back. Take them out of "
            "randomize, or train with ppo"
        )
    apg, bends = cfg.section(ApgCfg), task.env.robot_manager.articulation is not None
    if bends and apg.capture and task.device.type == "cuda":
        raise CapabilityError(
            f"trainer apg: task {cfg.task} flies a robot with joints, whose link poses need host data, which a CUDA "
            "graph cannot contain. Give capture: false, or train with ppo"
        )


def _critic_modules(network: ActorCritic) -> nn.ModuleList:
    """Return the parts of a network that judge."""
    assert network.own_body is not None
    return nn.ModuleList([network.own_body, network.value_head])
