"""Base of the learners: networks, present observation, sums for the host; advantages, bounds of actions, and Adam.

Letters: T steps of a segment, E environments, U entries of an action.
"""

from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from typing import Any, ClassVar

import torch
from torch import Tensor, nn

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
    segments = 1  # Segments of every environment in an iteration

    def __init__(self, cfg: TrainingCfg, task: Task, network: ActorCritic, ranks: Ranks = ALONE) -> None:
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
    def other_networks(self) -> Mapping[str, ActorCritic]:
        """Return the networks besides ``network`` that learn and are saved, by name."""
        return {}

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

    def tensors_to_share(self) -> list[Tensor]:
        """Return the tensors that all processes share."""
        return [*self.network.parameters(), *self.network.buffers(), self.sums]

    @torch.no_grad()
    def copy_tensors_from_leader(self) -> None:
        """Copy the shared tensors from rank 0."""
        self.ranks.share_(self.tensors_to_share())


def last_observations(info: Mapping[str, Tensor], keys: Iterable[str]) -> dict[str, Tensor]:
    """Return the observations before a reset, by key, as far as the task gives them."""
    named = {"observations": "final_observation"} | {key: f"final_{key}" for key in keys if key != "observations"}
    return {key: info[name] for key, name in named.items() if name in info and key in keys}


BOUND = 1.1  # Means of actions beyond it are pulled back, as in rl-games; the simulation clamps actions at 1


def generalized_advantages(
    reward: Tensor, value: Tensor, next_value: Tensor, terminated: Tensor, ended: Tensor, *, discount: float,
    decay: float,
) -> Tensor:  # fmt: skip
    """Return ``A_t = d_t + discount decay A_(t+1)`` with ``d_t = r_t + discount V_next - V_t``.

    Args:
        reward: r, (T, E).
        value: V_t of the observation before each step, (T, E).
        next_value: V of the observation after it and before a reset, (T, E): a truncated episode is worth that. Not counted
            where the episode terminated.
        terminated: Whether the episode ended for good, bool, (T, E).
        ended: Whether it ended, by termination or truncation, bool, (T, E): later steps do not count.
        discount: gamma.
        decay: lambda.

    Source:
        Schulman, Moritz, Levine, Jordan, Abbeel (2016), High-dimensional continuous control using generalized advantage
        estimation, eq. 16; truncation: Pardo, Tavakoli, Levdik, Kormushev (2018), Time limits in reinforcement learning, eq. 6.
    """
    delta = reward + discount * next_value.masked_fill(terminated, 0.0) - value
    carry = (~ended).to(delta.dtype) * (discount * decay)
    advantage = torch.empty_like(delta)
    advantage[-1] = delta[-1]
    for t in reversed(range(len(delta) - 1)):
        torch.addcmul(delta[t], carry[t], advantage[t + 1], out=advantage[t])
    return advantage


def bound_excess(mean: Tensor) -> Tensor:
    """Return the sum over entries of ``max(|mean| - 1.1, 0)²`` of each sample."""
    return ((mean.abs() - BOUND).clamp_min(0.0) ** 2).sum(-1)


class _ClampAction(torch.autograd.Function):
    @staticmethod
    def forward(ctx: Any, action: Tensor) -> Tensor:
        ctx.save_for_backward(action)
        return action.clamp(-1.0, 1.0)

    @staticmethod
    def backward(ctx: Any, gradient: Tensor) -> Tensor:
        (action,) = ctx.saved_tensors
        outward = ((action > 1.0) & (gradient < 0.0)) | ((action < -1.0) & (gradient > 0.0))
        return gradient.nan_to_num(0.0, 0.0, 0.0).masked_fill(outward, 0.0)


def clamp_action(action: Tensor) -> Tensor:
    """Return actions clamped to -1 to 1, (E, U), with the gradient of a loss that is minimised under this bound.

    Beyond the bound a descent may return but go no further out; with a plain clamp it would have no gradient there. NaN or
    infinite gradients of diverged rows are set to 0.
    """
    return _ClampAction.apply(action)


BETAS, EPSILON = (0.9, 0.999), 1e-8  # Kingma, Ba (2015), Adam: a method for stochastic optimization, algorithm 1
PIECE = 4096  # Weights of one block of a GPU: a tensor of 100,000 would occupy two multiprocessors


class FlatAdam:
    """Adam with a limit on the gradient norm."""

    def __init__(self, network: nn.Module, *, max_norm: float, betas: tuple[float, float] = BETAS) -> None:
        self._parameters = [p for p in network.parameters() if p.requires_grad]
        self._max_norm, self._betas = max_norm, betas
        self.weights = torch.cat([p.detach().reshape(-1) for p in self._parameters])  # (P,)
        self._bind_weights(self.weights)
        self._mean, self._square = torch.zeros_like(self.weights), torch.zeros_like(self.weights)
        self._steps = torch.zeros((), device=self.weights.device)

    def _bind_weights(self, flat: Tensor) -> None:
        start = 0
        for parameter in self._parameters:
            parameter.data = flat[start : start + parameter.numel()].view_as(parameter)
            start += parameter.numel()

    def weight_offset(self, parameter: Tensor) -> int:
        """Return the offset of a network parameter among all weights."""
        return (parameter.data_ptr() - self.weights.data_ptr()) // self.weights.element_size()

    def gradient(self, loss: Tensor) -> Tensor:
        """Return the gradient of ``loss`` with respect to all weights, (P,)."""
        return torch.cat([g.reshape(-1) for g in torch.autograd.grad(loss, self._parameters)])

    @torch.no_grad()
    def step(self, gradient: Tensor, rate: Tensor) -> None:
        """Update the weights by ``gradient``, (P,), with a rate on the device, ()."""
        # The kernel divides the gradient by grad_scale.
        excess = (torch.linalg.vector_norm(gradient) / self._max_norm).clamp_min(1.0)
        self._steps.add_(1.0)
        weights, gradients, means, squares = (
            list(flat.split(PIECE)) for flat in (self.weights, gradient, self._mean, self._square)
        )
        torch._fused_adam_(  # pyright: ignore[reportPrivateImportUsage]
            weights,
            gradients,
            means,
            squares,
            [],
            [self._steps] * len(weights),
            lr=rate,
            beta1=self._betas[0],
            beta2=self._betas[1],
            weight_decay=0.0,
            eps=EPSILON,
            amsgrad=False,
            maximize=False,
            grad_scale=excess,
            found_inf=None,
        )

    def state_tensors(self) -> dict[str, Tensor]:
        """Return the tensors of a saved state besides the weights; they keep their memory."""
        return {"mean": self._mean, "square": self._square, "steps": self._steps}


@contextmanager
def low_precision() -> Iterator[None]:
    """Multiply float32 matrices on a GPU with 10 bits of mantissa: exact enough for gradients of a network of noisy samples.
    Not for passes forward, as the probability ratio compares two of them, nor for gradients that go back through physics."""
    before = torch.backends.cuda.matmul.allow_tf32
    torch.backends.cuda.matmul.allow_tf32 = True
    try:
        yield
    finally:
        torch.backends.cuda.matmul.allow_tf32 = before
