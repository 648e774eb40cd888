"""Analytic policy gradients learn: a short training of a small task, the same in every run."""

from dataclasses import replace

import pytest
import torch

from aerial_gym import task_registry
from aerial_gym.config.task_terms import ObservationCfg, RewardCfg
from aerial_gym.rl_training import evaluate
from aerial_gym.rl_training.trainers.apg import make_training
from tests.unit.rl_training.learning.test_apg import settings
from tests.unit.task.hover import built


@pytest.mark.slow
def test_seconds_of_training_bring_the_robot_closer_to_its_target() -> None:
    """Commanded by velocity, with a reward that has a slope everywhere and a window that is as long as the discount sees."""
    cfg = settings(16, horizon=80, learning_rate=0.01, end_learning_rate=0.001, discount=0.94, reward_scale=0.3)
    cfg = replace(cfg, max_env_steps=16 * 80 * 12)
    hover = replace(
        task_registry.get(cfg.task),
        controller="lee_velocity_control",
        episode_len_steps=300,
        observations={"policy": (ObservationCfg(term="position_error_body"), ObservationCfg(term="lin_vel_body"))},
        rewards={"near": RewardCfg(term="distance_bell", params={"height": 1.0, "width": 0.5})},
    )
    fresh, training = built(hover, 64, seed=9), make_training(cfg, built(hover, 16, gradients=torch.float32))
    policy = training.learner.network.actor
    untrained = evaluate(policy, fresh).final_error_mean_m
    for _ in range(12):
        training.advance()
    trained = evaluate(policy, fresh).final_error_mean_m
    assert untrained is not None
    assert trained is not None
    assert trained < 0.6 * untrained
