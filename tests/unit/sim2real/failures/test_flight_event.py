"""Failures: sums against least squares done anew for every onset, flights up to a failure, and words.
Rows that come one by one: what is told, when, and what is refused; how often noise alone is taken for a failure.
"""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from aerial_gym.errors import ConfigError, DataError
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
    log_sum_of_odds,
    rank_failure_causes,
)
from aerial_gym.sim2real.failures.watch import MISFIT, NAMED, SETTLED_S, SUSPECTED, Alarm, FlightWatch, SensorFault
from aerial_gym.sim2real.logs.flights import complete_flight
from aerial_gym.sim2real.logs.readers.flight_log import read_flight_log
from aerial_gym.sim2real.predict.tolerances import Tolerances
from tests.refusals import assert_refused
from tests.unit.sim2real.flat_flights import ROBOT, flight, write
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
    assert_refused(ConfigError, "must be > 0", FailureFinder, ROBOT, false_alarm_hours=0.0)


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
        error_columns=rng.standard_normal((blocks, rotors, columns)),
    )  # fmt: skip


def least_squares(evidence: FailureEvidence, rotor: int, column: np.ndarray | None) -> tuple[float, float, float]:
    """Return the penalised squares of a rotor, the last coefficient, and the squares of its column beside the others."""
    work = evidence.work
    columns, target = work.error_columns[:, rotor], work.done[:, rotor] - work.expected[:, rotor]
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


ONSET, LEFT = 6.0, 0.9


def failure_table(left: float = LEFT, **hidden: float) -> pd.DataFrame:
    """Return a flight whose second rotor gives a share of its thrust from 6 s on: it turns faster for what it gives."""
    table = flight(3, noise=1.0, **hidden)
    table.loc[table["t"] >= ONSET, "rotor_2"] /= np.sqrt(left)
    return table


def run_watch(table: pd.DataFrame, kept: slice | np.ndarray = slice(None)) -> list[Alarm]:
    return watch_rows(table, kept)[0]


def watch_rows(table: pd.DataFrame, kept: slice | np.ndarray = slice(None)) -> tuple[list[Alarm], tuple[int, int]]:
    watch = FlightWatch(ROBOT, list(table.columns))
    alarms = [alarm for row in table.to_numpy()[kept] for alarm in watch.add(row)] + watch.finish()
    return alarms, (watch.bad_rows, watch.clock_steps)


def test_a_propeller_that_breaks_is_suspected_and_then_named() -> None:
    suspected, named = run_watch(failure_table())
    assert (suspected.stage, named.stage) == (SUSPECTED, NAMED)
    assert ONSET < suspected.told_s < ONSET + 1.6
    assert ONSET + SETTLED_S <= named.told_s < ONSET + SETTLED_S + 0.6
    result = named.failure
    assert (result.name, result.params["motor"]) == ("weak_motor", 2.0)
    assert result.params["scale"] == pytest.approx(LEFT, abs=4.0 * result.std["scale"])
    assert result.params["time"] == pytest.approx(ONSET, abs=4.0 * result.std["time"])
    assert named.as_mapping()["delay_s"] == pytest.approx(named.told_s - result.time)


def test_the_whole_flight_tells_the_same(tmp_path: Path) -> None:
    log = read_flight_log(write(failure_table(), tmp_path / "a.csv"))
    result = FailureFinder(ROBOT).find_first_failure(complete_flight(log))
    assert (result.name, result.params["motor"]) == ("weak_motor", 2.0)
    assert result.params["scale"] == pytest.approx(LEFT, abs=4.0 * result.std["scale"])


def test_a_flight_without_a_failure_tells_nothing() -> None:
    assert run_watch(flight(3, noise=1.0)) == []


@pytest.mark.parametrize("seconds", [0.02, 0.05, 0.08])
def test_a_knock_is_no_brown_out(seconds: float) -> None:
    """A touchdown takes the force for less than a block."""
    table = flight(3, noise=1.0)
    table = table.rename(columns={f"rotor_{n}": f"cmd_{n}" for n in range(1, 5)})
    table.loc[(table.t >= ONSET) & (table.t < ONSET + seconds), "acc_z"] -= 40.0
    assert run_watch(table) == []


