"""A variational autoencoder of range images, and the convolutions that all image networks of the package share.

Letters: B images, H x W pixels, C channels, L latents.
"""

from dataclasses import dataclass

import torch
from torch import Tensor, nn

from aerial_gym.config.checks import require_count
from aerial_gym.errors import ConfigError

ACTIVATIONS = {"elu": nn.ELU, "relu": nn.ReLU, "tanh": nn.Tanh}
"""By the name in the settings."""

SMALLEST_IMAGE = 4
"""Layers end where an image would have fewer rows or columns."""


@dataclass(frozen=True, kw_only=True)
class AutoencoderCfg:
    """Shape of an autoencoder."""

    rows: int  # Pixels in a column, >= 1
    columns: int  # Pixels in a row, >= 1
    latents: int = 64  # Number of latents of an image, >= 1; navigation takes 64
    channels: tuple[int, ...] = (32, 64, 128)  # Channels of the layers, each of which halves the image, each >= 1
    activation: str = "elu"  # `elu`, `relu` or `tanh`

    def __post_init__(self) -> None:
        require_count(self, "rows", "columns", "latents")
        if not self.channels or min(self.channels) < 1:
            raise ConfigError(f"AutoencoderCfg.channels = {self.channels!r}: needs numbers >= 1")
        if self.activation not in ACTIVATIONS:
            raise ConfigError(f"AutoencoderCfg.activation = {self.activation!r}: must be {', '.join(ACTIVATIONS)}")


def convolutions(
    shape: tuple[int, ...], channels: tuple[int, ...], activation: str
) -> tuple[list[nn.Module], list[tuple[int, int, int]]]:
    """Return stride-2 convolutions with activations that shrink an image (C, H, W), and the shapes between them.

    The shapes begin with that of the image; with n layers there are n + 1.
    """
    parts: list[nn.Module] = []
    shapes = [(shape[0], shape[1], shape[2])]
    for wide in channels:
        before, rows, columns = shapes[-1]
        if min(rows, columns) < 2 * SMALLEST_IMAGE:
            break
        parts += [nn.Conv2d(before, wide, kernel_size=3, stride=2, padding=1), ACTIVATIONS[activation]()]
        shapes.append((wide, (rows + 1) // 2, (columns + 1) // 2))
    return parts, shapes


class Autoencoder(nn.Module):
    """Encoder to a normal distribution of latents, and decoder from latents; pixels are shares of the largest distance."""

    def __init__(self, cfg: AutoencoderCfg) -> None:
        """Make the layers, with torch's own first weights."""
        super().__init__()
        self.cfg = cfg
        down, shapes = convolutions((1, cfg.rows, cfg.columns), cfg.channels, cfg.activation)
        channels, rows, columns = shapes[-1]
        width = channels * rows * columns
        self.encoder = nn.Sequential(*down, nn.Flatten())
        self.mean, self.log_variance = nn.Linear(width, cfg.latents), nn.Linear(width, cfg.latents)
        up: list[nn.Module] = [nn.Linear(cfg.latents, width), nn.Unflatten(1, (channels, rows, columns))]
        for before, after in zip(reversed(shapes[1:]), reversed(shapes[:-1]), strict=True):
            up += [
                ACTIVATIONS[cfg.activation](),
                nn.Upsample(size=after[1:]),
                nn.Conv2d(before[0], before[0], 3, padding=1),
            ]
            up += [ACTIVATIONS[cfg.activation](), nn.Conv2d(before[0], after[0], 3, padding=1)]
        self.decoder = nn.Sequential(*up)

    def encode(self, images: Tensor) -> tuple[Tensor, Tensor]:
        """Return mean and logarithm of the variance of the latents, (B, L) each, of images (B, H, W)."""
        features = self.encoder(images.unsqueeze(1))
        return self.mean(features), self.log_variance(features)

    def decode(self, latents: Tensor) -> Tensor:
        """Return images (B, H, W) of latents (B, L)."""
        return self.decoder(latents).squeeze(1)


def divergence(mean: Tensor, log_variance: Tensor) -> Tensor:
    """Return the divergence of normal distributions of latents from a standard one [nat], (B,); both (B, L).

    Source: Kingma and Welling (2014), Auto-Encoding Variational Bayes, appendix B.
    """
    return 0.5 * (mean.square() + log_variance.exp() - 1.0 - log_variance).sum(-1)


def negative_evidence(images: Tensor, decoded: Tensor, mean: Tensor, log_variance: Tensor) -> Tensor:
    """Return the bound of an image's negative log evidence [nat], up to a constant: ``H W ln(sigma) + divergence``.

    The standard deviation of a pixel is its maximum-likelihood value for the batch, the root mean squared error, so that no
    weight between the two terms is needed.

    Source:
        Rybkin, Daniilidis, Levine (2021), Simple and Effective VAE Training with Calibrated Decoders, section 3.3.
    """
    pixels = images[0].numel()
    squares = (images - decoded).square().mean().clamp_min(LEAST_VARIANCE)
    return 0.5 * pixels * torch.log(squares) + divergence(mean, log_variance).mean()


LEAST_VARIANCE = 1e-8
"""Of a pixel, of shares: 1 mm of 10 m; an image that is explained better is explained."""
