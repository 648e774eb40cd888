"""The fixed set: the same again, other scenes for another seed, collisions never further than what is seen."""

from dataclasses import replace

import pytest
import torch

from aerial_gym.errors import ConfigError, UnknownNameError
from aerial_gym.rl_training.encoder.scenes import image_sensor, render_images
from aerial_gym.rl_training.encoder.settings import EncoderTrainingCfg

CPU = torch.device("cpu")
CFG = EncoderTrainingCfg(envs=("env_with_obstacles", "forest_env"), train_images=7, test_images=5, device="cpu")


def test_set_is_fixed_by_its_seed_and_shared_between_environments() -> None:
    first, again, other = (render_images(CFG, 7, seed=seed, device=CPU) for seed in (0, 0, 1))
    assert first.seen.shape == (7, 24, 40)
    assert first.env.tolist() == [0, 0, 0, 0, 1, 1, 1]
    assert bool(((first.seen >= 0.0) & (first.seen <= 1.0)).all())
    torch.testing.assert_close(first.seen, again.seen, atol=0.0, rtol=0.0)
    assert not any(torch.equal(actual, reference) for actual in first.seen for reference in other.seen)


def test_collisions_are_nearer_than_what_is_seen() -> None:
    cfg = replace(CFG, envs=("env_with_obstacles",), target="collision", radius_m=0.3)
    result = render_images(cfg, 4, seed=0, device=CPU)
    sees = result.seen < 1.0
    assert bool((result.target <= result.seen).all())
    gap = (result.seen - result.target)[sees] * image_sensor(cfg).max_range
    least_cosine = 0.69  # at the corners of a camera of 87 by 59 degrees: 1 / sqrt(1 + 0.949² + 0.569²) = 0.67
    assert float(gap[result.target[sees] > 0.0].min()) >= 0.3 * least_cosine * 0.95


def test_wrong_requests_are_told() -> None:
    with pytest.raises(ConfigError, match="robot base_quadrotor has no camera or lidar to encode"):
        image_sensor(replace(CFG, robot="base_quadrotor"))
    with pytest.raises(UnknownNameError, match="no environment 'forest'"):
        render_images(replace(CFG, envs=("forest",)), 1, seed=0, device=CPU)
    with pytest.raises(ConfigError, match="target = 'depth': must be distance or collision"):
        replace(CFG, target="depth")
    with pytest.raises(ConfigError, match="an image of each"):
        replace(CFG, test_images=1)
