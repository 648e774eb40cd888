"""Advantages and bounds of actions for learners: pure functions.

Letters: T steps, E environments, U entries of an action.
"""

from typing import Any

import torch
from torch import Tensor

BOUND = 1.1  # Means of actions beyond it are pulled back, as in rl-games; the simulation clamps actions at 1


def generalized_advantages(
    reward: Tensor,
    value: Tensor,
    next_value: Tensor,
    terminated: Tensor,
    ended: Tensor,
    *,
    discount: float,
    decay: float,
) -> Tensor:
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
