"""Rotor columns that are no rotor speeds, or come at another time, though their thrust carries the vehicle."""

from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from aerial_gym.errors import DataError
from aerial_gym.sim2real.logs.checks.rotors import interval_of_thrust_slope
from aerial_gym.sim2real.logs.readers.flight_log import read_flight_log
from aerial_gym.sim2real.logs.rotor_model import total_rotor_force
from tests.unit.sim2real.flat_flights import ROBOT, flight, load_flight, write

ROTORS = [f"rotor_{n}" for n in range(1, 5)]
COMMANDS = [f"cmd_{n}" for n in range(1, 5)]
HOVER = float(np.sqrt(0.6 * 9.81 / 4.8e-6))


@pytest.fixture(scope="module")
def table() -> pd.DataFrame:
    """Return a flight with drag and a thrust 5 % less than declared, which are no business of this check."""
    return flight(3, seconds=12.0, rate=100.0, noise=1.0, drag=0.2, thrust_scale=0.95)


def load(table: pd.DataFrame, folder: Path) -> tuple[str, ...]:
    return load_flight(write(table, folder / "a.csv"), ROBOT, mapping=None, bandwidth=10.0).notes


def test_a_pulse_width_a_duty_cycle_and_a_thrust_are_no_speeds(table: pd.DataFrame, tmp_path: Path) -> None:
    """Each is scaled so that it hovers: 1000 µs and more at rest, the square of the speed, its root."""
    share = table[ROTORS] / HOVER
    rest = {"pulse": 0.6 * HOVER + 0.4 * HOVER * share, "square": HOVER * share**2, "root": HOVER * share**0.5}
    assert load(table, tmp_path) == ()
    for values in rest.values():
        for names in (ROTORS, COMMANDS):
            wrong = table.drop(columns=ROTORS)
            wrong[names] = values.to_numpy()
            match = rf"measured force rises .* times as steeply with {names[0]}\.\.4 .* pulse width, a duty cycle or a thrust"
            with pytest.raises(DataError, match=match):
                load(wrong, tmp_path)


def test_the_slope_of_speeds_is_one_and_of_a_root_two(table: pd.DataFrame, tmp_path: Path) -> None:
    """Thrust goes with the square of the speed, so that its slope over the declared thrust of w^n is 1 / n."""
    log = read_flight_log(write(table, tmp_path / "a.csv"))
    for power in (0.5, 1.0, 2.0):
        states = HOVER * (table[ROTORS].to_numpy() / HOVER) ** power
        low, high = interval_of_thrust_slope(log, total_rotor_force(ROBOT, states), None)
        assert low < 1.0 / power < high
        assert high / low < 1.4


def test_a_hover_tells_nothing(table: pd.DataFrame, tmp_path: Path) -> None:
    """Where the thrust is noise, the slope is between 0 and infinity."""
    hover, rng = table.copy(), np.random.default_rng(2)
    hover[["acc_x", "acc_y", "acc_z"]] = (0.0, 0.0, 9.81) + 0.05 * rng.standard_normal((len(table), 3))
    log = read_flight_log(write(hover, tmp_path / "a.csv"))
    states = HOVER * (1.0 + 0.003 * rng.standard_normal((len(table), 4)))
    assert interval_of_thrust_slope(log, total_rotor_force(ROBOT, states), None) == (0.0, np.inf)
