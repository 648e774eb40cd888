"""Columns of rotors, commands and voltage that are not what they claim to be.
Rotor columns that are no rotor speeds, or come at another time, though their thrust carries the vehicle.
"""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from scipy.spatial.transform import Rotation

from aerial_gym.errors import DataError
from aerial_gym.sim2real.logs.checks.rotors import interval_of_thrust_slope
from aerial_gym.sim2real.logs.flights import Flight
from aerial_gym.sim2real.logs.readers.flight_log import read_flight_log
from aerial_gym.sim2real.logs.rotor_model import total_rotor_force
from tests.unit.sim2real.flat_flights import ROBOT, flight, load_flight, load_tables, make_predictor, write

ROTORS, COMMANDS = ([f"{name}_{n}" for n in range(1, 5)] for name in ("rotor", "cmd"))


@pytest.fixture(scope="module")
def table() -> pd.DataFrame:
    """Return a flight with commands that lead the speeds by two rows."""
    result = flight(1, seconds=6.0, rate=100.0, noise=1.0)
    ahead = np.concatenate((result[ROTORS].to_numpy()[2:], result[ROTORS].to_numpy()[-2:]))
    return result.assign(**dict(zip(COMMANDS, ahead.T, strict=True)), vbat=np.linspace(16.0, 15.0, len(result)))


def load_log(table: pd.DataFrame, folder: Path) -> Flight:
    return load_flight(write(table, folder / "a.csv"), ROBOT, mapping=None, bandwidth=10.0)


def test_good_columns_stay(table: pd.DataFrame, tmp_path: Path) -> None:
    result = load_log(table, tmp_path)
    assert result.rotor_command is not None
    assert result.notes == ()


@pytest.mark.parametrize(("change", "message"), [
    (lambda t: t.assign(rotor_2=-t["rotor_2"]), r"rotor_2 is negative .*without sign: .*robot file \(spin\)"),
    (lambda t: t.assign(cmd_4=-t["cmd_4"]), r"cmd_4 is negative"),
])  # fmt: skip
def test_columns_that_cannot_be(table: pd.DataFrame, tmp_path: Path, change: object, message: str) -> None:
    with pytest.raises(DataError, match=message):
        load_log(change(table), tmp_path)


def test_commands_that_copy_the_speeds_are_left_out_and_said(table: pd.DataFrame, tmp_path: Path) -> None:
    result = load_log(table.assign(**dict(zip(COMMANDS, table[ROTORS].to_numpy().T, strict=True))), tmp_path)
    assert result.rotor_command is None
    assert "commands_copied" in [note.code for note in result.notes]


def test_speeds_that_some_flights_lack_are_left_out_of_all(table: pd.DataFrame, tmp_path: Path) -> None:
    """Their commands drive all flights; if a flight has none, speeds stay, and the comparison names the other kind."""
    other = flight(2, seconds=6.0, rate=100.0, noise=1.0)
    other = other.assign(**dict(zip(COMMANDS, other[ROTORS].to_numpy().T, strict=True)))
    flights = load_tables(tmp_path, [table, other.drop(columns=ROTORS)])
    assert [one.rotor_speed is None for one in flights] == [True, True]
    told = [note for one in flights for note in one.notes if note.code == "rotor_speeds_not_shared"]
    assert [note.values for note in told] == [{"without": ["f1"]}]
    assert make_predictor(flights).num_tolerances
    mixed = load_tables(tmp_path, [table.drop(columns=COMMANDS), other.drop(columns=ROTORS)])
    with pytest.raises(
        DataError, match="f1: without measured rotor speeds, but other flights have them and no commands"
    ):
        make_predictor(mixed)


@pytest.mark.parametrize("names", [ROTORS, COMMANDS])
@pytest.mark.parametrize("order", [(1, 2, 3, 0), (2, 3, 0, 1), (1, 0, 2, 3)])
def test_columns_in_another_order_are_told_by_what_they_turn(table, tmp_path, names, order) -> None:
    mixed = table.assign(**{names[k]: table[names[rotor]] for k, rotor in enumerate(order)})
    right = ", ".join(names[order.index(rotor)] for rotor in range(4))
    with pytest.raises(DataError, match=rf"in the declared order predict .* the probable order is {right}: reorder"):
        load_log(mixed, tmp_path)


