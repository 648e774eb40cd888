"""The committed preflight result of the hidden vehicle, and the interval of the difference."""

from dataclasses import replace
from math import inf

import numpy as np
import pytest
from scipy.stats import ttest_ind

from aerial_gym.for_real.plan import plan_training
from aerial_gym.sim2real.preflight.result_file import read_result
from benchmarks.for_real.__main__ import RESULT, policy_task, welch_interval
from benchmarks.for_real.vehicle import JITTER_S, LATENCY_S


def test_interval_of_the_difference_is_that_of_scipy() -> None:
    first, second = np.random.default_rng(0).uniform(size=(2, 5))
    exact = ttest_ind(first, second, equal_var=False).confidence_interval()
    assert welch_interval(first.tolist(), second.tolist()) == pytest.approx((exact.low, exact.high))
    assert welch_interval([1.0] * 5, [0.0] * 5) == (1.0, 1.0)
    assert welch_interval([1.0], [0.0]) == (-inf, inf)


def test_training_by_the_log_of_the_hidden_vehicle_contains_its_truth() -> None:
    """Latency and the width of its jitter lie in the drawn steps; thrust per weight and exponent in the drawn ranges."""
    plan = plan_training(policy_task(), read_result(RESULT))
    cfg, _, env, sim = replace(policy_task(), settings=plan.settings).configurations()
    step = sim.dt * env.physics_steps_per_env_step
    assert isinstance(cfg.action.delay_steps, tuple)
    assert cfg.action.delay_steps[0] * step <= LATENCY_S
    assert cfg.action.delay_steps[1] * step >= LATENCY_S + 12.0**0.5 * JITTER_S
    drawn = cfg.randomize["effects.thrust_coefficient.scale"]
    assert drawn.low <= 1.0 / 1.08 <= drawn.high  # type: ignore[operator]
    assert plan.corrections == ()
