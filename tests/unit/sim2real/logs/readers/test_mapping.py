"""Mappings of foreign layouts: conversions, missing attitude, companions."""

from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from scipy.spatial.transform import Rotation

from aerial_gym.config import build
from aerial_gym.errors import ConfigError, DataError
from aerial_gym.sim2real import FlightLog, read_flight_log
from aerial_gym.sim2real.findings import Finding
from aerial_gym.sim2real.logs.readers.mapping import LogMapping, find_mapping, mapping_names
from aerial_gym.sim2real.logs.signals import log_at_equal_steps
from aerial_gym.sim2real.predict.channels import find_channels
from tests.refusals import assert_refused
from tests.unit.sim2real.flat_flights import ROBOT, flight, load_flight, write

BASE = {
    "summary": "test", "source": "test", "time": {"columns": ["t"]},
    "attitude": {"columns": ["q_x", "q_y", "q_z", "q_w"]}, "ang_vel": {"columns": ["omega_x", "omega_y", "omega_z"]},
}  # fmt: skip


def layout(**fields: object) -> LogMapping:
    return build(LogMapping, BASE | fields, where="test")


@pytest.fixture(scope="module")
def table() -> pd.DataFrame:
    return flight(3, seconds=4.0, rate=100.0)


def read(table: pd.DataFrame, folder: Path, mapping: LogMapping, name: str = "a.csv") -> FlightLog:
    return read_flight_log(write(table, folder / name), mapping=mapping)


def test_every_mapping_of_the_package_loads_and_names_its_source() -> None:
    for name in mapping_names():
        assert find_mapping(name).source


def test_commands_from_duty_cycle_and_voltage(table: pd.DataFrame, tmp_path: Path) -> None:
    """``offset + gain pwm V``, and a motor that is off does not turn."""
    table = table.assign(vbat=4.0, pwm1=0.5, pwm2=0.25)
    table.loc[3, "pwm1"] = 0.0
    command = {"columns": ["pwm{n}"], "times": "vbat", "gain": 600.0, "offset": 500.0}
    log = read(table, tmp_path, layout(rotor_command=command, battery={"columns": ["vbat"]}))
    np.testing.assert_allclose(log.rotor_command[0], (1700.0, 1100.0))
    np.testing.assert_allclose(log.rotor_command[3], (0.0, 1100.0))
    np.testing.assert_allclose(log.battery, 4.0)


def test_a_collective_thrust_setpoint_is_a_speed_of_every_rotor_and_no_torque(table, tmp_path) -> None:
    """``500 sqrt(T / T_hover)``: four times the setpoint at hover is twice the speed."""
    table = table.assign(sp=2.0 + 0.5 * np.sin(table["t"]), hover=0.5)
    command = {"columns": ["sp"], "over": "hover", "power": 0.5, "gain": 500.0, "repeat": 4}
    mapping = layout(rotor_command=command)
    log = read(table, tmp_path, mapping)
    np.testing.assert_allclose(log.rotor_command[0], 1000.0)
    np.testing.assert_allclose(log.rotor_command[157], 500.0 * np.sqrt(4.0 + np.sin(1.57)), rtol=1e-9)
    assert log.rotor_command.shape == (len(table), 4)
    flown = load_flight(write(table, tmp_path / "b.csv"), ROBOT, mapping=mapping, bandwidth=5.0)
    assert not flown.gyro
    assert Finding("one_command") in flown.notes


def test_an_attitude_that_is_not_logged_is_integrated_from_the_gyro(table: pd.DataFrame, tmp_path: Path) -> None:
    rotors = {"columns": ["rotor_{n}"]}
    mapping = layout(attitude=None, rotor_speed=rotors, lacks="no attitude")
    log = read(table, tmp_path, mapping)
    flown, result = Rotation.from_quat(table[["q_x", "q_y", "q_z", "q_w"]]), Rotation.from_quat(log.attitude)
    np.testing.assert_allclose(log.attitude[0], (0.0, 0.0, 0.0, 1.0))
    error = ((flown[0].inv() * flown[-1]).inv() * result[-1]).magnitude()
    assert error < 2e-3
    noted = {Finding("mapping_note", "", {"text": "no attitude"}), Finding("attitude_integrated")}
    assert set(log.notes) == noted
    moving = layout(attitude=None, rotor_speed=rotors, lin_vel={"columns": ["v_x", "v_y", "v_z"]}, lacks="none logged")
    assert_refused(DataError, r"has no attitude. none logged", read, table, tmp_path, moving)


