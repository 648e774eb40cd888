"""Steps that a position makes and its velocity does not: found, measured and taken out; motion and noise are none."""

from dataclasses import replace

import numpy as np
import pytest

from aerial_gym.sim2real.logs.flights import resample_log
from aerial_gym.sim2real.logs.position_jumps import (
    LIMIT,
    PositionOffset,
    largest_jump,
    log_odds_of_return,
    mend_position_jumps,
    step_estimates,
)
from aerial_gym.sim2real.logs.recording import FlightLog

RATE = 50.0


def fly(seed: int, *, noise: float = 0.01, bias: float = 0.05, seconds: float = 30.0) -> FlightLog:
    """Return a log of a vehicle that circles at up to 3 m/s and stops, with noise and a velocity that is a little off."""
    rng, time = np.random.default_rng(seed), np.arange(round(seconds * RATE)) / RATE
    turn = 1.5 * np.clip(time - 5.0, 0.0, None)
    way = 2.0 * np.column_stack((np.sin(turn), 1.0 - np.cos(turn), 0.2 * np.sin(0.7 * turn)))
    velocity = np.gradient(way, 1.0 / RATE, axis=0) + bias + 0.02 * rng.standard_normal((time.size, 3))
    heading = 0.5 * (0.2 * turn + 0.001 * rng.standard_normal(time.size))
    return FlightLog(
        path="log.csv", time=time,
        attitude=np.column_stack((np.zeros((time.size, 2)), np.sin(heading), np.cos(heading))),
        position=way + noise * rng.standard_normal((time.size, 3)), lin_vel=velocity,
    )  # fmt: skip


def with_steps(log: FlightLog, steps: dict[float, tuple[float, float, float]]) -> FlightLog:
    position = log.position.copy()
    for at, size in steps.items():
        position[log.time >= at] += size
    return replace(log, position=position)


def jump_notes(log: FlightLog) -> list[tuple[np.ndarray, float]]:
    assert {note.code for note in log.notes} == {"position_jump"}
    return [(np.array(note.values["size_m"]), note.values["start_s"]) for note in log.notes]


def test_steps_are_least_squares_beside_a_slope() -> None:
    rng, half = np.random.default_rng(0), 4
    left = rng.standard_normal((30, 2)).cumsum(axis=0)
    at = np.arange(2 * half)
    columns = np.column_stack((np.ones(2 * half), at, at >= half))
    expected = [np.linalg.lstsq(columns, left[k : k + 2 * half], rcond=None)[0][2] for k in range(30 - 2 * half + 1)]
    np.testing.assert_allclose(step_estimates(left, half), expected, atol=1e-12)


@pytest.mark.parametrize("seed", [0, 1, 2])
def test_a_fix_that_moves_and_returns_is_found_and_taken_out(seed: int) -> None:
    clean = fly(seed)
    steps = {9.0: (2.0, -1.0, 0.5), 13.0: (-2.0, 1.0, -0.5), 22.0: (0.0, 0.0, 1.5)}
    mended = mend_position_jumps(with_steps(clean, steps))
    result = jump_notes(mended)
    assert len(result) == 3
    for (size, time), (at, truth) in zip(result, steps.items(), strict=True):
        assert abs(time - at) < 1.5 / RATE
        np.testing.assert_allclose(size, truth, atol=0.06)
    assert np.abs(mended.position - clean.position).max() < 0.1


@pytest.mark.parametrize("seed", range(8))
def test_nothing_jumps_where_nothing_does(seed: int) -> None:
    for log in (fly(seed), fly(seed, noise=0.001), fly(seed, noise=0.0, bias=0.3), fly(seed, seconds=4.0)):
        assert mend_position_jumps(log) is log


def test_a_velocity_that_leaps_is_no_jump_and_one_derived_from_a_jump_hides_none() -> None:
    late = fly(6, noise=0.001)
    late.lin_vel[700:704] *= 3.0
    assert mend_position_jumps(late) is late
    log = with_steps(fly(7, noise=0.001), {10.0: (0.5, 0.0, 0.0)})
    derived = replace(log, lin_vel=np.gradient(log.position, 1.0 / RATE, axis=0))
    ((size, time),) = jump_notes(mend_position_jumps(derived))
    assert abs(time - 10.0) <= 1.5 / RATE
    assert size[0] == pytest.approx(0.5, abs=0.02)


