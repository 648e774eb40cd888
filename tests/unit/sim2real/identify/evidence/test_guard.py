"""What an effect must gain on flights left out."""

import numpy as np
import pytest

from aerial_gym.sim2real.identify.evidence.guard import LEAST_RATIO, Predictive, part_length


def test_a_single_flight_that_speaks_for_an_effect_is_just_enough() -> None:
    """One gain and zeros: the sum is its own standard error, whatever the number of flights."""
    for count in (2, 4, 9):
        gains = np.zeros(count)
        gains[0] = 7.0
        assert Predictive(by_part=gains, relief=0.0).ratio == pytest.approx(LEAST_RATIO)


def test_gains_of_both_signs_are_not_enough_and_a_relieved_tolerance_counts() -> None:
    """Flights that contradict each other say nothing; a deviation that is no longer needed is a datum of its own."""
    gains = np.array([5.3, -12.4, 9.2, 1.7])
    assert Predictive(by_part=gains, relief=0.0).ratio < LEAST_RATIO
    assert Predictive(by_part=gains, relief=30.0).ratio > LEAST_RATIO


@pytest.mark.parametrize(("flights", "seconds"), [(1, 4.0), (2, 8.0), (3, 8.0), (4, np.inf), (7, np.inf)])
def test_few_flights_are_left_out_in_parts(flights: int, seconds: float) -> None:
    """Four parts at least: quarters of one flight of 16 s, halves of two or three."""
    times = [np.linspace(0.0, 16.0, 1601)] * flights
    assert part_length(times) == pytest.approx(seconds)
