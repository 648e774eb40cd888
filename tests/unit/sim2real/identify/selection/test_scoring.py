"""Gains on flights left out, from squares that are written down."""

from dataclasses import replace

import numpy as np
import pytest

from aerial_gym.sim2real.identify.least_squares.moments import Weighting
from aerial_gym.sim2real.identify.selection.scoring import CrossValidation
from aerial_gym.sim2real.predict.channels import Channel
from tests.unit.sim2real.set_fits import make_left_out

BLOCKS, FLIGHTS = 8, 4


def left_out() -> CrossValidation:
    """Return four flights of eight blocks of 60 rows, two channels, nothing tolerated."""
    blocks = BLOCKS * FLIGHTS
    channels = tuple(Channel(kind="specific_force", axis=axis) for axis in "xy")
    weights = Weighting(variance=np.ones(2), effective=np.full(2, 0.5))
    return make_left_out(weights, np.full(blocks, 60.0), np.repeat(np.arange(FLIGHTS), BLOCKS), channels)


def squares(*factors: float) -> np.ndarray:
    """Return squares that are ``factors`` of one in each flight, in the first channel."""
    result = np.ones((BLOCKS * FLIGHTS, 2))
    result[:, 0] = np.repeat(factors, BLOCKS)
    return result


@pytest.mark.parametrize(
    ("factors", "share"),
    [
        ((0.2, 0.2, 0.2, 0.2), 1.0),
        ((0.2, 0.2, 1.01, 1.01), 1.0),  # still air shows no drag: a change of 1 % says nothing
        ((0.2, 0.2, 1.2, 1.2), 0.5),
        ((0.2, 1.01, 1.01, 1.01), 0.25),  # one flight alone is no evidence
    ],
)
def test_a_flight_that_does_not_show_an_effect_does_not_speak_against_it(factors, share) -> None:
    assert left_out().gain(squares(1.0, 1.0, 1.0, 1.0), squares(*factors)).flights_better == share


def test_the_fall_of_a_channel_is_that_of_its_rms() -> None:
    gain = left_out().gain(squares(1.0, 1.0, 1.0, 1.0), squares(0.25, 0.25, 0.25, 0.25))
    assert gain.falls == pytest.approx((0.5, 0.0))
    assert gain.score == pytest.approx(0.5 * 60 * BLOCKS * FLIGHTS * 0.5 * np.log(4.0))


@pytest.mark.parametrize(
    ("gained", "lost", "harmful"),
    [
        (0.25, 1.02, False),  # 1 % of the rms is no harm
        (0.25, 1.12, False),  # 4 log 2 are gained for each log 1.12 that is lost
        (0.25, 1.2, True),  # more than a tenth of the gain
        (0.9, 1.12, True),
        (1.0, 1.12, True),
    ],
)
def test_what_a_channel_loses_is_harm_unless_others_gain_ten_times_as_much(gained, lost, harmful) -> None:
    more = squares(*[gained] * FLIGHTS)
    more[:, 1] = lost
    judge = left_out()
    result = judge.gain(squares(*[1.0] * FLIGHTS), more)
    assert result.worse == (False, harmful)
    assert result.harmed == (0.0, float(harmful))
    assert bool(judge.findings_on_harm(result)) is harmful


@pytest.mark.parametrize(
    ("factors", "tolerated", "said"),
    [
        ((0.2, 0.2, 0.2, 0.2), 0.0, []),
        ((0.2, 0.2, 0.2, 0.2), 2.0, [("gain_small", 0.553)]),
        ((0.2, 0.2, 1.2, 1.2), 0.0, [("few_flights_better", 0.5), ("channel_worse_in_flights", 0.5)]),
        ((1.0, 1.0, 1.0, 1.0), 0.0, [("gain_by_chance", None), ("few_flights_better", 0.0), ("gain_small", 0.0)]),
        (
            (1.3, 1.3, 1.3, 1.3),
            0.0,
            [("gain_by_chance", None), ("few_flights_better", 0.0), ("gain_small", 0.0), ("channel_worse", 0.14)],
        ),
    ],
)
def test_why_a_gain_on_flights_left_out_does_not_count(factors: tuple, tolerated: float, said: list[tuple]) -> None:
    """A fall of the mean square to a fifth is one of the rms by 1 - sqrt(0.2); a rise to 1.3 one by sqrt(1.3) - 1."""
    judge = replace(left_out(), tolerated=np.full(2, tolerated))
    result = judge.objections(judge.gain(squares(1.0, 1.0, 1.0, 1.0), squares(*factors)))
    assert [one.code for one in result] == [code for code, _ in said]
    shares = [(one.values["share"], share) for one, (_, share) in zip(result, said, strict=True) if share is not None]
    assert all(share == pytest.approx(expected, abs=1e-3) for share, expected in shares)
