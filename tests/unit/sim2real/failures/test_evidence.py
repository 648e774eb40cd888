"""The running sums against least squares done anew for every onset."""

import numpy as np
import pytest

from aerial_gym.sim2real.failures.evidence import (
    CONTINUOUS,
    FEWEST_AFTER,
    FEWEST_BEFORE,
    LONGEST,
    FailureEvidence,
    ParameterPrior,
    log_evidence,
)
from aerial_gym.sim2real.failures.rotor_work import RotorOutput

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
        assert onsets.change[begin, lasting] == pytest.approx(change, rel=1e-3)
    assert np.isneginf(onsets.log_odds[20, 8]).all()  # beyond the last block: that is to the end


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
