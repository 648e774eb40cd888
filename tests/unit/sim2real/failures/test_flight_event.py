"""Failures: sums against least squares done anew for every onset, flights up to a failure, and words."""

from dataclasses import replace

import numpy as np
import pytest

from aerial_gym.errors import ConfigError
from aerial_gym.sim2real.failures.flight_event import (
    Failure,
    FailureFinder,
    cut_at_failures,
    failure_of_all_flights,
    least_log_odds,
)
from aerial_gym.sim2real.failures.rotor_work import RotorOutput
from aerial_gym.sim2real.failures.scan import (
    CONTINUOUS,
    FEWEST_AFTER,
    FEWEST_BEFORE,
    LONGEST,
    FailureEvidence,
    ParameterPrior,
    _lag_response,
    log_evidence,
)
from tests.unit.sim2real.flat_flights import ROBOT
from tests.unit.sim2real.predict.test_scene import hover


def failure(flight: str, time: float = 5.0, **params: float) -> Failure:
    values = {"motor": 2.0, "scale": 0.8, "time": time} | params
    half_widths = {"scale": 0.01, "time": 0.02}
    return Failure(
        flight=flight,
        name="motor_failure",
        params=values,
        std={"scale": 0.005, "time": 0.01},
        interval={name: (values[name] - size, values[name] + size) for name, size in half_widths.items()},
        log_odds=100.0,
        probability=1.0,
        rival="",
    )


def test_flights_end_before_their_failures_or_are_left_out() -> None:
    """A failure known to 20 ms at 3 s leaves 2.98 s; one at 1 s leaves less than 2 s, and so nothing."""
    flights = [hover(name, 1.0, rotor_command=np.ones((400, 4))) for name in "abc"]
    event = cut_at_failures(flights, [failure("b", 3.0), failure("c", 1.0)])
    assert [(one.name, one.num_rows) for one in event] == [("a", 400), ("b", 298)]
    assert event[1].attitude.shape == event[1].rotor_command.shape == (298, 4)


def test_one_failure_is_that_of_all_flights_only_if_it_is_the_same_in_all() -> None:
    both = [failure("a", 5.00), failure("b", 5.02)]
    every = failure_of_all_flights(both, 2)
    assert every.params == pytest.approx({"motor": 2.0, "scale": 0.8, "time": 5.01})
    assert every.std["time"] == pytest.approx(0.01 / np.sqrt(2.0))
    different_failures = (failure("b", 5.1), failure("b", 5.0, scale=0.7), failure("b", 5.0, motor=3.0))
    for other in (*different_failures, replace(both[1], name="weak_motor")):
        assert failure_of_all_flights([both[0], other], 2) is None
    assert failure_of_all_flights(both, 3) is None


def test_a_failure_is_a_finding_with_its_intervals() -> None:
    event = replace(failure("a"), place="front left").finding
    assert (event.code, event.subject) == ("failure_found", "a")
    times = {"time_s": 5.0, "time_low_s": 4.98, "time_high_s": 5.02}
    shares = {"share": 0.8, "share_low": 0.79, "share_high": 0.81}
    names = {"failure": "motor_failure", "rotor": 2, "place": "front left"}
    assert event.values == pytest.approx(times | shares | names)


def test_the_limit_is_that_of_blocks_between_false_alarms() -> None:
    """100 h of blocks of 0.1 s: 3.6 million."""
    assert np.exp(least_log_odds(100.0)) == pytest.approx(3.6e6)
    with pytest.raises(ConfigError, match="must be > 0"):
        FailureFinder(ROBOT, false_alarm_hours=0.0)


def test_a_change_rises_in_blocks_as_the_lag_lets_it() -> None:
    """The mean over a block of ``1 - exp(-(t - t0) / lag)``, by a sum over 10,000 instants."""
    work, begin = make_work(1), np.array([0.53, 0.6])
    at = work.time[:, None] + work.length * (np.arange(10000) + 0.5) / 10000
    for row, start in enumerate(begin):
        since = np.clip(at - start, 0.0, None)
        expected = (1.0 - np.exp(-since / work.lag)).mean(axis=1)
        np.testing.assert_allclose(_lag_response(work, begin)[row], expected, atol=1e-7)


LEAST, SHARE, LENGTH = 0.003, 0.7, 0.1


def make_work(seed: int, blocks: int = 24, rotors: int = 3, columns: int = 2) -> RotorOutput:
    rng = np.random.default_rng(seed)
    own = 1.0 + 0.2 * rng.standard_normal((blocks, rotors))
    return RotorOutput(
        quantity="speed", driven_by="command", time=LENGTH * np.arange(blocks), length=LENGTH, lag=0.03,
        done=own + 0.02 * rng.standard_normal((blocks, rotors)), expected=own, own=own,
        beside=rng.standard_normal((blocks, rotors, columns)),
    )  # fmt: skip


def least_squares(evidence: FailureEvidence, rotor: int, column: np.ndarray | None) -> tuple[float, float, float]:
    """Return the penalised squares of a rotor, the last coefficient, and the squares of its column beside the others."""
    work = evidence.work
    columns, target = work.beside[:, rotor], work.done[:, rotor] - work.expected[:, rotor]
    penalty = LEAST * np.eye(columns.shape[1])
    zeros = np.zeros(len(penalty))
    if column is None:
        a, b = np.vstack((columns, penalty)), np.concatenate((target, zeros))
        return float(np.sum((b - a @ np.linalg.lstsq(a, b, rcond=None)[0]) ** 2)), 0.0, 0.0
    ends = np.concatenate((column, zeros))
    base = np.vstack((columns, penalty))
    beside = ends - base @ np.linalg.lstsq(base, ends, rcond=None)[0]
    a, b = np.column_stack((base, ends)), np.concatenate((target, zeros))
    result = np.linalg.lstsq(a, b, rcond=None)[0]
    return float(np.sum((b - a @ result) ** 2)), float(result[-1]), float(beside @ beside)