def test_the_other_vehicle_comes_from_its_own_file_and_its_gaps_stay(table: pd.DataFrame, tmp_path: Path) -> None:
    mapping = layout(
        rotor_speed={"columns": ["rotor_{n}"]},
        position={"columns": ["p_x", "p_y", "p_z"]},
        companion={"_one": "_two", "_two": "_one"},
    )
    other = table.assign(p_x=table["t"] * 2.0).drop(index=range(100, 150)).iloc[:-20]
    write(other, tmp_path / "swap_two.csv")
    log = read(table, tmp_path, mapping, "swap_one.csv")
    np.testing.assert_allclose(log.other_position[50, 0], 1.0)
    assert np.isnan(log.other_position[120]).all()
    assert np.isnan(log.other_position[-1]).all()
    assert Finding("other_vehicle", "", {"file": "swap_two.csv"}) in log.notes
    assert read(table, tmp_path, mapping, "alone.csv").other_position is None


def test_logs_that_are_too_slow_for_torques_are_compared_in_forces(table: pd.DataFrame, tmp_path: Path) -> None:
    rotors, path = {"columns": ["rotor_{n}"]}, write(table, tmp_path / "a.csv")
    for torques in (True, False):
        mapping = layout(rotor_speed=rotors, specific_force={"columns": ["acc_x", "acc_y", "acc_z"]}, torques=torques)
        flown = load_flight(path, ROBOT, mapping=mapping, bandwidth=5.0)
        kinds = {channel.kind for channel in find_channels([flown])}
        assert kinds == {"specific_force", *(("angular_acceleration", "kinematic_rate") if torques else ())}
        assert (Finding("torques_not_logged") in flown.notes) is not torques


def test_the_known_wind_comes_by_the_name_of_the_file(table: pd.DataFrame, tmp_path: Path) -> None:
    """In north, east, down a wind of (1, 2, 3) blows 2 m/s to the east, 1 to the north, 3 down."""
    mapping = layout(rotor_speed={"columns": ["rotor_{n}"]}, wind={"fan_on": [-4.2, 0, 0], "calm": [0, 0, 0]})
    log = read(table, tmp_path, mapping, "run1_fan_on.csv")
    assert log.wind == (-4.2, 0.0, 0.0)
    assert Finding("wind_declared", "", {"wind_m_s": [-4.2, 0.0, 0.0]}) in log.notes
    path = write(table, tmp_path / "calm.csv")
    assert load_flight(path, ROBOT, mapping=mapping, bandwidth=5.0).wind == (0.0, 0.0, 0.0)
    other = read(table, tmp_path, mapping, "run2.csv")
    assert other.wind is None
    assert Finding("wind_not_declared") in other.notes
    ned = layout(rotor_speed={"columns": ["rotor_{n}"]}, wind={"run": [1, 2, 3]}, world_frame="ned")
    assert read(table, tmp_path, ned, "run2.csv").wind == (2.0, 1.0, -3.0)
    with pytest.raises(DataError, match=r"declares the wind of fan_on and of calm; make the texts differ"):
        read(table, tmp_path, mapping, "calm_fan_on.csv")
    with pytest.raises(ConfigError, match=r"LogMapping.wind.run = .*: must be finite"):
        layout(wind={"run": [1.0, float("nan"), 0.0]})


