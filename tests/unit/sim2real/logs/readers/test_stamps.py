"""Time stamps: bad ones cost their own rows, clocks are corrected, and blocks that were written late are put in order."""

from collections.abc import Callable

import numpy as np
import pytest

from aerial_gym.errors import DataError
from aerial_gym.sim2real.logs.readers.stamps import (
    COUNTERS_S,
    LiveStamps,
    correct_stamps,
    find_disordered_blocks,
    stamp_seconds,
)

ROWS, STEP = 3000, 0.0025
Change = Callable[[np.ndarray], list[int]]


def true_time(jitter: float = 0.0, seed: int = 0) -> np.ndarray:
    return 5.0 + STEP * (np.arange(ROWS) + jitter * np.random.default_rng(seed).uniform(-1.0, 1.0, ROWS))


TRUE = true_time()


def live(stamps: np.ndarray) -> tuple[np.ndarray, LiveStamps]:
    """Return the rows of a stream that pass the reader, each with time and number, and the reader."""
    reader = LiveStamps()
    rows = [row for number, stamp in enumerate(stamps) for row in reader.add_row(np.array([stamp, number]), 0)]
    reader.reject_pending_rows(0)
    return np.array(rows), reader


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
    stamps = TRUE.copy()
    bad = BAD[name](stamps)
    rows, reader = live(stamps)
    np.testing.assert_array_equal(rows[:, 1], np.delete(np.arange(ROWS), bad))
    np.testing.assert_array_equal(rows[:, 0], np.delete(TRUE, bad))
    assert (len(reader.bad), reader.steps) == (len(bad), 0)


@pytest.mark.parametrize("first", [[np.nan], [0.0], [0.0, 0.0, 0.0], [1e18], [-1e18, np.nan], [1.7e9, 0.0]])
def test_rows_that_come_one_by_one_lose_bad_stamps_at_the_beginning(first: list[float]) -> None:
    rows, reader = live(np.array([*first, *(TRUE + 1e9)]))
    np.testing.assert_array_equal(rows[:, 0], TRUE + 1e9)
    assert (len(reader.bad), reader.steps) == (len(first), 0)


@pytest.mark.parametrize("stamp", [np.nan, 3.0, 1e300])
def test_a_clock_that_never_goes_on_gives_no_row(stamp: float) -> None:
    rows, reader = live(np.full(50, stamp))
    assert (len(rows), len(reader.bad)) == (0, 50)


@pytest.mark.parametrize("value", [0.0, -5.0, np.nan, 1e9])
@pytest.mark.parametrize("beside", [[-1], [0], [-4], [3], [-9, -5, 7], [1, 2, 3, 4, 5, 6]])
def test_bad_stamps_near_a_step_of_the_clock_cost_no_other_row(beside: list[int], value: float) -> None:
    stamps, bad = TRUE - 2.0 * (np.arange(ROWS) >= 900), [900 + row for row in beside]
    stamps[bad] = value
    result = correct_stamps(stamps, "a")
    np.testing.assert_array_equal(np.flatnonzero(~result.kept), bad)
    np.testing.assert_allclose(result.time, np.delete(TRUE, bad), atol=1e-9)
    assert len(result.steps) == 1


SIZES = [2, 9, 35, 300]


def swap_blocks(start: int, first: int, second: int, order: np.ndarray | None = None) -> np.ndarray:
    """Return the order of rows in which the block of ``first`` rows from ``start`` on stands after the next ``second``."""
    result = np.arange(ROWS) if order is None else order.copy()
    middle, end = start + first, start + first + second
    result[start:end] = np.concatenate((result[middle:end], result[start:middle]))
    return result


@pytest.mark.parametrize("jitter", [0.0, 0.3])
@pytest.mark.parametrize("start", [0, 700, -1], ids=["start", "middle", "end"])
@pytest.mark.parametrize("second", SIZES)
@pytest.mark.parametrize("first", SIZES)
def test_two_exchanged_blocks_are_put_in_order(first: int, second: int, start: int, jitter: float) -> None:
    true = true_time(jitter)
    start = ROWS - first - second if start < 0 else start
    order = swap_blocks(start, first, second)
    result = correct_stamps(true[order], "a")
    np.testing.assert_array_equal(result.time, true)
    np.testing.assert_array_equal(order[result.order], np.arange(ROWS))
    assert result.kept.all()
    assert result.steps == ()
    assert result.late.tolist() == [start + second]


def test_several_exchanges_and_bad_stamps_among_them() -> None:
    true = true_time(0.2)
    order = swap_blocks(2400, 35, 35, swap_blocks(1000, 300, 40, swap_blocks(200, 20, 2)))
    stamps = true[order]
    bad = [300, 1010, 1150, 2410]
    stamps[bad] = 0.0, np.nan, 77.0, -5.0
    result = correct_stamps(stamps, "a")
    np.testing.assert_array_equal(result.time, np.delete(true, order[bad]))
    np.testing.assert_array_equal(np.sort(result.order[~result.kept]), bad)
    assert result.late.size == 3


def test_three_blocks_in_any_order_are_put_in_order() -> None:
    true, rows = true_time(), np.arange(ROWS)
    for blocks in ((1, 2, 0), (2, 0, 1), (2, 1, 0)):
        middle = [rows[900 + 40 * b : 940 + 40 * b] for b in blocks]
        order = np.concatenate((rows[:900], *middle, rows[1020:]))
        np.testing.assert_array_equal(correct_stamps(true[order], "a").time, true)


