"""What a verdict says of the test flights follows from the numbers: nothing that gets worse is passed over."""

import numpy as np
import pytest

from aerial_gym.sim2real.statistics import rise_with_interval
from tests.unit.sim2real.judge.builders import make_outcome


@pytest.mark.parametrize(
    ("rise", "state", "suspect"),
    [
        ((0.62, 0.4, 0.9), "worse", False),
        ((0.09, -0.16, 0.37), "not shown", True),
        ((-0.09, -0.37, 0.16), "not shown", False),
        ((-0.3, -0.4, -0.1), "better", False),
        ((0.01, 0.002, 0.02), "same", False),  # certain, and a trifle
        ((0.0, 0.0, 0.0), "same", False),
        ((0.04, 0.01, 0.08), "worse", False),
        ((0.2, -1.0, np.inf), "not shown", True),
    ],
)
def test_a_change_is_called_what_its_interval_shows(rise: tuple, state: str, suspect: bool) -> None:
    result = make_outcome("x", *rise)
    assert (result.state, result.is_possibly_worse) == (state, suspect)


def test_an_outcome_of_a_rollout_has_its_horizon_in_its_name() -> None:
    assert make_outcome("specific_force.x", 0.1, 0.0, 0.2).name == "specific_force.x"
    assert make_outcome("free.velocity", 0.1, 0.0, 0.2, 0.5).name == "free.velocity.0.5"


def test_an_interval_over_flights_holds_where_flights_differ() -> None:
    """Each flight has a ratio of its own, with a standard deviation of 0.3 in its logarithm about log 1.2; blocks within a
    flight agree. 95 % of the intervals must hold the rms of the ratios, 1.2 exp(0.3^2): 400 trials of 8 flights, 380 +- 4.4,
    a little less since few flights scatter skewed."""
    inside, rng, truth = 0, np.random.default_rng(3), 1.2 * np.exp(0.3**2) - 1.0
    flight, group = np.repeat(np.arange(8), 100), np.repeat(np.arange(80), 10)
    for _ in range(400):
        ratio = 1.2 * np.exp(0.3 * rng.standard_normal(8))
        reference = rng.standard_normal((800, 1))
        (rise,) = rise_with_interval(ratio[flight][:, None] * reference, reference, group, flight)
        inside += rise.low < truth < rise.high
    assert 0.90 * 400 <= inside <= 0.985 * 400


def test_one_block_has_no_interval() -> None:
    values = np.ones((5, 1))
    (rise,) = rise_with_interval(2.0 * values, values, np.zeros(5, dtype=int), np.zeros(5, dtype=int))
    assert (rise.value, rise.low) == (pytest.approx(1.0), -1.0)
    assert rise.as_mapping()["interval"] == [-1.0, None]
