"""Text logs with late, slow and lost rows: streams are moved, filled by inertial motion, or not compared.

The exact flights are degraded by functions of numpy alone.
What a run reads: once, at its start, and without the flights that cannot be used.
"""

import hashlib
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from aerial_gym.errors import DataError
from aerial_gym.sim2real.flight_replay import replay_flights
from aerial_gym.sim2real.logs.flights import SETTLE_S, Flight, read_flight_inputs
from aerial_gym.sim2real.logs.readers.flight_log import open_log
from aerial_gym.sim2real.predict.channels import find_channels
from aerial_gym.sim2real.predict.rollout import find_windows
from tests.unit.sim2real.flat_flights import ROBOT, flight, load_tables, make_predictor, write

RATE = 200.0
PLACES = ["p_x", "p_y", "p_z"]
MOTION = [*PLACES, "v_x", "v_y", "v_z"]
COMMANDS = [f"cmd_{n}" for n in range(1, 5)]


@pytest.fixture(scope="module")
def table() -> pd.DataFrame:
    exact = flight(3, seconds=8.0, rate=RATE)
    rotors = exact[[f"rotor_{n}" for n in range(1, 5)]].to_numpy()
    change = np.gradient(rotors, 1.0 / RATE, axis=0)
    return exact.assign(**dict(zip(COMMANDS, (rotors + 0.04 * change).T, strict=True)))  # the command of the lag


def delay_columns(table: pd.DataFrame, columns: list[str], seconds: float) -> pd.DataFrame:
    values = {name: np.interp(table.t - seconds, table.t, table[name]) for name in columns}
    return table.assign(**values)[table.t >= seconds].reset_index(drop=True)


def hold_rows(table: pd.DataFrame, columns: list[str], rows: int) -> pd.DataFrame:
    place = np.arange(len(table)) // rows * rows
    return table.assign(**{name: table[name].to_numpy()[place] for name in columns})


def load(table: pd.DataFrame, folder: Path) -> Flight:
    (loaded,) = load_tables(folder, [table])
    return loaded


def notes(loaded: Flight, code: str) -> list[dict]:
    return [dict(note.values) for note in loaded.notes if note.code == code]


@pytest.mark.parametrize("seconds", [0.08, 0.15])
def test_late_positions_and_velocities_are_moved_back(seconds: float, table: pd.DataFrame, tmp_path: Path) -> None:
    loaded = load(delay_columns(table, MOTION, seconds), tmp_path)
    assert {one["topic"] for one in notes(loaded, "stream_moved")} == {"position", "lin_vel"}
    timing = loaded.streams["lin_vel"]
    assert timing.delay == pytest.approx(seconds, abs=max(timing.half_width or 0.0, 1e-3))
    rows = loaded.time + seconds
    for name, columns in (("position", PLACES), ("lin_vel", MOTION[3:])):
        exact = np.stack([np.interp(rows, table.t, table[column]) for column in columns], axis=1)
        np.testing.assert_allclose(getattr(loaded, name), exact, atol=0.02)


def test_a_delay_within_its_tolerance_is_left_to_the_fit(table: pd.DataFrame, tmp_path: Path) -> None:
    assert not notes(load(delay_columns(table, MOTION, 0.005), tmp_path), "stream_moved")


def test_slow_late_positions_follow_the_acceleration_between_their_samples(table: pd.DataFrame, tmp_path: Path) -> None:
    """At 5 Hz and 150 ms late, straight lines would miss the velocity by some 0.1 m/s."""
    loaded = load(hold_rows(delay_columns(table, MOTION, 0.15), MOTION, 40), tmp_path)
    assert loaded.streams["lin_vel"].rate == pytest.approx(5.0, rel=0.1)
    exact = np.stack([np.interp(loaded.time + 0.15, table.t, table[name]) for name in MOTION[3:]], axis=1)
    inner = slice(100, -100)
    assert np.sqrt(np.mean((loaded.lin_vel - exact)[inner] ** 2)) < 0.01
    kinds = {channel.kind for channel in find_channels([loaded], 10.0)}
    assert "kinematic_force" not in kinds
    assert "kinematic_rate" in kinds


@pytest.mark.parametrize(("rows", "slow"), [(20, True), (2, False)])
def test_held_commands_are_judged_at_their_own_rate(rows: int, slow: bool, table: pd.DataFrame, tmp_path: Path) -> None:
    loaded = load(hold_rows(table, COMMANDS, rows), tmp_path)
    rates = [one["rate_hz"] for one in notes(loaded, "rotors_too_slow")]
    assert (loaded.rotor_command is None) is slow
    assert rates == ([pytest.approx(RATE / rows)] if slow else [])
    assert [one["torques"] for one in notes(loaded, "rotors_too_slow")] == [True] * slow
    assert loaded.gyro