@pytest.mark.parametrize("order", [(3, 2, 1, 0), (1, 0, 3, 2), (0, 2, 1, 3)])
def test_the_order_is_told_beside_wrong_moments_of_inertia(table: pd.DataFrame, tmp_path: Path, order) -> None:
    """Declared moments are 0.4, 1.5 and 1.05 times the true ones: sizes of torques are wrong, their courses are right."""
    rows = tuple(
        tuple(value * share for value in row) for row, share in zip(ROBOT.body.inertia, (0.4, 1.5, 1.05), strict=True)
    )
    robot = replace(ROBOT, body=replace(ROBOT.body, inertia=rows))
    settings = {"mapping": None, "bandwidth": 10.0}
    assert load_flight(write(table, tmp_path / "a.csv"), robot, **settings).num_rotors == 4
    mixed = table.assign(**{ROTORS[k]: table[ROTORS[rotor]] for k, rotor in enumerate(order)})
    with pytest.raises(DataError, match="in the declared order predict"):
        load_flight(write(mixed, tmp_path / "a.csv"), robot, **settings)


@pytest.mark.parametrize("axis", ["x", "y"])
def test_an_axis_with_the_wrong_sign_is_told_by_what_rotors_turn(
    axis: str, table: pd.DataFrame, tmp_path: Path
) -> None:
    """Without velocity nothing else shows it if attitude and gyro have the same error."""
    place, columns = "zyx".index(axis), ["q_x", "q_y", "q_z", "q_w"]
    angles = Rotation.from_quat(table[columns].to_numpy(copy=True)).as_euler("ZYX")
    angles[:, place] *= -1.0
    mirrored = table.drop(columns=["v_x", "v_y", "v_z", "p_x", "p_y", "p_z"])
    mirrored[columns], mirrored[f"omega_{axis}"] = Rotation.from_euler("ZYX", angles).as_quat(), -table[f"omega_{axis}"]
    with pytest.raises(DataError, match="with all spins reversed.* or correct the sign of one axis"):
        load_log(mirrored, tmp_path)


def test_spins_that_are_all_reversed_are_told(table: pd.DataFrame, tmp_path: Path) -> None:
    layout = tuple(replace(mount, spin=-mount.spin) for mount in ROBOT.mounts.layout)
    wrong = replace(ROBOT, mounts=replace(ROBOT.mounts, layout=layout))
    result = load_flight(write(table, tmp_path / "a.csv"), wrong, mapping=None, bandwidth=10.0)
    notes = [note for note in result.notes if note.code == "spins_reversed"]
    assert [note.values["columns"] for note in notes] == ["rotor_1..4"]
    for note in notes:
        assert note.values["gain_ratio"] + note.values["half_width_ratio"] < 0.0
        assert note.values["gain_ratio"] == pytest.approx(-1.0, abs=0.3)
    turned = table.rename(columns={"rotor_1": "rotor_2", "rotor_2": "rotor_1"})[table.columns]
    with pytest.raises(
        DataError, match="probable order is rotor_2, rotor_1, rotor_3, rotor_4, with all spins reversed"
    ):
        load_flight(write(turned.drop(columns=COMMANDS), tmp_path / "b.csv"), wrong, mapping=None, bandwidth=10.0)


LAW_ROTORS = [f"rotor_{n}" for n in range(1, 5)]
LAW_COMMANDS = [f"cmd_{n}" for n in range(1, 5)]
HOVER = float(np.sqrt(0.6 * 9.81 / 4.8e-6))


@pytest.fixture(scope="module")
def law_table() -> pd.DataFrame:
    """Return a flight with drag and a thrust 5 % less than declared, which are no business of this check."""
    return flight(3, seconds=12.0, rate=100.0, noise=1.0, drag=0.2, thrust_scale=0.95)


def load(law_table: pd.DataFrame, folder: Path) -> tuple[str, ...]:
    return load_flight(write(law_table, folder / "a.csv"), ROBOT, mapping=None, bandwidth=10.0).notes