def test_commands_are_scaled_to_the_thrust_measured_above_a_height(table: pd.DataFrame, tmp_path: Path) -> None:
    """Commands that are 10 % too high come back as the speeds flown, whatever stands in the rows below."""
    flown = table[["rotor_1", "rotor_2", "rotor_3", "rotor_4"]].to_numpy()
    above = float(table["p_z"].quantile(0.4))
    high = (table["p_z"] > above).to_numpy()[:, None]
    for number in range(4):
        table = table.assign(**{f"cmd_{number + 1}": np.where(high[:, 0], 1.1, 0.7) * flown[:, number]})
    fields = {
        "rotor_command": {"columns": ["cmd_{n}"]},
        "position": {"columns": ["p_x", "p_y", "p_z"]},
        "specific_force": {"columns": ["acc_x", "acc_y", "acc_z"]},
    }
    path = write(table, tmp_path / "a.csv")
    scaled = load_flight(path, ROBOT, mapping=layout(hover_above_m=above, **fields), bandwidth=5.0)
    np.testing.assert_allclose(scaled.rotor_command, np.where(high, 1.0, 0.7 / 1.1) * flown, rtol=1e-3)
    (note,) = (note for note in scaled.notes if note.code == "commands_scaled")
    assert note.values["factor"] == pytest.approx(0.909, abs=1e-3)
    as_logged = load_flight(path, ROBOT, mapping=layout(**fields), bandwidth=5.0)
    np.testing.assert_allclose(as_logged.rotor_command[0], table.loc[0, ["cmd_1", "cmd_2", "cmd_3", "cmd_4"]].tolist())
    with pytest.raises(DataError, match=r"hardly flies above 90 m"):
        load_flight(path, ROBOT, mapping=layout(hover_above_m=90.0, **fields), bandwidth=5.0)
    blind = {key: value for key, value in fields.items() if key != "position"}
    with pytest.raises(DataError, match=r"it needs position and acc"):
        load_flight(path, ROBOT, mapping=layout(hover_above_m=above, **blind), bandwidth=5.0)
    with pytest.raises(ConfigError, match=r"hover_above_m = inf: must be finite"):
        layout(hover_above_m=float("inf"))


def test_the_lowest_place_of_a_flight_is_no_ground(table: pd.DataFrame, tmp_path: Path) -> None:
    fields = {"rotor_speed": {"columns": ["rotor_{n}"]}, "position": {"columns": ["p_x", "p_y", "p_z"]}}
    path = write(table, tmp_path / "a.csv")
    for size in (0.0, 0.1):
        assert load_flight(path, ROBOT, mapping=layout(lift_off_m=size, **fields), bandwidth=5.0).on_ground is None
    assert_refused(ConfigError, r"lift_off_m = -0.1: must be >= 0", layout, lift_off_m=-0.1)


@pytest.mark.parametrize(("command", "error", "message"), [
    ({"columns": ["pwm{n}"], "times": "volt"}, DataError, r"column 'volt' is missing"),
    ({"columns": ["pwm{n}"], "over": "zero"}, DataError, r"line 2: zero = 0, must be > 0"),
    ({"columns": ["pwm{n}"], "gain": 0.0}, ConfigError, r"gain = 0.0 .*must not be 0"),
    ({"columns": ["pwm{n}"], "power": float("nan")}, ConfigError, r"power = nan: must be finite"),
    ({"columns": ["a", "b"], "repeat": 4}, ConfigError, r"repeat = 4: must be >= 1, and 1 for more than one"),
])  # fmt: skip
def test_conversions_that_cannot_be(table, tmp_path, command, error, message) -> None:
    with pytest.raises(error, match=message):
        read(table.assign(pwm1=0.5, zero=0.0), tmp_path, layout(rotor_command=command))


def test_a_piece_beyond_a_gap_at_the_end_is_cut_off_and_said(table: pd.DataFrame, tmp_path: Path) -> None:
    log = log_at_equal_steps(read_flight_log(write(table.drop(index=range(370, 385)), tmp_path / "a.csv")))
    assert log.time[-1] == pytest.approx(3.69)
    (note,) = log.notes
    assert (note.code, note.values) == ("rows_cut", {"rows": 15, "gap_s": pytest.approx(0.16, abs=0.005)})
