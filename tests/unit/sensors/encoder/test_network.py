"""The autoencoder: its loss against the distributions that it stands for, and the shapes that it takes."""

import pytest
import torch
from torch.distributions import Normal, kl_divergence

from aerial_gym.errors import ConfigError
from aerial_gym.sensors.encoder.file import Autoencoder, AutoencoderCfg, divergence, negative_evidence


def draw(*shape: int, seed: int = 0) -> torch.Tensor:
    return torch.randn(*shape, dtype=torch.float64, generator=torch.Generator().manual_seed(seed))


def test_divergence_is_that_of_normal_distributions() -> None:
    mean, log_variance = draw(5, 3), draw(5, 3, seed=1)
    expected = kl_divergence(Normal(mean, (0.5 * log_variance).exp()), Normal(0.0, 1.0)).sum(-1)
    torch.testing.assert_close(divergence(mean, log_variance), expected, atol=1e-12, rtol=0.0)


def test_evidence_is_that_of_the_deviation_which_explains_best() -> None:
    """Per image ``-ln p = P/2 (ln(2 pi sigma²) + 1)`` where sigma² is the mean square; the constant is left out."""
    images, decoded = draw(4, 6, 5), draw(4, 6, 5, seed=1)
    empty = torch.zeros(4, 2, dtype=torch.float64)
    sigma = (images - decoded).square().mean().sqrt()
    likelihood = Normal(decoded, sigma).log_prob(images).flatten(1).sum(-1).mean()
    constant = 0.5 * 30 * (torch.log(torch.tensor(2.0 * torch.pi, dtype=torch.float64)) + 1.0)
    result = negative_evidence(images, decoded, empty, empty)
    torch.testing.assert_close(result + constant, -likelihood, atol=1e-9, rtol=0.0)
    for other in (0.9, 1.1):  # no other deviation explains them better
        worse = Normal(decoded, other * sigma).log_prob(images).flatten(1).sum(-1).mean()
        assert worse < likelihood


@pytest.mark.parametrize(("rows", "columns"), [(24, 40), (27, 35), (8, 9), (3, 50), (135, 240)])
def test_images_of_any_size_come_back_in_their_size(rows: int, columns: int) -> None:
    network = Autoencoder(AutoencoderCfg(rows=rows, columns=columns, latents=5, channels=(4, 6, 8)))
    images = torch.rand(2, rows, columns)
    mean, log_variance = network.encode(images)
    assert mean.shape == log_variance.shape == (2, 5)
    assert network.decode(mean).shape == images.shape


def test_impossible_networks_are_refused() -> None:
    with pytest.raises(ConfigError, match="latents = 0: must be >= 1"):
        AutoencoderCfg(rows=8, columns=8, latents=0)
    with pytest.raises(ConfigError, match="channels = .*: needs numbers >= 1"):
        AutoencoderCfg(rows=8, columns=8, channels=())
    with pytest.raises(ConfigError, match="activation = 'selu': must be elu, relu, tanh"):
        AutoencoderCfg(rows=8, columns=8, activation="selu")
