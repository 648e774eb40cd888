"""Learning: the loss falls, and what goes on from a state is what never ended."""

from dataclasses import replace
from math import log

import torch

from aerial_gym.rl_training.encoder.fit import EncoderFit
from aerial_gym.rl_training.encoder.scenes import ImageSet
from aerial_gym.rl_training.encoder.settings import EncoderTrainingCfg

CFG = EncoderTrainingCfg(train_images=64, test_images=8, epochs=6, batch=16, latents=4, channels=(4, 8))


def edges(count: int = 64) -> ImageSet:
    """Return images of an edge between near and far at a drawn column, (N, 8, 12)."""
    at = torch.randint(1, 11, (count, 1, 1), generator=torch.Generator().manual_seed(0))
    seen = torch.where(torch.arange(12) < at, 0.2, 0.9).expand(count, 8, 12).contiguous()
    return ImageSet(seen=seen, target=seen, env=torch.zeros(count))


def test_learns_more_than_the_mean_image() -> None:
    images = edges()
    fit = EncoderFit(replace(CFG, epochs=60, learning_rate=3e-3), images)
    losses = [fit.epoch() for _ in range(60)]
    deviation = float((images.target - images.target.mean(0)).square().mean().sqrt())
    assert losses[0] > 96.0 * log(deviation) - 1.0
    assert losses[-1] < 96.0 * log(0.5 * deviation)


def test_going_on_is_as_if_it_had_never_ended() -> None:
    whole, first, second = (EncoderFit(CFG, edges()) for _ in range(3))
    for fit, epochs in ((whole, 4), (first, 2)):
        for _ in range(epochs):
            fit.epoch()
    second.load(first.state())
    for _ in range(2):
        second.epoch()
    for actual, reference in zip(whole.network.parameters(), second.network.parameters(), strict=True):
        torch.testing.assert_close(actual, reference, atol=0.0, rtol=0.0)


def test_seed_says_all() -> None:
    def train(seed: int) -> torch.Tensor:
        fit = EncoderFit(replace(CFG, seed=seed), edges())
        fit.epoch()
        return fit.network.mean.weight.detach()

    torch.testing.assert_close(train(3), train(3), atol=0.0, rtol=0.0)
    assert not torch.equal(train(3), train(4))
