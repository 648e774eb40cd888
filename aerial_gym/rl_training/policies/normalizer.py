"""Running mean and variance of network inputs or targets, kept on the device.

Letters: N samples, O entries of a sample.
"""

from math import inf, isfinite

import torch
from torch import Tensor, nn

from aerial_gym.rl_training.ranks import ALONE, Ranks

EPSILON = 1e-5  # Added to the variance, as rl-games and Sample Factory do (`RunningMeanStd`, `RunningMeanStdInPlace`)
LIMIT = 5.0  # Normalised numbers are clamped to this, as both libraries do

OUTLIER = 100.0
"""Standard deviations beyond which a return is taken for a fault. Where returns really grow so far at once, the spread follows
them within a few updates."""


class RunningNormalizer(nn.Module):
    """``clamp((x - mean) / sqrt(var + epsilon), +-limit)`` with the mean and variance of all samples so far."""

    mean: Tensor
    var: Tensor
    count: Tensor
    std: Tensor

    def __init__(self, shape: tuple[int, ...] = (), *, limit: float = LIMIT, outlier: float = inf) -> None:
        """Take the shape of a sample; before the first update nothing is changed but clamped.

        Samples are clipped to ``outlier`` standard deviations from the running mean before they count. Statistics never
        decay, so that one impossible reward would otherwise spoil all later values.
        """
        super().__init__()
        self.limit, self.outlier = limit, outlier
        self.register_buffer("mean", torch.zeros(shape))
        self.register_buffer("var", torch.ones(shape))
        self.register_buffer("count", torch.zeros((), dtype=torch.float64))
        self.register_buffer("std", torch.ones(shape), persistent=False)
        self.register_load_state_dict_post_hook(lambda module, _: module._update_std())

    def forward(self, samples: Tensor) -> Tensor:
        """Return samples (..., O) normalised and clamped."""
        return ((samples - self.mean) / self.std).clamp(-self.limit, self.limit)

    def inverse(self, normal: Tensor) -> Tensor:
        """Return ``x std + mean``, the inverse of ``forward`` within its limit."""
        return normal * self.std + self.mean

    @torch.no_grad()
    def update(self, samples: Tensor, ranks: Ranks = ALONE) -> None:
        """Update mean and variance by samples, (N, O), of all processes, without waiting.

        Source:
            Chan, Golub, LeVeque (1979), Updating formulae and a pairwise algorithm for computing sample variances, eq. 2.1.
        """
        if isfinite(self.outlier):
            reach = torch.where(self.count > 0.0, self.outlier * self.std, inf)
            samples = samples.clamp(self.mean - reach, self.mean + reach)
        (var, mean), number = ranks.var_mean(samples), samples.shape[0] * ranks.size
        total = self.count + number
        share = (number / total).to(mean.dtype)
        delta = mean - self.mean
        self.var.copy_((1.0 - share) * self.var + share * var + share * (1.0 - share) * delta * delta)
        self.mean.add_(share * delta)
        self.count.copy_(total)
        self._update_std()

    def set_statistics(self, mean: Tensor, var: Tensor) -> None:
        """Take the mean and variance that another library counted."""
        self.mean.copy_(mean)
        self.var.copy_(var)
        self._update_std()

    def _update_std(self) -> None:
        self.std.copy_((self.var + EPSILON).sqrt())
