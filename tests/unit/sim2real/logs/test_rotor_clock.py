"""A rotor log that is further off than any clock is refused; one that a clock explains, or that tells nothing, is not."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from aerial_gym.errors import DataError
from aerial_gym.sim2real import FlightLog, read_flight_log
from aerial_gym.sim2real.logs.rotor_clock import check_rotor_clock
from aerial_gym.sim2real.logs.signals import lowpass
from tests.unit.sim2real.flat_flights import ROBOT, flight, write

ROTORS = [f"rotor_{n}" for n in range(1, 5)]


def climbs(folder: Path, late: float, *, rate: float, vigour: float = 0.1) -> FlightLog:
    """Return the log of a level vehicle whose thrust varies below 5 Hz, its rotors logged so much too late [s]."""
    rng, rows = np.random.default_rng(4), round(14.0 * rate)
    wander = lowpass(rng.standard_normal((rows, 1)), rate, 5.0)[:, 0]
    thrust = 0.6 * 9.81 * (1.0 + vigour * wander / wander.std())
    climb = thrust / 0.6 - 9.81
    table = pd.DataFrame({"t": np.arange(rows) / rate, "q_x": 0.0, "q_y": 0.0, "q_z": 0.0, "q_w": 1.0})
    table[["v_x", "v_y", "acc_x", "acc_y"]] = 0.01 * rng.standard_normal((rows, 4))
    table["v_z"] = np.cumsum(climb) / rate
    table["acc_z"] = 9.81 + climb + 0.07 * rng.standard_normal(rows)
    scatter = 1.0 + 0.003 * rng.standard_normal((rows, 4))
    table[ROTORS] = np.roll(np.sqrt(thrust / 4.8e-6), round(late * rate))[:, None] * scatter
    cut = round(rate)
    return read_flight_log(write(table[cut:-cut], folder / "a.csv"))


@pytest.mark.parametrize("rate", [100.0, 400.0])
@pytest.mark.parametrize(("late", "words"), [(0.1, "lag the accelerometer by 100 ms"), (-0.15, "lead .* by 150 ms")])
def test_a_delay_beyond_all_clocks_is_refused(tmp_path: Path, rate: float, late: float, words: str) -> None:
    with pytest.raises(DataError, match=rf"rotor_1\.\.4 {words}, more than any clock offset \(50 ms\); correct the"):
        check_rotor_clock(climbs(tmp_path, late, rate=rate), ROBOT, 10.0)


@pytest.mark.parametrize("late", [-0.04, 0.0, 0.04])
def test_a_clock_is_set_and_not_refused(tmp_path: Path, late: float) -> None:
    check_rotor_clock(climbs(tmp_path, late, rate=100.0), ROBOT, 10.0)


def test_a_thrust_that_hardly_varies_tells_no_delay(tmp_path: Path) -> None:
    check_rotor_clock(climbs(tmp_path, 0.1, rate=100.0, vigour=1e-4), ROBOT, 10.0)


def test_a_force_along_z_that_follows_the_thrust_later_is_no_delay_where_the_turning_knows_of_none(tmp_path) -> None:
    """What rotors make turns the vehicle at once and lifts it 150 ms later: refused without a gyro, and with rotors that are
    late in both."""
    table, late = flight(5), round(0.15 * 200.0)
    table["acc_z"] = np.roll(table["acc_z"], late)
    felt_late = read_flight_log(write(table[late:-late], tmp_path / "felt_late.csv"))
    check_rotor_clock(felt_late, ROBOT, 10.0)
    with pytest.raises(DataError, match="lead the accelerometer by 150 ms"):
        check_rotor_clock(replace(felt_late, ang_vel=None), ROBOT, 10.0)
    table = flight(5)
    table[ROTORS] = np.roll(table[ROTORS], -late, axis=0)
    with pytest.raises(DataError, match=r"lead the accelerometer by 1[345]0 ms"):
        check_rotor_clock(read_flight_log(write(table[late:-late], tmp_path / "rotors.csv")), ROBOT, 10.0)
