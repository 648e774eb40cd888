"""Wind at two vehicles in the same flights: the same, each one's own, or not to be told."""

from dataclasses import replace

import numpy as np
import pytest

from aerial_gym.sim2real.findings import Finding
from aerial_gym.sim2real.judge.outcome import Decision
from aerial_gym.sim2real.judge.random_wind.common_wind import CommonWind, correlation_of_winds, winds_of_pairs
from aerial_gym.sim2real.judge.random_wind.gusts import RandomWind
from aerial_gym.sim2real.judge.random_wind.ornstein_uhlenbeck import ProcessFit, WindSeries
from aerial_gym.sim2real.logs.recording import PairMember
from tests.unit.sim2real.judge.random_wind.test_gusts import BAND, STEP, TIME, draw_wind
from tests.unit.sim2real.predict.test_scene import hover

FIT = ProcessFit(std=1.0, corr_time=1.0, noise=np.full(3, 0.1), likelihood=0.0)
SERIES = WindSeries(wind=[], features={}, step=STEP, bandwidth=BAND)


def pairs(
    share: float, *, flights: int = 4, seed: int = 0, rows: int = TIME.size
) -> list[tuple[np.ndarray, np.ndarray]]:
    """Return winds with a correlation ``share`` of both vehicles, and white noise of 0.1 m/s of each one's own."""
    rng, results = np.random.default_rng(seed), []
    for _ in range(flights):
        common = np.sqrt(share) * draw_wind(rng, TIME[:rows], 1.0, 1.0)
        own = [np.sqrt(1.0 - share) * draw_wind(rng, TIME[:rows], 1.0, 1.0) for _ in range(2)]
        results.append(tuple(common + one + 0.1 * rng.standard_normal((rows, 3)) for one in own))
    return results


@pytest.mark.parametrize(("share", "code"), [(1.0, "gusts_shared"), (0.0, "gusts_separate"), (0.8, "gusts_shared")])
def test_the_correlation_of_both_winds_is_found(share: float, code: str) -> None:
    for seed in range(3):
        result = correlation_of_winds(pairs(share, seed=seed), SERIES, FIT)
        assert result.interval[0] - 0.03 <= share <= result.interval[1] + 0.03
        assert result.finding.code == code


def test_short_flights_do_not_tell() -> None:
    """0.4 s of wind with a correlation time of one second hold little beside the mean, which is unknown."""
    for seed in range(3):
        result = correlation_of_winds(pairs(0.5, flights=1, rows=4, seed=seed), SERIES, FIT)
        assert result.interval[1] - result.interval[0] > 0.5
        assert result.finding.code == "gusts_undecided"


def test_gusts_that_may_be_shared_or_not_are_ambiguous() -> None:
    still = Decision(kind="none", candidates=(), findings=())
    wind = RandomWind(std=1.0, common=CommonWind(correlation=0.5, interval=(0.1, 0.9), probability=0.6))
    assert wind.decision(still).kind == "ambiguous"
    assert wind.decision(still).candidates == ("gusts",)
    sure = replace(wind, common=CommonWind(correlation=0.95, interval=(0.9, 1.0), probability=1.0))
    assert sure.decision(still).kind == "explained"
    assert Finding("gusts_shared", "gusts", {}).code in [note.code for note in sure.notes]


def test_winds_are_compared_on_the_common_clock() -> None:
    """The second log starts 2 s later by the common clock: its row 0 is beside the first log's at 2 s."""
    time, wind = np.arange(400) / 100.0, np.arange(400.0)[:, None] * np.ones(3)
    members = [PairMember(pair=3, vehicle=vehicle, clock=clock) for vehicle, clock in ((0, 5.0), (1, 7.0))]
    flights = [replace(hover("ab"[k], 1.0), pair=member) for k, member in enumerate(members)]
    ((first, second),) = winds_of_pairs(flights, [time, time], [wind, wind], 0.1)
    np.testing.assert_allclose(first[:, 0], np.arange(200.0, 399.5, 10.0), atol=1e-9)
    np.testing.assert_allclose(second[:, 0], np.arange(0.0, 199.5, 10.0), atol=1e-9)
    assert winds_of_pairs(flights[:1], [time], [wind], 0.1) == []
