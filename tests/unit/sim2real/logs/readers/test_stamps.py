"""Time stamps: bad ones cost their own rows, a clock that was set back or wrapped goes on, and nothing is sorted."""

from collections.abc import Callable

import numpy as np
import pytest

from aerial_gym.errors import DataError
from aerial_gym.sim2real.logs.readers.live_stamps import LiveStamps
from aerial_gym.sim2real.logs.readers.stamps import correct_stamps, stamp_seconds

ROWS, STEP = 2000, 0.0025
TRUE = 5.0 + STEP * np.arange(ROWS)
Change = Callable[[np.ndarray], list[int]]


def put(rows: list[int], value: Callable[[np.ndarray], object]) -> Change:
    def change(stamps: np.ndarray) -> list[int]:
        stamps[rows] = value(stamps[rows])
        return rows

    return change


def swap(one: int, other: int) -> Change:
    def change(stamps: np.ndarray) -> list[int]:
        stamps[[one, other]] = stamps[[other, one]]
        return [one, other]

    return change


BAD: dict[str, Change] = {
    "absurd": put([300, 301, 900, 1500], lambda t: t + 40.0),
    "far below": put([300, 900], lambda t: t - 1e6),
    "a little ahead": put([300, 900], lambda t: t + 3.5 * STEP),
    "a little behind": put([300, 900], lambda t: t - 3.5 * STEP),
    "uint64 of a negative number": put([300], lambda t: 2.0**64 * 1e-6 - t),
    "zero": put([300, 301, 302, 1500], lambda _: 0.0),
    "a burst of zeros": put(list(range(700, 730)), lambda _: 0.0),
    "missing": put([300, 301, 1500], lambda _: np.nan),
    "first": put([0], lambda _: 0.0),
    "last": put([ROWS - 1], lambda _: 1e9),
    "swapped neighbours": swap(700, 701),
    "swapped far apart": swap(100, 1700),
}


@pytest.mark.parametrize("name", BAD)
def test_a_bad_stamp_costs_its_own_row(name: str) -> None:
    stamps = TRUE.copy()
    bad = BAD[name](stamps)
    result = correct_stamps(stamps, "a")
    np.testing.assert_array_equal(np.flatnonzero(~result.kept), sorted(bad))
    np.testing.assert_array_equal(result.time, np.delete(TRUE, bad))
    assert result.steps == ()


def test_a_clock_that_stands_still_costs_the_rows_that_repeat_it() -> None:
    stamps = TRUE.copy()
    stamps[500:504] = stamps[500]
    result = correct_stamps(stamps, "a")
    np.testing.assert_array_equal(np.flatnonzero(~result.kept), [501, 502, 503])


@pytest.mark.parametrize("back", [4.5 * STEP, 0.05, 2.0, 1e3, 1.7e9])
def test_a_clock_that_was_set_back_goes_on_by_one_step(back: float) -> None:
    stamps = TRUE - back * (np.arange(ROWS) >= 900)
    result = correct_stamps(stamps, "a")
    (step,) = result.steps
    assert result.kept.all()
    assert (step.row, step.counter) == (900, "")
    assert step.shift == pytest.approx(back, abs=1e-6)
    np.testing.assert_allclose(result.time, TRUE, atol=1e-6)


@pytest.mark.parametrize(
    ("counter", "period"),
    [("32 bits of 1 us", 4294.967296), ("16 bits of 1 ms", 65.536), ("the day", 86400.0), ("the GPS week", 604800.0)],
)
def test_a_counter_that_wraps_goes_on_exactly(counter: str, period: float) -> None:
    true = np.delete(TRUE - TRUE[900] + period + 0.5 * STEP, [900, 901])
    result = correct_stamps(true % period, "a")
    assert [step.counter for step in result.steps] == [counter]
    assert result.steps[0].shift == period
    np.testing.assert_allclose(result.time, true, atol=1e-6)


def test_bad_stamps_beside_a_step_of_the_clock() -> None:
    stamps = TRUE - 2.0 * (np.arange(ROWS) >= 900)
    stamps[[880, 905, 1500]] = 0.0, 77.0, 0.0
    result = correct_stamps(stamps, "a")
    np.testing.assert_array_equal(np.flatnonzero(~result.kept), [880, 905, 1500])
    np.testing.assert_allclose(result.time, np.delete(TRUE, [880, 905, 1500]), atol=1e-9)


