"""A vehicle that stands before take-off and after landing: those rows are found and not compared."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from aerial_gym.errors import DataError
from aerial_gym.sim2real import find_mapping, read_flight_log
from aerial_gym.sim2real.flight_replay import replay_flights
from aerial_gym.sim2real.logs.flights import Flight
from aerial_gym.sim2real.logs.on_ground import check_airborne, rows_on_ground
from aerial_gym.sim2real.predict.model_params import params_from_robot
from aerial_gym.sim2real.predict.rollout import HORIZONS_S, find_windows, windows_of_longest_horizon
from tests.unit.sim2real.flat_flights import ROBOT, flight, load_flight, make_predictor, write

RATE = 100.0
ROTORS = [f"rotor_{n}" for n in range(1, 5)]
COMMANDS = [f"cmd_{n}" for n in range(1, 5)]
FIELDS = [f"{name}_{axis}" for name in ("p", "v", "omega", "acc") for axis in "xyz"]


@pytest.fixture(scope="module")
def table() -> pd.DataFrame:
    return flight(1, seconds=6.0, rate=RATE, noise=1.0)


def on_ground(table: pd.DataFrame, rows: int, *, idle: float, at: int = 0) -> pd.DataFrame:
    """Return rows of a vehicle that stands as in a row of the flight, with idling rotors."""
    rng = np.random.default_rng(0)
    ground = table.iloc[[at] * rows].copy()
    ground = ground.assign(**dict.fromkeys(("v_x", "v_y", "v_z", "omega_x", "omega_y", "omega_z"), 0.0))
    attitude = Rotation.from_quat(ground[["q_x", "q_y", "q_z", "q_w"]].to_numpy(copy=True))
    ground[["acc_x", "acc_y", "acc_z"]] = attitude.apply([0.0, 0.0, 9.81], inverse=True)
    ground[FIELDS] += 0.002 * rng.standard_normal((rows, len(FIELDS)))
    ground[ROTORS] = idle * (1.0 + 0.003 * rng.standard_normal((rows, 4)))
    return ground


def join_parts(parts: list[pd.DataFrame], folder: Path) -> Path:
    whole = pd.concat(parts, ignore_index=True)
    whole["t"] = np.arange(len(whole)) / RATE
    return write(whole, folder / "a.csv")


def load_parts(parts: list[pd.DataFrame], folder: Path) -> Flight:
    return load_flight(join_parts(parts, folder), ROBOT, mapping=None, bandwidth=10.0)


def ground_rows(parts: list[pd.DataFrame], folder: Path, *, lift_off: float) -> NDArray[np.bool_] | None:
    mapping = replace(find_mapping("aerial_gym"), lift_off_m=lift_off)
    return rows_on_ground(read_flight_log(join_parts(parts, folder), mapping=mapping), ROBOT)


@pytest.mark.parametrize("idle", [0.0, 200.0])
def test_rows_on_the_ground_are_found_without_a_height(table: pd.DataFrame, tmp_path: Path, idle: float) -> None:
    results = load_parts([on_ground(table, 150, idle=idle), table, on_ground(table, 150, idle=idle, at=-1)], tmp_path)
    inner = np.r_[0:130, len(table) + 170 : len(table) + 300]
    assert results.on_ground[inner].all()
    assert not results.on_ground[160 : 140 + len(table)].any()
    assert "on_ground" in [note.code for note in results.notes]
    residual = make_predictor([results], bandwidth=5.0).residuals(params_from_robot(ROBOT))[0]
    assert np.abs(residual[:, 2]).max() < 0.5  # standing, it would be g


def test_rows_in_a_hand_and_of_a_throw_are_not_compared(table: pd.DataFrame, tmp_path: Path) -> None:
    """It is carried with still rotors, thrown, and falls until they turn. A fast tumble without thrust is a flight."""
    rng, hand = np.random.default_rng(1), on_ground(table, 150, idle=0.0)
    hand[["omega_x", "omega_y", "omega_z"]] = 0.6 * rng.standard_normal((150, 3))
    hand[["acc_x", "acc_y", "acc_z"]] *= 1.3
    throw = hand[:20].assign(acc_x=0.1, acc_y=0.0, acc_z=0.2, omega_x=8.0)
    flown = table.copy()
    flown.loc[300:339, ROTORS] *= 0.1
    flown.loc[300:339, ["omega_x", "acc_y", "acc_z"]] += (22.0, 11.0, -8.0)
    results = ground_rows([on_ground(table, 100, idle=0.0), hand, throw, flown], tmp_path, lift_off=0.0)
    assert results[5:265].all()
    assert not results[276:].any()


def test_a_flight_that_never_stands_has_no_such_rows(table: pd.DataFrame, tmp_path: Path) -> None:
    assert load_parts([table], tmp_path).on_ground is None


def test_a_vehicle_that_a_hand_swings_is_not_compared(table: pd.DataFrame, tmp_path: Path) -> None:
    """It turns and moves, but stopped rotors carry nothing; the same force in a fast turn may be that of the turn."""
    swung = on_ground(table, 150, idle=0.0)
    swung["omega_x"] += 2.0 * np.sin(np.arange(150) / 10.0)
    results = ground_rows([swung, table], tmp_path, lift_off=0.0)
    assert results is not None
    assert results[10:130].all()
    assert not results[160:].any()
    spun = ground_rows([swung.assign(omega_x=20.0), table], tmp_path, lift_off=0.0)
    assert spun is None or not spun[10:130].any()


def test_a_height_at_which_it_stood_is_the_ground_and_a_lower_one_is_none(table: pd.DataFrame, tmp_path: Path) -> None:
    """It stands on a table 5 m high, skims it, and flies far below as well: there nothing but its rotors carries it."""
    stands, skims = on_ground(table, 150, idle=200.0).assign(p_z=5.0), table[:100].assign(p_z=5.01)
    results = ground_rows([stands, skims, table.assign(p_z=table["p_z"] - 3.0)], tmp_path, lift_off=0.02)
    assert results[:250].all()
    assert not results[250:].any()


@pytest.mark.parametrize(("height", "touches"), [(0.1, True), (2.0, False)])
def test_an_impact_near_the_ground_is_contact_and_one_in_the_air_is_none(table, tmp_path, height, touches) -> None:
    """2 g within 20 ms, which no rotor gives so fast. Vibration of 2 m/s² is no impact."""
    stands, skims = on_ground(table, 150, idle=200.0).assign(p_z=0.0), table[:100].assign(p_z=height)
    skims.loc[50:51, "acc_z"] += 20.0
    skims["acc_x"] += 2.0 * np.random.default_rng(2).standard_normal(100)
    results = ground_rows([stands, skims, table.assign(p_z=table["p_z"] + 3.0)], tmp_path, lift_off=0.0)
    assert results[200:202].all() == touches
    assert not results[155:195].any()
    assert not results[206:].any()


def test_a_low_slow_hover_is_flight(table: pd.DataFrame, tmp_path: Path) -> None:
    hover = on_ground(table, 400, idle=np.sqrt(0.6 * 9.81 / 4.8e-6)).assign(p_z=0.8)
    assert ground_rows([hover, table], tmp_path, lift_off=0.01) is None


def test_rotors_that_are_cut_in_the_air_carry_until_they_have_followed(table: pd.DataFrame, tmp_path: Path) -> None:
    """Commands of zero while the vehicle still hangs on its slow rotors are no ground."""
    lag, speed = 0.3, np.sqrt(0.6 * 9.81 / 4.8e-6)
    slow, quick = (
        replace(ROBOT, rotor=replace(ROBOT.rotor, time_constant_up=s, time_constant_down=s)) for s in (lag, 1e-3)
    )
    log = on_ground(table, 400, idle=speed).rename(columns=dict(zip(ROTORS, COMMANDS, strict=True)))
    cut = on_ground(table, 30, idle=0.0).rename(columns=dict(zip(ROTORS, COMMANDS, strict=True)))
    share = np.exp(-2.0 * np.arange(30) / RATE / lag)
    cut[["acc_x", "acc_y", "acc_z"]] *= share[:, None]
    cut["v_z"] = 9.81 * np.cumsum(share - 1.0) / RATE
    path = join_parts([log, cut], tmp_path)
    assert rows_on_ground(read_flight_log(path), slow) is None
    # With quick rotors nothing but the ground would carry it.
    assert rows_on_ground(read_flight_log(path), quick) is not None


def test_the_ground_is_found_without_an_accelerometer(table: pd.DataFrame, tmp_path: Path) -> None:
    whole = pd.concat([on_ground(table, 150, idle=200.0), table], ignore_index=True)
    results = load_parts([whole.drop(columns=["acc_x", "acc_y", "acc_z"])], tmp_path)
    assert results.on_ground[20:130].all()
    assert not results.on_ground[160:].any()


def test_a_drop_with_idle_rotors_is_flight(table: pd.DataFrame, tmp_path: Path) -> None:
    falling = on_ground(table, 60, idle=100.0, at=-1)
    falling[["acc_x", "acc_y", "acc_z"]] *= 0.01
    assert load_parts([table, falling], tmp_path).on_ground is None


def test_a_log_of_a_vehicle_on_the_ground_is_refused(table: pd.DataFrame, tmp_path: Path) -> None:
    ground = on_ground(table, 4000, idle=200.0, at=-1)
    with pytest.raises(DataError, match=r"stands on the ground in 8\d% of the rows: .* cut the log to the flight"):
        load_parts([table, ground], tmp_path)


def test_a_hop_is_compared_where_it_is_long_enough_and_refused_where_it_is_not(table, tmp_path) -> None:
    """The low-pass spoils 0.21 s at each end; a rollout needs the window before it and 0.1 s."""

    def hop(seconds: float) -> pd.DataFrame:
        rows = round(seconds * RATE)
        flown = table.iloc[200 : 200 + rows].reset_index(drop=True)
        before, after = (on_ground(flown, 150, idle=250.0, at=at) for at in (0, rows - 1))
        whole = pd.concat((before, flown, after), ignore_index=True)
        return whole.assign(t=np.arange(len(whole)) / RATE)

    for seconds, horizons in ((0.8, (0.1, 0.5)), (1.5, (0.1, 0.5, 1.0))):
        hopped = load_flight(write(hop(seconds), tmp_path / f"{seconds}.csv"), ROBOT, mapping=None, bandwidth=10.0)
        assert windows_of_longest_horizon([hopped], HORIZONS_S)[0] == horizons
    lowest = load_flight(write(hop(0.8), tmp_path / "low.csv"), ROBOT, mapping=None, bandwidth=10.0)
    windows = find_windows([lowest], 0.1)
    landed = np.isin(np.arange(lowest.num_rows), windows.row + 3)
    lowest = replace(lowest, on_ground=np.asarray(lowest.on_ground) | landed)
    result = replay_flights(ROBOT, [lowest], bandwidth=10.0)
    assert all(np.isfinite(rms.value) for rms in result.evaluation.residual)
    assert result.evaluation.rollout == {}
    with pytest.raises(DataError):
        load_flight(write(hop(0.3), tmp_path / "short.csv"), ROBOT, mapping=None, bandwidth=10.0)
    stands = np.ones(len(table), dtype=bool)
    stands[100:130] = False
    with pytest.raises(DataError, match="never airborne"):
        check_airborne(read_flight_log(write(table, tmp_path / "a.csv")), stands, 10.0)
