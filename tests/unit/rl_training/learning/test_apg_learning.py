"""Analytic policy gradients learn: a short training with the settings that come with the package, the same in every run."""

from dataclasses import replace

import pytest

from aerial_gym import task_registry
from aerial_gym.rl_training import evaluate, load_settings, settings_for
from aerial_gym.rl_training.trainers.apg import ApgTrainer

UPDATES = 30
"""About 8 s of one core: half of what brings the error to 0.02 m."""


@pytest.mark.slow
def test_seconds_of_training_bring_the_robot_to_its_target() -> None:
    """Within 0.25 m in the last second, metres away untrained: twice as far as the furthest of five seeds (0.11 m)."""
    cfg = load_settings(settings_for("apg", "smooth_position_setpoint_task"))
    steps = cfg.num_envs * cfg.apg.horizon
    cfg = replace(cfg, device="cpu", seed=1, max_time_s=None, max_env_steps=UPDATES * steps)
    with (
        task_registry.make_task(cfg.task, num_envs=64, device="cpu", seed=9) as fresh,
        task_registry.make_task(cfg.task, num_envs=cfg.num_envs, device="cpu", seed=1, differentiable=True) as task,
    ):
        training = ApgTrainer().make_training(cfg, task)
        policy = training.learner.network.actor
        before = evaluate(policy, fresh)
        assert before.final_error_mean_m is None or before.final_error_mean_m > 1.0
        for _ in range(UPDATES):
            training.advance()
        result = evaluate(policy, fresh)
    assert result.crash_rate == 0.0
    assert result.final_error_mean_m < 0.25
