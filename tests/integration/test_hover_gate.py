"""What is said of a robot under its controller before it flies, against flights of 200 random combinations."""

import pytest

from benchmarks.control.hover_gate import EACH, cases

LEAST_AGREEMENT = 0.95  # Share of the accepted that hover within 0.1 m, and of the others that do not


@pytest.mark.slow
@pytest.mark.parametrize("seed", [0])
def test_the_check_agrees_with_flights_in_both_directions(seed: int) -> None:
    """25 groups of a robot, a law, a time step and an effect, of eight dead times of 0 to 50 ms and parameters each."""
    result = list(cases(seed, 25))
    assert len(result) == 25 * EACH
    for accepted in (True, False):
        subset = [case for case in result if case.accepted is accepted]
        assert len(subset) > 0.2 * len(result)
        assert sum(case.hovers is accepted for case in subset) >= LEAST_AGREEMENT * len(subset)
    refused = [case for case in result if case.refused]
    assert sum(not case.hovers for case in refused) >= LEAST_AGREEMENT * len(refused)