def test_a_failure_of_a_vehicle_that_does_not_fit_is_named_in_the_first_half_minute() -> None:
    """All rotors give 12 % less than declared, and one of them another 30 % less from 6 s on."""
    *_, named = alarms = run_watch(failure_table(0.7, thrust_scale=0.88))
    assert {MISFIT, SUSPECTED, NAMED} == {one.stage for one in alarms}
    assert (named.failure.name, named.failure.params["motor"]) == ("weak_motor", 2.0)
    assert named.failure.params["time"] == pytest.approx(ONSET, abs=0.2)


def test_a_vehicle_that_does_not_fit_is_told_at_the_end_of_a_short_flight() -> None:
    assert [one.stage for one in run_watch(flight(3, noise=1.0, thrust_scale=0.88))] == [MISFIT]


def test_a_loss_of_less_than_5_percent_is_no_failure() -> None:
    assert [one.stage for one in run_watch(failure_table(0.975)) if one.stage != MISFIT] == []


def test_slow_commands_alone_tell_no_failure() -> None:
    """At 25 Hz they do not show torques."""
    table = failure_table(0.7).iloc[::8]
    assert run_watch(table.rename(columns={f"rotor_{k}": f"cmd_{k}" for k in range(1, 5)})) == []


def test_a_log_that_ends_early_names_what_is_suspected() -> None:
    table = failure_table()
    alarms = run_watch(table, np.asarray(table["t"] < ONSET + 1.8))
    assert [alarm.stage for alarm in alarms] == [SUSPECTED, NAMED]
    assert alarms[1].told_s < ONSET + 1.8


def test_a_gap_begins_anew() -> None:
    table = failure_table()
    alarms = run_watch(table, np.asarray((table["t"] < ONSET - 0.3) | (table["t"] > ONSET)))
    assert [one.stage for one in alarms] == [MISFIT]  # the vehicle behind the gap is another one


def test_a_position_that_jumps_and_returns_is_told_with_its_size() -> None:
    table = flight(3, noise=1.0)
    there = (table["t"] >= ONSET) & (table["t"] < ONSET + 2.0)
    table.loc[there, "p_x"] += 1.0
    alarms = run_watch(table)
    assert [alarm.failure.name for alarm in alarms] == ["position_jump"] * 2
    for alarm, time, size in zip(alarms, (ONSET, ONSET + 2.0), (1.0, -1.0), strict=True):
        assert alarm.failure.time == pytest.approx(time, abs=0.05)
        assert alarm.failure.params["x"] == pytest.approx(size, abs=0.02)
        assert time < alarm.told_s < time + 2.5
    jump = alarms[0].failure.finding
    assert (jump.code, jump.values["size_m"][0]) == ("position_jump", pytest.approx(1.0, abs=0.5))


@pytest.mark.parametrize(
    ("sensor", "columns"), [("ang_vel", ["omega_x", "omega_y", "omega_z"]), ("position", ["p_x", "p_y", "p_z"])]
)
@pytest.mark.parametrize("empty", [False, True])
def test_a_sensor_that_stops_is_told_and_no_rotor_is_blamed(sensor: str, columns: list[str], empty: bool) -> None:
    table = flight(3, noise=1.0)
    gone = (table["t"] >= ONSET) & (table["t"] < ONSET + 1.5)
    table.loc[gone, columns] = np.nan if empty else table.loc[~gone & (table["t"] < ONSET), columns].to_numpy()[-1]
    (alarm,) = run_watch(table)
    assert isinstance(alarm.failure, SensorFault)
    assert (alarm.failure.name, alarm.failure.sensor) == ("sensor_dropout", sensor)
    assert alarm.failure.time == pytest.approx(ONSET, abs=0.01)
    assert alarm.told_s < ONSET + 1.3
    assert alarm.as_mapping()["sensor"] == sensor


def test_a_sensor_that_never_comes_back_is_told_once() -> None:
    table = flight(3, noise=1.0, seconds=30.0)
    columns = ["v_x", "v_y", "v_z"]
    table.loc[table["t"] >= ONSET, columns] = table.loc[table["t"] < ONSET, columns].to_numpy()[-1]
    table.loc[(table["t"] > 8.0) & (table["t"] < 9.0), ["omega_x", "omega_y", "omega_z"]] *= 1e-3
    (alarm,) = run_watch(table)
    assert (alarm.failure.name, alarm.failure.params["time"]) == ("sensor_dropout", pytest.approx(ONSET, abs=0.01))