def test_a_late_block_after_lost_rows_is_put_in_order() -> None:
    true = true_time()
    kept = np.r_[:720, 740:820, 840:ROWS]
    order = swap_blocks(700, 100, 100)
    stamps = true[order][np.isin(order, kept)]
    result = correct_stamps(stamps, "a")
    np.testing.assert_array_equal(result.time, true[kept])
    assert result.late.size == 1


@pytest.mark.parametrize("ahead", [0, 100, 700])
@pytest.mark.parametrize("back", [10.5, 41.0, 300.0, 400.0, 1e4])
def test_a_clock_that_was_set_back_is_not_sorted(back: float, ahead: int) -> None:
    """By ``back`` steps at row 1500, also where it was set ahead 200 rows before."""
    stamps = true_time() + STEP * (ahead * (np.arange(ROWS) >= 1300) - back * (np.arange(ROWS) >= 1500))
    result = correct_stamps(stamps, "a")
    np.testing.assert_array_equal(result.order, np.arange(ROWS))
    assert [step.row for step in result.steps] == [1500]


@pytest.mark.parametrize("first", [20, 1000])
@pytest.mark.parametrize("size", [2, 35, 300])
@pytest.mark.parametrize("by", [-700.5, -20.0, 20.0, 700.5, 1e6])
def test_a_block_with_wrong_stamps_is_left_out(by: float, size: int, first: int) -> None:
    true, block = true_time(0.3), np.arange(first, first + size)
    stamps = true.copy()
    stamps[block] += STEP * by
    result = correct_stamps(stamps, "a")
    np.testing.assert_array_equal(np.flatnonzero(~result.kept), block)
    np.testing.assert_array_equal(result.time, np.delete(true, block))
    assert result.steps == ()


@pytest.mark.parametrize("period", [60.0, 65.536])
def test_two_halves_of_a_whole_turn_of_a_counter_are_a_wrap(period: float) -> None:
    step = period / ROWS
    stamps = (step * (np.arange(ROWS) + 0.5 * ROWS)) % period
    result = correct_stamps(stamps, "a")
    np.testing.assert_array_equal(result.order, np.arange(ROWS))
    assert len(result.steps) == 1
    assert result.steps[0].shift == period


@pytest.mark.parametrize("counter", ["32 bits of 1 us", "32 bits of 1 ms", "16 bits of 1 ms"])
@pytest.mark.parametrize(("lost", "doubt"), [(0, False), (2, False), (9, True), (30, True)])
def test_a_wrap_with_lost_rows_may_be_a_restart(counter: str, lost: int, doubt: bool) -> None:
    period = COUNTERS_S[counter]
    stamps = period + STEP * (np.arange(ROWS) - 900.5 + lost * (np.arange(ROWS) >= 900))
    result = correct_stamps(stamps % period, "a")
    assert [(step.counter, step.may_be_restart) for step in result.steps] == [(counter, doubt)]


@pytest.mark.parametrize("seed", range(50))
def test_random_exchanges_are_put_in_order(seed: int) -> None:
    rng, order = np.random.default_rng(seed), np.arange(ROWS)
    for start in range(0, ROWS, 1000):
        first, second = rng.integers(2, 300, size=2)
        order = swap_blocks(start + int(rng.integers(400)), int(first), int(second), order)
    true = true_time(0.4, seed)
    result = correct_stamps(true[order], "a")
    np.testing.assert_array_equal(result.time, true)


def test_an_order_is_kept_where_no_clock_comes_back() -> None:
    stamps = true_time()
    stamps[[7, 900, 901]] = np.nan, 0.0, 0.0
    np.testing.assert_array_equal(find_disordered_blocks(stamps).order, np.arange(ROWS))


@pytest.mark.parametrize("start", [0, 700, -1], ids=["start", "middle", "end"])
@pytest.mark.parametrize("second", SIZES)
@pytest.mark.parametrize("first", SIZES)
def test_a_stream_leaves_out_the_late_block(first: int, second: int, start: int) -> None:
    """Up to 9 rows before a late block at the very start are themselves not confirmed yet."""
    true = true_time()
    start = ROWS - first - second if start < 0 else start
    order = swap_blocks(start, first, second)
    rows, reader = live(true[order])
    np.testing.assert_array_equal(rows[:, 0], true[order][rows[:, 1].astype(int)])
    assert (np.diff(rows[:, 0]) > 0.0).all()
    assert reader.steps == 0
    assert len(reader.bad) + len(rows) == ROWS
    assert len(reader.bad) <= max(first, second if start == 0 else 0)


@pytest.mark.parametrize(
    ("ahead", "back"), [(100.0, 10.5), (100.0, 41.0), (100.0, 300.0), (100.0, 1e4), (2000.0, 3600.0)]
)
def test_a_stream_goes_on_after_a_gap_and_a_step_of_the_clock(ahead: float, back: float) -> None:
    late = STEP * ahead * (np.arange(ROWS) >= 1300)
    rows, reader = live(TRUE + late - STEP * back * (np.arange(ROWS) >= 1500))
    assert (len(rows), reader.steps, reader.bad) == (ROWS, 1, [])
    np.testing.assert_allclose(rows[:, 0], TRUE + late, atol=1e-9)