def test_a_slow_jump_is_one_and_too_many_are_left() -> None:
    log = with_steps(fly(3), {10.0: (1.0, 0.0, 0.0), 10.1: (1.0, 0.0, 0.0), 10.2: (1.0, 0.0, 0.0)})
    ((size, time),) = jump_notes(mend_position_jumps(log))
    assert abs(time - 10.1) <= 0.15
    assert size[0] == pytest.approx(3.0, abs=0.1)
    many = with_steps(fly(4, seconds=120.0), {float(at): (3.0 * (-1) ** at, 0.0, 0.0) for at in range(10, 110, 4)})
    left = mend_position_jumps(many)
    assert left.notes[-1].code == "position_jumps_left"
    np.testing.assert_array_equal(left.position, many.position)


def test_a_log_is_read_without_its_jumps() -> None:
    mended = mend_position_jumps(resample_log(with_steps(fly(8), {12.0: (0.0, 2.0, 0.0)})))
    assert "position_jump" in [note.code for note in mended.notes]
    assert np.abs(np.diff(mended.position, axis=0)).max() < 0.2


def test_without_a_velocity_nothing_is_told() -> None:
    alone = replace(with_steps(fly(5), {10.0: (2.0, 0.0, 0.0)}), lin_vel=None)
    assert mend_position_jumps(alone) is alone


def make_offset(x: float, y: float, z: float, *, std: float = 0.001) -> PositionOffset:
    return PositionOffset(size=np.array((x, y, z)), variance=np.full(3, std**2))


@pytest.mark.parametrize(("offset", "told"), [
    (PositionOffset(), False),
    (make_offset(0.11, -0.11, 0.11), True),
    (make_offset(-0.11, 0.11, -0.11), False),
    (make_offset(0.22, -0.22, 0.22), False),
    (make_offset(0.11, -0.11, 0.11, std=0.004), False),
])  # fmt: skip
def test_a_jump_that_takes_back_what_jumped_is_told_where_none_would_be(offset: PositionOffset, told: bool) -> None:
    rng = np.random.default_rng(1)
    left = 0.006 * rng.standard_normal((1000, 3))
    left[600:] += (-0.11, 0.11, -0.11)
    result = largest_jump(left, 1.0 / RATE, offset)
    assert (result is not None) == told
    if result is not None:
        assert abs(result.first - 600) <= 1
        np.testing.assert_allclose(result.size, (-0.11, 0.11, -0.11), atol=0.02)


def test_noise_takes_nothing_back() -> None:
    rng = np.random.default_rng(2)
    for _ in range(200):
        left = 0.006 * rng.standard_t(4, (1000, 3))
        assert largest_jump(left, 1.0 / RATE, make_offset(0.11, -0.11, 0.11)) is None


def test_the_odds_of_a_return() -> None:
    """Of Student's t in three axes, by hand: 3.5 times the difference of the logarithms of 1 + d² / 4, less those of widths."""
    scale, offset = np.full((3, 3), 0.01), PositionOffset(size=np.array((0.1, 0.0, 0.0)), variance=np.full(3, 0.01**2))
    sizes = np.array(((-0.1, 0.0, 0.0), (0.1, 0.0, 0.0), (0.0, 0.0, 0.0)))
    wide = -1.5 * np.log(2.0)
    none, far, once = np.log1p(100.0 / 4.0), np.log1p(0.5 * 400.0 / 4.0), np.log1p(0.5 * 100.0 / 4.0)
    expected = (3.5 * none + wide, 3.5 * (none - far) + wide, -3.5 * once + wide)
    np.testing.assert_allclose(log_odds_of_return(sizes, scale, offset), expected, rtol=1e-12)


def test_jumps_that_took_each_other_back_leave_nothing_to_return() -> None:
    assert make_offset(LIMIT * 0.011, 0.0, 0.0, std=0.01).is_significant
    assert not make_offset(LIMIT * 0.009, 0.0, 0.0, std=0.01).is_significant
    assert not make_offset(0.09, 0.0, 0.0, std=1e-6).is_significant
    assert not PositionOffset().is_significant