@pytest.mark.parametrize("seed", range(3))
def test_sums_give_the_least_squares_of_every_onset_of_a_change(seed: int) -> None:
    work = make_work(seed)
    evidence = FailureEvidence(work, LEAST)
    onsets = evidence.odds_of_changes("motor_failure", SHARE)
    none = [least_squares(evidence, rotor, None)[0] for rotor in range(3)]
    np.testing.assert_allclose(evidence.rss, none, rtol=1e-9)
    for onset in range(FEWEST_BEFORE, 24 - FEWEST_AFTER["speed"] + 1):
        for rotor in range(3):
            column = np.where(np.arange(24) >= onset, work.own[:, rotor], 0.0)
            rss, change, inner = least_squares(evidence, rotor, column)
            if change > 0.0:  # no failure makes a rotor stronger
                rss, change = none[rotor], 0.0
            assert onsets.change[onset, rotor] == pytest.approx(change, rel=1e-3)  # of a ridge of 1e-4 of the squares
            rest = sum(none) - none[rotor]
            after = np.array((rss + rest) / 72 + LEAST**2)
            prior = ParameterPrior(away=np.array(change), scale=0.3)
            expected = log_evidence(sum(none) / 72 + LEAST**2, after, SHARE * 72, prior, np.array(SHARE * inner))
            assert onsets.log_odds[onset, rotor] == pytest.approx(float(expected) - np.log(3), abs=1e-3)


def test_sums_give_every_beginning_and_end_of_a_brown_out() -> None:
    work = make_work(5)
    evidence = FailureEvidence(work, LEAST)
    onsets = evidence.odds_of_brown_outs("brown_out", SHARE)
    for begin, lasting in ((6, 3), (10, 1), (9, LONGEST)):
        end = 24 if lasting == LONGEST else begin + lasting + 1
        acts = (np.arange(24) >= begin) & (np.arange(24) < end)
        parts = [least_squares(evidence, r, np.where(acts, work.own[:, r], 0.0)) for r in range(3)]
        inner = sum(part[2] for part in parts)
        change = sum(part[1] * part[2] for part in parts) / inner
        assert onsets.change[begin, lasting] == pytest.approx(min(change, 0.0), rel=1e-3)
    assert np.isneginf(onsets.log_odds[20, 8]).all()  # beyond the last block: that is to the end


def test_stronger_rotors_are_no_failure() -> None:
    work = make_work(5)
    stronger = replace(work, done=work.done + 0.1 * work.own * (np.arange(24) >= 12)[:, None])
    evidence = FailureEvidence(stronger, LEAST)
    assert evidence.odds_of_brown_outs("brown_out").log_odds.max() < 0.0
    assert evidence.odds_of_changes("motor_failure").log_odds.max() < 0.0


def test_sums_give_every_onset_of_a_rotor_that_sticks() -> None:
    work = make_work(6)
    evidence = FailureEvidence(work, LEAST)
    onsets = evidence.odds_of_stuck_rotors("stuck_rotor", SHARE)
    for onset in (5, 12, 22):
        for rotor in range(3):
            early = FailureEvidence(work.select_blocks(slice(0, onset)), LEAST)
            late = work.done[onset:, rotor]
            rss = evidence.rss.sum() - evidence.rss[rotor] + early.rss[rotor] + float(((late - late.mean()) ** 2).sum())
            prior = ParameterPrior(away=late.mean() - work.done[onset - 1, rotor], scale=CONTINUOUS, normal=True)
            means = (
                evidence.mean_square_with_tolerance(evidence.rss.sum()),
                evidence.mean_square_with_tolerance(np.array(rss)),
            )
            expected = log_evidence(*means, SHARE * 72, prior, np.array(SHARE * late.size))
            assert onsets.change[onset, rotor] == pytest.approx(late.mean())
            assert onsets.log_odds[onset, rotor] == pytest.approx(float(expected) - np.log(3), abs=1e-6)


def test_log_evidence_is_the_integral_over_the_parameter() -> None:
    """Of many values the noise is known: the likelihood is normal in the parameter, and the integral over a normal
    prior exact. With n = 1e6 values the log likelihood ``-(n / 2) log(RSS / n)`` is linear in the squares to 1e-4."""
    count, variance, inner, along, scale = 1e6, 0.5, 40.0, 6.0, 0.3
    change = along / (inner + variance / scale**2)
    rss = count * variance - 2.0 * change * along + change**2 * inner
    prior = ParameterPrior(away=np.array(change), scale=scale, normal=True)
    result = log_evidence(variance, np.array(rss / count), count, prior, np.array(inner))
    exact = 0.5 * along**2 / variance / (inner + variance / scale**2) - 0.5 * np.log1p(inner * scale**2 / variance)
    assert float(result) == pytest.approx(exact, abs=1e-3)


def test_too_little_before_or_after_is_no_onset() -> None:
    odds = FailureEvidence(make_work(7), LEAST).odds_of_changes("motor_failure").log_odds
    assert np.isneginf(odds[:FEWEST_BEFORE]).all()
    assert np.isneginf(odds[24 - FEWEST_AFTER["speed"] + 1 :]).all()
    assert np.isfinite(odds[FEWEST_BEFORE : 24 - FEWEST_AFTER["speed"] + 1]).all()
