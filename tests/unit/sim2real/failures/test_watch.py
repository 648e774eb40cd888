"""Rows that come one by one: what is told, when, and what is refused; how often noise alone is taken for a failure."""

from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from aerial_gym.errors import DataError
from aerial_gym.sim2real.failures.flight_event import FailureFinder
from aerial_gym.sim2real.failures.rotor_work import RotorOutput
from aerial_gym.sim2real.failures.scan import log_sum_of_odds, rank_causes
from aerial_gym.sim2real.failures.watch import NAMED, SETTLED_S, SUSPECTED, Alarm, FlightWatch, SensorFault
from aerial_gym.sim2real.logs.flights import complete_flight
from aerial_gym.sim2real.logs.readers.flight_log import read_flight_log
from aerial_gym.sim2real.predict.tolerances import Tolerances
from tests.unit.sim2real.flat_flights import ROBOT, flight, write

ONSET, LEFT = 6.0, 0.9


def failure_table() -> pd.DataFrame:
    """Return a flight whose second rotor gives 0.9 of its thrust from 6 s on: it turns faster for what it gives."""
    table = flight(3, noise=1.0)
    table.loc[table["t"] >= ONSET, "rotor_2"] /= np.sqrt(LEFT)
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


def test_a_log_that_ends_early_names_what_is_suspected() -> None:
    table = failure_table()
    alarms = run_watch(table, np.asarray(table["t"] < ONSET + 1.8))
    assert [alarm.stage for alarm in alarms] == [SUSPECTED, NAMED]
    assert alarms[1].told_s < ONSET + 1.8


def test_a_gap_begins_anew() -> None:
    table = failure_table()
    assert run_watch(table, np.asarray((table["t"] < ONSET - 0.3) | (table["t"] > ONSET))) == []


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
    with pytest.raises(DataError, match="a row has 3 fields"):
        watch.add([1.0, 2.0, 3.0])


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
            beside=np.stack((own, rng.standard_normal(own.shape)), axis=-1),
        )
        passed += log_sum_of_odds(rank_causes([work], Tolerances(thrust=1e-3))) > np.log(20.0 * blocks)
    assert passed <= 19
