"""States of a constant, and the mean of estimates."""

import pytest

from aerial_gym.sim2real.preflight.constants import Constant, pool
from aerial_gym.sim2real.statistics import Estimate


def latency(value: float, half_width: float) -> Constant:
    """Return a latency of the state, whose tolerance is 15 ms."""
    estimate = Estimate.from_half_width(value, half_width)
    return Constant(name="attitude_latency", kind="state_latency", declared=0.0, unit="s", estimate=estimate)


@pytest.mark.parametrize(
    ("value", "half_width", "state"),
    [
        (0.014, 0.001, "measured"),
        (0.017, 0.003, "measured"),  # the interval reaches the tolerance
        (0.017, 0.001, "contradicted"),
        (-0.017, 0.001, "contradicted"),
        (0.004, 0.016, "assumed"),  # wider than the tolerance
        (0.040, 0.020, "contradicted"),  # wide, but beyond it
    ],
)
def test_state_of_a_constant(value: float, half_width: float, state: str) -> None:
    assert latency(value, half_width).state == state


def test_a_constant_without_estimate_is_assumed_with_its_reason() -> None:
    finding = Constant(name="rotor_lag", kind="rotor_lag", declared=0.04, reason="no_rotor_speeds").finding()
    assert (finding.code, finding.values["reason"]) == ("constant_assumed", "no_rotor_speeds")


def test_tolerance_of_a_moment_is_relative() -> None:
    assert Constant(name="inertia_roll", kind="inertia", declared=0.002).tolerance == pytest.approx(0.0003)


def test_pool_of_equal_values_has_the_standard_error_of_their_number() -> None:
    """Four estimates of standard deviation s have the mean's deviation s / 2."""
    one = Estimate.from_half_width(2.0, 1.96)
    mean = pool([one] * 4)
    assert mean is not None
    assert (mean.value, mean.high - mean.value) == pytest.approx((2.0, 0.98))


def test_pool_of_values_that_scatter_is_wider() -> None:
    """Values of 0 and 2 with deviations of 0.1 scatter by 199 times their variance beyond it, by one degree of freedom."""
    parts = [Estimate.from_half_width(value, 0.196) for value in (0.0, 2.0)]
    mean, own = pool(parts), pool(parts, scatter=False)
    assert mean is not None
    assert own is not None
    student = 12.7062  # Quantile of 97.5 % of Student's distribution with one degree of freedom
    assert (mean.value, mean.high - mean.value) == pytest.approx((1.0, (0.005 * (1.96**2 + 199.0 * student**2)) ** 0.5))
    assert own.high - own.value == pytest.approx(1.96 * 0.005**0.5)
    assert pool([]) is None