def test_a_position_is_watched_again_after_it_stood_still() -> None:
    table = flight(3, noise=1.0, seconds=14.0)
    columns, gone = ["p_x", "p_y", "p_z"], (table["t"] >= 4.0) & (table["t"] < 5.0)
    table.loc[gone, columns] = table.loc[table["t"] < 4.0, columns].to_numpy()[-1]
    table.loc[table["t"] >= 11.0, "p_y"] -= 2.0
    stopped, jumped = run_watch(table)
    assert (stopped.failure.name, jumped.failure.name) == ("sensor_dropout", "position_jump")
    assert jumped.failure.time == pytest.approx(11.0, abs=0.05)
    assert jumped.failure.params["y"] == pytest.approx(-2.0, abs=0.05)


def test_a_jump_is_told_after_a_gap_and_none_is_made_of_the_gap() -> None:
    table = flight(3, noise=1.0, seconds=14.0)
    table.loc[table["t"] >= 11.0, "p_z"] += 1.0
    (alarm,) = run_watch(table, np.asarray((table["t"] < 4.0) | (table["t"] > 4.6)))
    assert alarm.failure.name == "position_jump"
    assert alarm.failure.time == pytest.approx(11.0, abs=0.05)
    assert alarm.failure.params["z"] == pytest.approx(1.0, abs=0.02)


def test_what_cannot_be_watched_is_refused() -> None:
    columns = list(flight(3, seconds=1.0).columns)
    with pytest.raises(DataError, match="no column 'omega_x'"):
        FlightWatch(ROBOT, [column for column in columns if column != "omega_x"])
    with pytest.raises(DataError, match="neither rotor_1"):
        FlightWatch(ROBOT, [column for column in columns if not column.startswith("rotor")])
    watch = FlightWatch(ROBOT, columns)
    assert_refused(DataError, "a row has 3 fields", watch.add, [1.0, 2.0, 3.0])


def test_bad_rows_change_nothing_that_is_told() -> None:
    table = failure_table()
    bad = table.copy()
    bad.loc[[300, 700, 1300], "t"] = [99.0, 0.0, np.nan]
    bad.loc[900, ["q_x", "q_y", "q_z", "q_w"]] = 0.0
    bad.loc[1000, "t"] = bad.loc[999, "t"]
    (alarms, counts), clean = watch_rows(bad), run_watch(table)
    assert counts == (5, 0)
    assert [alarm.stage for alarm in alarms] == [alarm.stage for alarm in clean]
    assert alarms[-1].failure.params["motor"] == clean[-1].failure.params["motor"]
    assert alarms[-1].failure.time == pytest.approx(clean[-1].failure.time, abs=0.05)


def exchange_blocks(table: pd.DataFrame) -> pd.DataFrame:
    rows = np.arange(len(table))
    rows[400:480] = np.roll(rows[400:480], 40)
    return table.iloc[rows]


@pytest.mark.parametrize(
    ("change", "counts"),
    [(lambda table: table.assign(t=table["t"] - 2.0 * (table.index >= 600)), (0, 1)), (exchange_blocks, (40, 0))],
    ids=["clock set back", "late block"],
)
def test_a_step_of_the_clock_is_followed_and_a_late_block_of_40_rows_is_left_out(change, counts) -> None:
    alarms, counted = watch_rows(change(failure_table()))
    assert counted == counts
    assert [alarm.stage for alarm in alarms] == [SUSPECTED, NAMED]
    assert alarms[1].failure.time == pytest.approx(ONSET, abs=0.2)


def test_noise_alone_passes_a_limit_no_more_often_than_is_said() -> None:
    """The sum of the odds over n blocks has a mean of n at most: it passes 20 n in a twentieth of cases at most
    (Markov). Of 200 draws at most 10 then, and 3 standard deviations more: 19."""
    rng, blocks, rotors = np.random.default_rng(0), 60, 4
    own = np.ones((blocks, rotors))
    passed = 0
    for _ in range(200):
        work = RotorOutput(
            quantity="speed",
            driven_by="command",
            time=0.1 * np.arange(blocks),
            length=0.1,
            lag=0.03,
            done=own + 0.01 * rng.standard_normal(own.shape),  # well above what is tolerated
            expected=own,
            own=own,
            error_columns=np.stack((own, rng.standard_normal(own.shape)), axis=-1),
        )
        passed += log_sum_of_odds(rank_failure_causes([work], Tolerances(thrust=1e-3))) > np.log(20.0 * blocks)
    assert passed <= 19