def test_slow_commands_alone_show_no_torques(table: pd.DataFrame, tmp_path: Path) -> None:
    bare = table.drop(columns=[f"rotor_{n}" for n in range(1, 5)])
    loaded = load(hold_rows(bare, COMMANDS, 20), tmp_path)
    assert not loaded.gyro
    assert loaded.rotor_command is not None
    assert {channel.kind for channel in find_channels([loaded])} == {"specific_force", "kinematic_force"}
    assert replay_flights(ROBOT, [loaded], bandwidth=2.0).evaluation.rollouts.keys() == {"given_attitude"}


@pytest.mark.parametrize("rows", [20, 8])
def test_slow_rows_show_no_torques_where_a_file_is_opened(rows: int, table: pd.DataFrame, tmp_path: Path) -> None:
    """A note names only quantities that are logged."""
    path = write(table.iloc[::rows].drop(columns=[f"rotor_{n}" for n in range(1, 5)]), tmp_path / "a.csv")
    log, fast = open_log(path).flight(1), RATE / rows >= 40.0
    assert log.torques is fast
    assert [one["quantity"] for one in notes(log, "rotors_too_slow")] == ["rotor_command"] * (not fast)


def test_rows_near_a_gap_are_not_compared(table: pd.DataFrame, tmp_path: Path) -> None:
    """A gap of 60 ms at 4 s, and a single lost row at 6 s, which is no gap."""
    kept = ((table.t < 4.0) | (table.t > 4.06)) & (np.arange(len(table)) != 1200)
    jitter = np.random.default_rng(2).normal(0.0, 1.5e-4, len(table))
    loaded = load(table.assign(t=table.t + jitter)[kept].reset_index(drop=True), tmp_path)
    lost = loaded.time[loaded.lost]
    assert (lost.min(), lost.max()) == (pytest.approx(4.0, abs=0.006), pytest.approx(4.06, abs=0.006))
    (time,) = make_predictor([loaded]).times
    edge = 2.0 / 10.0
    assert not np.any((time > lost.min() - edge) & (time < lost.max() + SETTLE_S))
    assert np.any(time < lost.min() - edge)
    assert np.any((time > lost.max() + SETTLE_S + 0.02) & (time < 6.1))
    starts = find_windows([loaded], 1.0).row / loaded.rate
    assert not np.any((starts > lost.min() - 1.0) & (starts < lost.max() + SETTLE_S))


@pytest.fixture
def logs(tmp_path: Path) -> list[Path]:
    return [write(flight(40 + n, noise=1.0, seconds=5.0, rate=100.0), tmp_path / f"f{n}.csv") for n in range(4)]


def spoil(path: Path) -> None:
    table = pd.read_csv(path)
    table.loc[100:110, "omega_y"] = np.nan
    write(table, path)


def test_a_flight_that_cannot_be_used_is_left_out_and_said_so(logs: list[Path]) -> None:
    spoil(logs[1])
    result = read_flight_inputs(ROBOT, logs[:3], logs[3:], mapping=None, bandwidth=10.0)
    assert [one.name for one in result.train] == ["f0", "f2"]
    assert [one.name for one in result.test] == ["f3"]
    (note,) = result.left_out
    assert note.code == "flight_left_out"
    assert note.values["error"].startswith(f"{logs[1]}, line 102: omega_y is empty")
    assert result.digests == {str(path): hashlib.sha256(path.read_bytes()).hexdigest() for path in logs}


def test_a_flight_that_turns_otherwise_than_declared_is_left_out_too(logs: list[Path]) -> None:
    table = pd.read_csv(logs[0])
    write(table.rename(columns={"rotor_1": "rotor_2", "rotor_2": "rotor_1"}), logs[0])
    result = read_flight_inputs(ROBOT, logs[:3], logs[3:], mapping=None, bandwidth=10.0)
    assert [one.name for one in result.train] == ["f1", "f2"]
    assert "the probable order is rotor_2, rotor_1" in result.left_out[0].values["error"]


def test_a_run_that_has_no_flight_left_says_why(logs: list[Path]) -> None:
    spoil(logs[3])
    with pytest.raises(DataError, match=r"f3\.csv, line 102: omega_y is empty"):
        read_flight_inputs(ROBOT, logs[:3], logs[3:], mapping=None, bandwidth=10.0)
    for path in logs[:3]:
        spoil(path)
    words = r"f0\.csv, line 102: .*none of 3 flights to train on is left; the first .* of 4"
    with pytest.raises(DataError, match=words):
        read_flight_inputs(ROBOT, logs[:3], logs[3:], mapping=None, bandwidth=10.0)


def test_a_file_that_is_not_there_ends_the_run_at_its_start(logs: list[Path]) -> None:
    with pytest.raises(DataError, match=r"f9\.csv: no such file"):
        read_flight_inputs(ROBOT, [*logs[:2], logs[0].parent / "f9.csv"], logs[3:], mapping=None, bandwidth=10.0)
