"""Encoder files: what goes in comes out, what is none is told by name, and images become shares."""

from dataclasses import replace
from pathlib import Path

import pytest
import torch

from aerial_gym.config.storage import write_archive
from aerial_gym.errors import ConfigError, UnknownNameError
from aerial_gym.sensors.encoder.file import encoder_file, load_encoder, normalize_image
from tests.unit.sensors.encoder.encoders import ROBOT, coarse_camera, random_encoder


def test_file_holds_what_was_saved(tmp_path: Path) -> None:
    encoder, images = random_encoder(), torch.rand(3, 24, 40)
    encoder.save(tmp_path / "mine.pt")
    result = load_encoder(tmp_path / "mine.pt")
    assert (result.seen, result.cfg, result.trained) == (encoder.seen, encoder.cfg, {"robot": ROBOT})
    torch.testing.assert_close(result(images), encoder(images), atol=0.0, rtol=0.0)


def test_what_is_no_encoder_is_told(tmp_path: Path) -> None:
    path = tmp_path / "x.pt"
    with pytest.raises(ConfigError, match=r"encoder .*x\.pt: no such file"):
        load_encoder(path)
    with pytest.raises(UnknownNameError, match=r"no encoder 'nothing'\. Known: .*aerial-gym train-encoder"):
        encoder_file("nothing")
    path.write_bytes(b"nothing")
    with pytest.raises(ConfigError, match="is damaged or no encoder"):
        load_encoder(path)
    write_archive(path, {"model": {}})
    with pytest.raises(ConfigError, match=r"holds no encoder \('network'\)\. Train one"):
        load_encoder(path)


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
