"""Encoders learn from a fixed set of scenes; errors by hand, and principal components against what they must do."""

from dataclasses import replace
from math import log

import pytest
import torch
from torch import Tensor

from aerial_gym.errors import ConfigError, UnknownNameError
from aerial_gym.rl_training.encoder import figures
from aerial_gym.rl_training.encoder.figures import image_errors, reconstruct_by_components, reconstruct_by_mean
from aerial_gym.rl_training.encoder.scenes import ImageSet, image_sensor, render_images
from aerial_gym.rl_training.encoder.settings import EncoderTrainingCfg
from aerial_gym.rl_training.encoder.training import EncoderFit
from tests.refusals import assert_refused

CFG = EncoderTrainingCfg(train_images=64, test_images=8, epochs=6, batch=16, latents=4, channels=(4, 8))


def edges(count: int = 64) -> ImageSet:
    """Return images of an edge between near and far at a drawn column, (N, 8, 12)."""
    at = torch.randint(1, 11, (count, 1, 1), generator=torch.Generator().manual_seed(0))
    seen = torch.where(torch.arange(12) < at, 0.2, 0.9).expand(count, 8, 12).contiguous()
    return ImageSet(seen=seen, target=seen, env=torch.zeros(count))


def test_learns_more_than_the_mean_image() -> None:
    images = edges()
    fit = EncoderFit(replace(CFG, epochs=60, learning_rate=3e-3), images)
    losses = [fit.run_epoch() for _ in range(60)]
    deviation = float((images.target - images.target.mean(0)).square().mean().sqrt())
    assert losses[0] > 96.0 * log(deviation) - 1.0
    assert losses[-1] < 96.0 * log(0.5 * deviation)


def test_going_on_is_as_if_it_had_never_ended() -> None:
    whole, first, second = (EncoderFit(CFG, edges()) for _ in range(3))
    for fit, epochs in ((whole, 4), (first, 2)):
        for _ in range(epochs):
            fit.run_epoch()
    second.load(first.state())
    for _ in range(2):
        second.run_epoch()
    for actual, reference in zip(whole.network.parameters(), second.network.parameters(), strict=True):
        torch.testing.assert_close(actual, reference, atol=0.0, rtol=0.0)


def make_images(seen: Tensor, target: Tensor | None = None) -> ImageSet:
    return ImageSet(seen=seen, target=seen if target is None else target, env=torch.zeros(len(seen)))


def draw_images(rank: int, count: int = 200) -> Tensor:
    """Return images (count, 4, 6) about a mean in a space of a rank."""
    generator = torch.Generator().manual_seed(0)
    basis = torch.randn(rank, 24, generator=generator)
    return 0.5 + 0.05 * (torch.randn(count, rank, generator=generator) @ basis).view(count, 4, 6)


def test_errors_are_in_metres_and_near_pixels_apart() -> None:
    """Pixels at 1, 2, 6 and 8 m of 10, wrong by 0.1, 0.3, 1 and 0 m; what is told beyond the limits counts as the limit."""
    target = torch.tensor([[[0.1, 0.2], [0.6, 1.0]]])
    told = torch.tensor([[[0.11, 0.17], [0.7, 1.5]]])
    result = image_errors(told, target, largest=10.0)
    assert result.rms_m == pytest.approx(((0.01 + 0.09 + 1.0) / 4.0) ** 0.5, rel=1e-5)
    assert result.mean_m == pytest.approx(1.4 / 4.0, rel=1e-5)
    assert result.near_rms_m == pytest.approx(0.05**0.5, rel=1e-5)
    assert image_errors(told[:, 1:], target[:, 1:], largest=10.0).near_rms_m is None


@pytest.mark.parametrize("most_exact", [4096, 1], ids=["covariance", "randomised"])
def test_components_tell_all_of_what_has_their_rank(most_exact: int, monkeypatch: pytest.MonkeyPatch) -> None:
    """Images of rank 3 are told exactly by 3 components, also ones that were not seen; 2 leave the third variance."""
    monkeypatch.setattr(figures, "MOST_EXACT", most_exact)
    images = draw_images(3)
    told = reconstruct_by_components(make_images(images[:100]), 3)(images[100:])
    torch.testing.assert_close(told, images[100:], atol=2e-5, rtol=0.0)
    centred = (images - images.mean(0)).flatten(1)
    left = torch.linalg.svdvals(centred.double())[2:].square().sum() / centred.numel()
    result = (reconstruct_by_components(make_images(images), 2)(images) - images).square().mean()
    assert float(result) == pytest.approx(float(left), rel=1e-3)


def test_components_and_means_of_images_tell_another_target() -> None:
    images = draw_images(3)
    target = 1.0 - 0.5 * images.flip(2)
    told = reconstruct_by_components(make_images(images, target), 3)(images)
    torch.testing.assert_close(told, target, atol=2e-5, rtol=0.0)
    images = draw_images(3)
    told = reconstruct_by_mean(make_images(images, 2.0 * images))(images[:2])
    torch.testing.assert_close(told[1], 2.0 * images.mean(0))


CPU = torch.device("cpu")
SCENES_CFG = EncoderTrainingCfg(envs=("env_with_obstacles", "forest_env"), train_images=7, test_images=5, device="cpu")


def test_set_is_fixed_by_its_seed_and_shared_between_environments() -> None:
    first, again, other = (render_images(SCENES_CFG, 7, seed=seed, device=CPU) for seed in (0, 0, 1))
    assert first.seen.shape == (7, 24, 40)
    assert first.env.tolist() == [0, 0, 0, 0, 1, 1, 1]
    assert bool(((first.seen >= 0.0) & (first.seen <= 1.0)).all())
    torch.testing.assert_close(first.seen, again.seen, atol=0.0, rtol=0.0)
    assert not any(torch.equal(actual, reference) for actual in first.seen for reference in other.seen)


def test_collisions_are_nearer_than_what_is_seen() -> None:
    cfg = replace(SCENES_CFG, envs=("env_with_obstacles",), target="collision", radius_m=0.3)
    result = render_images(cfg, 4, seed=0, device=CPU)
    sees = result.seen < 1.0
    assert bool((result.target <= result.seen).all())
    gap = (result.seen - result.target)[sees] * image_sensor(cfg).max_range
    least_cosine = 0.69  # at the corners of a camera of 87 by 59 degrees: 1 / sqrt(1 + 0.949² + 0.569²) = 0.67
    assert float(gap[result.target[sees] > 0.0].min()) >= 0.3 * least_cosine * 0.95


def test_wrong_requests_are_told() -> None:
    assert_refused(ConfigError, "robot base_quadrotor", image_sensor, replace(SCENES_CFG, robot="base_quadrotor"))
    with pytest.raises(UnknownNameError, match="no environment 'forest'"):
        render_images(replace(SCENES_CFG, envs=("forest",)), 1, seed=0, device=CPU)
    assert_refused(
        ConfigError, "target = 'depth': must be one of distance, collision", replace, SCENES_CFG, target="depth"
    )
    assert_refused(ConfigError, "an image of each", replace, SCENES_CFG, test_images=1)
