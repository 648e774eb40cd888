"""Encoders of images: the autoencoder's loss, files, and how far a ball flies along each ray, in closed form."""

from dataclasses import replace
from pathlib import Path

import pytest
import torch
from torch import Tensor
from torch.distributions import Normal, kl_divergence

from aerial_gym.config.sensor import CameraCfg
from aerial_gym.config.storage import write_archive
from aerial_gym.errors import ConfigError, UnknownNameError
from aerial_gym.rl_training.encoder import scenes
from aerial_gym.rl_training.encoder.scenes import collision_distance
from aerial_gym.sensors import pinhole_rays
from aerial_gym.sensors.encoder.file import (
    Autoencoder,
    AutoencoderCfg,
    divergence,
    encoder_file,
    load_encoder,
    negative_evidence,
    normalize_image,
)
from tests.refusals import assert_refused
from tests.unit.sensors.encoder.encoders import ROBOT, coarse_camera, random_encoder


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
    assert_refused(ConfigError, "latents = 0: must be >= 1", AutoencoderCfg, rows=8, columns=8, latents=0)
    assert_refused(ConfigError, "channels = .*: needs numbers >= 1", AutoencoderCfg, rows=8, columns=8, channels=())
    with pytest.raises(ConfigError, match="activation = 'selu': must be elu, relu, tanh"):
        AutoencoderCfg(rows=8, columns=8, activation="selu")


def test_file_holds_what_was_saved(tmp_path: Path) -> None:
    encoder, images = random_encoder(), torch.rand(3, 24, 40)
    encoder.save(tmp_path / "mine.pt")
    result = load_encoder(tmp_path / "mine.pt")
    assert (result.seen, result.cfg, result.trained) == (encoder.seen, encoder.cfg, {"robot": ROBOT})
    torch.testing.assert_close(result(images), encoder(images), atol=0.0, rtol=0.0)


def test_what_is_no_encoder_is_told(tmp_path: Path) -> None:
    path = tmp_path / "x.pt"
    assert_refused(ConfigError, r"encoder .*x\.pt: no such file", load_encoder, path)
    with pytest.raises(UnknownNameError, match=r"no encoder 'nothing'\. Known: .*aerial-gym train-encoder"):
        encoder_file("nothing")
    path.write_bytes(b"nothing")
    assert_refused(ConfigError, "is damaged or no encoder", load_encoder, path)
    write_archive(path, {"model": {}})
    assert_refused(ConfigError, r"holds no encoder \('network'\)\. Train one", load_encoder, path)


def test_encoder_that_diverged_is_refused(tmp_path: Path) -> None:
    encoder = random_encoder()
    next(encoder.layers.parameters()).data[0] = float("nan")
    encoder.save(tmp_path / "x.pt")
    with pytest.raises(ConfigError, match="NaN or infinite"):
        load_encoder(tmp_path / "x.pt")


def test_other_images_are_refused() -> None:
    camera = coarse_camera()
    random_encoder().check_fits(camera, name="camera", label="encoder x")
    told = r"encoder x: knows images of 40 x 24 .*depth to 10 m; sensor eye has .*to 5 m"
    with pytest.raises(ConfigError, match=told):
        random_encoder().check_fits(replace(camera, max_range=5.0), name="eye", label="encoder x")


def test_images_become_shares_of_the_largest_distance() -> None:
    """Of 10 m; where far and near are both -1, a pixel without a distance counts as far."""
    image = torch.tensor([[[0.2, 5.0], [10.0, -1.0]]])
    camera = coarse_camera()
    torch.testing.assert_close(normalize_image(image, camera), torch.tensor([[[0.02, 0.5], [1.0, 1.0]]]))
    normalized = replace(camera, normalize=True)
    torch.testing.assert_close(normalize_image(image / 10.0, normalized)[0, 0], torch.tensor([0.02, 0.5]))
    assert float(normalize_image(image, normalized)[0, 1, 1]) == 0.0  # 1 says far there, so nothing is near


RADIUS, LARGEST = 0.3, 50.0