def test_gaps_and_jitter_are_no_fault() -> None:
    rng = np.random.default_rng(0)
    stamps = np.cumsum(STEP * rng.uniform(0.2, 1.8, ROWS)) + 3.0 * (np.arange(ROWS) > 700)
    result = correct_stamps(stamps, "a")
    assert result.kept.all()
    np.testing.assert_array_equal(result.time, stamps)


@pytest.mark.parametrize(
    "stamps", [-TRUE, np.zeros(50), np.full(50, np.nan), TRUE[:1], np.random.default_rng(0).permutation(TRUE)]
)
def test_stamps_of_no_clock_are_refused(stamps: np.ndarray) -> None:
    with pytest.raises(DataError):
        correct_stamps(stamps, "a")


def test_negative_numbers_in_unsigned_stamps_are_negative() -> None:
    """A clock in microseconds that begins 2 ms before 0, as unsigned numbers of 64 bits."""
    stamps = (np.arange(9) * 1000 - 2000).astype(np.int64).view(np.uint64)
    np.testing.assert_allclose(stamp_seconds(stamps, 1e-6), np.arange(9) * 1e-3 - 2e-3, atol=1e-12)


@pytest.mark.parametrize("name", ["absurd", "far below", "zero", "missing", "swapped far apart"])
def test_rows_that_come_one_by_one_lose_the_bad_ones(name: str) -> None:
    stamps, live = TRUE.copy(), LiveStamps()
    bad = BAD[name](stamps)
    good = [row for number, stamp in enumerate(stamps) for row in live.add_row(np.array([stamp, number]), 0)]
    np.testing.assert_array_equal([row[1] for row in good], np.delete(np.arange(ROWS), bad))
    np.testing.assert_array_equal([row[0] for row in good], np.delete(TRUE, bad))
    assert len(live.bad) == len(bad)
    assert live.steps == 0


def test_rows_that_come_one_by_one_go_on_after_a_gap_and_a_step_of_the_clock() -> None:
    stamps, live = TRUE + 5.0 * (np.arange(ROWS) >= 500) - 9.0 * (np.arange(ROWS) >= 900), LiveStamps()
    good = np.array([row[0] for stamp in stamps for row in live.add_row(np.array([stamp]), 0)])
    assert (live.steps, live.bad) == (1, [])
    np.testing.assert_allclose(good, TRUE + 5.0 * (np.arange(ROWS) >= 500), atol=1e-9)


@pytest.mark.parametrize("first", [[np.nan], [0.0], [0.0, 0.0, 0.0], [1e18], [-1e18, np.nan], [1.7e9, 0.0]])
def test_rows_that_come_one_by_one_lose_bad_stamps_at_the_beginning(first: list[float]) -> None:
    stamps, live = TRUE + 1e9, LiveStamps()
    good = [row[0] for stamp in [*first, *stamps] for row in live.add_row(np.array([stamp]), 0)]
    np.testing.assert_array_equal(good, stamps)
    assert (len(live.bad), live.steps) == (len(first), 0)


@pytest.mark.parametrize("stamp", [np.nan, 3.0, 1e300])
def test_a_clock_that_never_goes_on_gives_no_row(stamp: float) -> None:
    live = LiveStamps()
    assert [row for _ in range(50) for row in live.add_row(np.array([stamp]), 0)] == []
    live.reject_pending_rows(0)
    assert len(live.bad) == 50


@pytest.mark.parametrize("value", [0.0, -5.0, np.nan, 1e9])
@pytest.mark.parametrize("beside", [[-1], [0], [-4], [3], [-9, -5, 7], [1, 2, 3, 4, 5, 6]])
def test_bad_stamps_near_a_step_of_the_clock_cost_no_other_row(beside: list[int], value: float) -> None:
    stamps, bad = TRUE - 2.0 * (np.arange(ROWS) >= 900), [900 + row for row in beside]
    stamps[bad] = value
    result = correct_stamps(stamps, "a")
    np.testing.assert_array_equal(np.flatnonzero(~result.kept), bad)
    np.testing.assert_allclose(result.time, np.delete(TRUE, bad), atol=1e-9)
    assert len(result.steps) == 1