def test_a_pulse_width_a_duty_cycle_and_a_thrust_are_no_speeds(law_table: pd.DataFrame, tmp_path: Path) -> None:
    """Each is scaled so that it hovers: 1000 µs and more at rest, the square of the speed, its root."""
    share = law_table[LAW_ROTORS] / HOVER
    rest = {"pulse": 0.6 * HOVER + 0.4 * HOVER * share, "square": HOVER * share**2, "root": HOVER * share**0.5}
    assert load(law_table, tmp_path) == ()
    for values in rest.values():
        for names in (LAW_ROTORS, LAW_COMMANDS):
            wrong = law_table.drop(columns=LAW_ROTORS)
            wrong[names] = values.to_numpy()
            match = rf"measured force rises .* times as steeply with {names[0]}\.\.4 .* pulse width, a duty cycle or a thrust"
            with pytest.raises(DataError, match=match):
                load(wrong, tmp_path)


def test_the_slope_of_speeds_is_one_and_of_a_root_two(law_table: pd.DataFrame, tmp_path: Path) -> None:
    """Thrust goes with the square of the speed, so that its slope over the declared thrust of w^n is 1 / n."""
    log = read_flight_log(write(law_table, tmp_path / "a.csv"))
    for power in (0.5, 1.0, 2.0):
        states = HOVER * (law_table[LAW_ROTORS].to_numpy() / HOVER) ** power
        low, high = interval_of_thrust_slope(log, total_rotor_force(ROBOT, states), None)
        assert low < 1.0 / power < high
        assert high / low < 1.4


def test_a_battery_that_sags_under_load_is_no_slope_of_the_thrust(law_table: pd.DataFrame, tmp_path: Path) -> None:
    """With speeds that follow the voltage, commands rise 1.25 times as steeply as the thrust; at constant voltage by 1."""
    log, rng = read_flight_log(write(law_table, tmp_path / "a.csv")), np.random.default_rng(3)
    speed = law_table[LAW_ROTORS].to_numpy()
    load = total_rotor_force(ROBOT, speed)
    used = np.cumsum(rng.standard_normal(len(load))) / len(load) ** 0.5  # of the charge, not in step with the load
    voltage = 16.0 - 2.0 * (load / load.mean() - 1.0) - 0.5 * used
    thrust = total_rotor_force(ROBOT, speed / (voltage / 16.0)[:, None])
    low, high = interval_of_thrust_slope(log, thrust, None)
    assert high < 1.0
    low, high = interval_of_thrust_slope(log, thrust, None, beside=voltage)
    assert low < 1.0 < high


def test_a_ceiling_that_pulls_a_hover_is_no_slope_of_the_thrust(law_table: pd.DataFrame, tmp_path: Path) -> None:
    """Where the vehicle is high it accelerates down, and a ceiling adds thrust: rotors slow down more than the force shows."""
    rng, time = np.random.default_rng(4), law_table["t"].to_numpy()
    waves = [(0.04, 2.5), (0.02, 4.0)]
    height = sum(size * np.sin(frequency * time) for size, frequency in waves)
    force = 9.81 - sum(size * frequency**2 * np.sin(frequency * time) for size, frequency in waves)
    still = dict.fromkeys(("v_x", "v_y", "v_z", "acc_x", "acc_y"), 0.0)
    hover = law_table.assign(p_z=1.0 + height, **still, acc_z=force + 0.02 * rng.standard_normal(len(time)))
    log = read_flight_log(write(hover, tmp_path / "a.csv"))
    states = HOVER * np.sqrt(force / 9.81 / (1.0 + height))[:, None].repeat(4, axis=1)
    low, high = interval_of_thrust_slope(log, total_rotor_force(ROBOT, states), None)
    assert 0.9 < low < 1.0 < high < 1.1


def test_a_hover_tells_nothing(law_table: pd.DataFrame, tmp_path: Path) -> None:
    """Where the thrust is noise, the slope is between 0 and infinity."""
    hover, rng = law_table.copy(), np.random.default_rng(2)
    hover[["acc_x", "acc_y", "acc_z"]] = (0.0, 0.0, 9.81) + 0.05 * rng.standard_normal((len(law_table), 3))
    log = read_flight_log(write(hover, tmp_path / "a.csv"))
    states = HOVER * (1.0 + 0.003 * rng.standard_normal((len(law_table), 4)))
    assert interval_of_thrust_slope(log, total_rotor_force(ROBOT, states), None) == (0.0, np.inf)