def ray_row(*angles: float) -> Tensor:
    """Return unit rays in the plane of x and y at some angles [rad], (1, W, 3)."""
    at = torch.tensor(angles, dtype=torch.float64)
    return torch.stack((at.cos(), at.sin(), torch.zeros_like(at)), dim=-1).unsqueeze(0)


def nearest_collision(distances: list[float], *angles: float, radius: float = RADIUS) -> Tensor:
    seen = torch.tensor(distances, dtype=torch.float64).view(1, 1, -1)
    return collision_distance(seen, ray_row(*angles), radius=radius, largest=LARGEST)[0, 0]


def test_ball_touches_a_point_where_its_centre_is_a_radius_away() -> None:
    """|p - t u| = r with p on the second ray: t = p.u - sqrt(r² - |p x u|²) is the smaller root."""
    point, angle = 2.0, 0.1
    t, own = nearest_collision([LARGEST, point], 0.0, angle)
    place = point * ray_row(angle)[0, 0]
    assert float((place - t * ray_row(0.0)[0, 0]).norm()) == pytest.approx(RADIUS, abs=1e-12)
    assert t < point
    assert float(own) == pytest.approx(point - RADIUS, abs=1e-12)


def test_ball_passes_a_point_that_is_further_beside_its_way_than_its_radius() -> None:
    """|p| sin(angle) = 0.31 > 0.3: nothing is touched; at 0.29 it is."""
    assert float(nearest_collision([LARGEST, 0.31 / 0.5], 0.0, torch.pi / 6)[0]) == LARGEST
    assert float(nearest_collision([LARGEST, 0.29 / 0.5], 0.0, torch.pi / 6)[0]) < 0.6


def test_points_behind_are_left_behind_and_points_within_the_ball_stop_it() -> None:
    """A point 120 degrees beside the ray, 0.32 m away, lies closer to its line than r, but the ball moves away from it."""
    assert float(nearest_collision([LARGEST, 0.32], 0.0, 2.0 * torch.pi / 3)[0]) == LARGEST
    assert float(nearest_collision([LARGEST, 0.25], 0.0, 2.0 * torch.pi / 3)[0]) == 0.0


def test_ball_stops_a_radius_before_a_wall() -> None:
    """Before a wall at d the centre of the ball reaches d - r, whatever its direction: t = (d - r) / cos. Points of the
    wall are h apart, so the one that is touched lies within h of the foot of the ball: its centre gets at most ``r -
    sqrt(r² - h²)`` further."""
    camera = CameraCfg(summary="", width=80, height=48, hfov_deg=87.0, min_range=0.2, max_range=10.0, source="")
    rays, wall = pinhole_rays(camera, device=torch.device("cpu")).double(), 3.0
    ahead = rays[..., 0]
    reached = (collision_distance((wall / ahead).unsqueeze(0), rays, radius=RADIUS, largest=LARGEST)[0] * ahead) - wall
    spacing = wall * float(rays[24, 40, 1] / rays[24, 40, 0] - rays[24, 41, 1] / rays[24, 41, 0])
    beyond = RADIUS - (RADIUS**2 - spacing**2) ** 0.5
    inner = reached[8:-8, 8:-8]  # at the edge the foot lies outside of the image
    assert float(inner.min()) >= -RADIUS - 1e-9
    assert float(inner.max()) <= -RADIUS + beyond


def test_images_and_blocks_of_rays_do_not_change_each_other(monkeypatch: pytest.MonkeyPatch) -> None:
    generator = torch.Generator().manual_seed(0)
    rays = torch.nn.functional.normalize(torch.randn(4, 6, 3, generator=generator) + torch.tensor([3.0, 0, 0]), dim=-1)
    seen = 5.0 * torch.rand(7, 4, 6, generator=generator)
    whole = collision_distance(seen, rays, radius=RADIUS, largest=LARGEST)
    monkeypatch.setitem(scenes.PAIRS, "cpu", 50)
    blocks = collision_distance(seen, rays, radius=RADIUS, largest=LARGEST)
    torch.testing.assert_close(blocks, whole, atol=0.0, rtol=0.0)
    assert bool((whole <= seen).all())
