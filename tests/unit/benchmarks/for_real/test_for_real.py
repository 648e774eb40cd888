"""The committed preflight result of the hidden vehicle, and the interval of the difference."""

from dataclasses import replace
from math import sqrt

import pytest
from scipy.stats import binomtest

from aerial_gym.for_real.plan import plan_training
from aerial_gym.sim2real.preflight.result_file import read_result
from benchmarks.for_real.__main__ import RESULT, difference_interval, policy_task, wilson_interval
from benchmarks.for_real.vehicle import JITTER_S, LATENCY_S


@pytest.mark.parametrize(("successes", "count"), [(0, 5), (5, 5), (3, 7)])
def test_interval_of_a_share_is_that_of_scipy(successes: int, count: int) -> None:
    exact = binomtest(successes, count).proportion_ci(method="wilson")
    assert wilson_interval(successes / count, count) == pytest.approx((exact.low, exact.high))


def test_interval_of_the_difference_is_wide_without_scatter() -> None:
    """Five of five against none of five: 1 - sqrt(2) (1 - 1 / (1 + 1.96² / 5)) to 1."""
    low, high = difference_interval([1.0] * 5, [0.0] * 5)
    assert (low, high) == pytest.approx((1.0 - sqrt(2.0) * (1.0 - 1.0 / (1.0 + 1.959964**2 / 5.0)), 1.0))
    low, high = difference_interval([0.4, 0.6], [0.6, 0.4])
    assert low == pytest.approx(-high)


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
