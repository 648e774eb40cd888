"""Errors by hand, and principal components against what they must do."""

import pytest
import torch
from torch import Tensor

from aerial_gym.rl_training.encoder import figures
from aerial_gym.rl_training.encoder.figures import image_errors, reconstruct_by_components, reconstruct_by_mean
from aerial_gym.rl_training.encoder.scenes import ImageSet


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


def test_components_of_images_tell_another_target_by_least_squares() -> None:
    images = draw_images(3)
    target = 1.0 - 0.5 * images.flip(2)
    told = reconstruct_by_components(make_images(images, target), 3)(images)
    torch.testing.assert_close(told, target, atol=2e-5, rtol=0.0)


def test_mean_is_the_mean_of_the_targets() -> None:
    images = draw_images(3)
    told = reconstruct_by_mean(make_images(images, 2.0 * images))(images[:2])
    torch.testing.assert_close(told[1], 2.0 * images.mean(0))
