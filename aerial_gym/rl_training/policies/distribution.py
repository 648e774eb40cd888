"""Action distribution: independent normal distributions with a standard deviation independent of the observation.

Letters: U entries of an action.
"""

from dataclasses import dataclass
from math import log, pi

import torch
from torch import Tensor


@dataclass(frozen=True)
class Gaussian:
    """``N(mean, exp(log_std)²)`` of every entry."""

    mean: Tensor  # (..., U)
    log_std: Tensor  # (U,)

    def sample(self, noise: Tensor) -> Tensor:
        """Return actions (..., U) made of standard normal noise."""
        return torch.addcmul(self.mean, noise, self.log_std.exp())

    def log_prob(self, action: Tensor) -> Tensor:
        """Return the log density of actions (..., U), (...)."""
        normal = (action - self.mean) * (-self.log_std).exp()
        return -0.5 * (normal * normal).sum(-1) - (self.log_std.sum() + 0.5 * log(2.0 * pi) * self.log_std.shape[0])

    def entropy(self) -> Tensor:
        """Return the differential entropy [nat], ()."""
        return self.log_std.sum() + 0.5 * (1.0 + log(2.0 * pi)) * self.log_std.shape[0]

    def divergence(self, mean: Tensor, log_std: Tensor) -> Tensor:
        """Return ``KL(N(mean, exp(log_std)²) || self)`` [nat], (...)."""
        change = self.log_std - log_std
        apart = (mean - self.mean) * (-self.log_std).exp()
        return (change + 0.5 * ((-2.0 * change).exp() + apart * apart) - 0.5).sum(-1)
