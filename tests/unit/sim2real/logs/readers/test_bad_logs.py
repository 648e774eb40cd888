"""Logs with bad rows, stamps or headers: the flight is read without them, each fault is noted, and nothing is sorted."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from aerial_gym.errors import DataError
from aerial_gym.sim2real import FlightLog, read_flight_log
from aerial_gym.sim2real.logs.flights import load_flights, resample_log
from tests.unit.sim2real.flat_flights import ROBOT, flight, load_tables, write


@pytest.fixture(scope="module")
def table() -> pd.DataFrame:
    return flight(2, seconds=4.0, rate=200.0, noise=1.0)


def check_rows(log: FlightLog, table: pd.DataFrame, atol: float = 0.0) -> None:
    np.testing.assert_allclose(log.time, table["t"], atol=1e-6)
    np.testing.assert_allclose(log.attitude, table[["q_x", "q_y", "q_z", "q_w"]], atol=atol)
    np.testing.assert_allclose(log.rotor_speed, table[[f"rotor_{n}" for n in range(1, 5)]], atol=atol)


def csv_lines(table: pd.DataFrame) -> list[str]:
    return table.to_csv(index=False).splitlines()


def change_lines(change: Callable[[str], str]) -> Callable[[list[str]], str]:
    return lambda lines: "\n".join(change(line) for line in lines)


def quote(line: str) -> str:
    return ",".join(f'"{field}"' for field in line.split(","))


LAYOUTS: dict[str, Callable[[list[str]], str]] = {
    "quoted header": lambda lines: "\n".join([quote(lines[0]), *lines[1:]]),
    "all quoted": change_lines(quote),
    "spaces in quotes": lambda lines: "\n".join([", ".join(f'" {n} "' for n in lines[0].split(",")), *lines[1:]]),
    "semicolons": change_lines(lambda line: line.replace(",", ";")),
    "decimal commas": change_lines(lambda line: line.replace(",", ";").replace(".", ",")),
    "quoted decimal commas": lambda lines: "\n".join(
        [lines[0], *(quote(line).replace(".", ",") for line in lines[1:])]
    ),
    "tabs": change_lines(lambda line: line.replace(",", "\t")),
    "spaces": change_lines(lambda line: line.replace(",", "  ")),
    "comma and space": change_lines(lambda line: line.replace(",", ", ")),
    "byte order mark": lambda lines: "\ufeff" + "\n".join(lines),
    "windows line ends": lambda lines: "\r\n".join(lines),
    "old line ends": lambda lines: "\r".join(lines),
    "trailing commas": change_lines(lambda line: line + ","),
    "trailing commas in the rows": lambda lines: "\n".join([lines[0], *(line + "," for line in lines[1:])]),
    "remarks": lambda lines: "\n".join(["# flight", "", "// x", lines[0], "# take-off", *lines[1:], "", "# end"]),
    "header behind #": lambda lines: "\n".join(["# made by hand", "# " + lines[0], *lines[1:]]),
    "spreadsheet": lambda lines: "\n".join(["sep=;", *(line.replace(",", ";") for line in lines)]),
    "header twice": lambda lines: "\n".join([*lines[:200], lines[0], *lines[200:]]),
    "rows twice": lambda lines: "\n".join([lines[0], *(line for line in lines[1:] for _ in range(2))]),
    "a block twice": lambda lines: "\n".join([*lines[:200], *lines[150:]]),
    "zeros at the end": lambda lines: "\n".join(lines) + "\n" + "\0" * 500,
}


@pytest.mark.parametrize(
    ("name", "encoding"), [*((name, "utf-8") for name in LAYOUTS), ("windows line ends", "utf-16")]
)
def test_tables_as_people_have_them(name: str, encoding: str, table: pd.DataFrame, tmp_path: Path) -> None:
    (tmp_path / "a.csv").write_bytes(LAYOUTS[name](csv_lines(table)).encode(encoding))
    check_rows(read_flight_log(tmp_path / "a.csv"), table)


@pytest.mark.parametrize("bad", ["1,2,3", "abc", ",".join(["x"] * 21), "\0\0\0", '"'])
def test_a_line_that_is_no_row_is_left_out(bad: str, table: pd.DataFrame, tmp_path: Path) -> None:
    lines = csv_lines(table)
    lines[51] = bad
    (tmp_path / "a.csv").write_text("\n".join(lines))
    log = read_flight_log(tmp_path / "a.csv")
    check_rows(log, table.drop(index=50))
    assert any(52 in note.values.get("lines", ()) for note in log.notes)
    assert log.lines[50] == 53


@pytest.mark.parametrize("value", ["inf", "abc", "1e300"])
def test_a_field_that_is_no_number_of_a_flight_costs_its_row(value: str, table: pd.DataFrame, tmp_path: Path) -> None:
    broken = table.astype({"acc_z": object})
    broken.loc[[7, 300], "acc_z"] = value
    broken.to_csv(tmp_path / "a.csv", index=False)
    log = read_flight_log(tmp_path / "a.csv")
    check_rows(log, table.drop(index=[7, 300]))
    assert any(note.values.get("lines") == [9, 302] for note in log.notes)


@pytest.mark.parametrize("empty", ["nan", "NaN", "null", ""])
def test_words_for_no_value_are_empty_fields(empty: str, table: pd.DataFrame, tmp_path: Path) -> None:
    broken = table.astype({"acc_z": object}).assign(p_x=empty, p_y=empty, p_z=empty)
    broken.loc[7, "acc_z"] = empty
    broken.to_csv(tmp_path / "a.csv", index=False)
    log = read_flight_log(tmp_path / "a.csv")
    assert log.position is None
    assert log.specific_force[7, 2] == pytest.approx(0.5 * (table["acc_z"][6] + table["acc_z"][8]))


def test_quaternions_of_zeros_cost_their_rows(table: pd.DataFrame, tmp_path: Path) -> None:
    broken = table.copy()
    broken.loc[[100, 101], ["q_x", "q_y", "q_z", "q_w"]] = 0.0
    log = resample_log(read_flight_log(write(broken, tmp_path / "a.csv")))
    assert log.time.size == len(table)
    np.testing.assert_allclose(np.linalg.norm(log.attitude, axis=1), 1.0)
    (note,) = (note for note in log.notes if note.code == "rows_without_quaternion")
    assert (note.values["rows"], note.values["total"]) == (2, 800)


def test_bad_voltages_cost_the_voltage_alone(table: pd.DataFrame, tmp_path: Path) -> None:
    starts = table.assign(vbat=np.where(np.arange(len(table)) < 5, 0.0, 16.0))
    np.testing.assert_allclose(read_flight_log(write(starts, tmp_path / "a.csv")).battery, 16.0)
    for number, column in enumerate((0.0, np.where(np.arange(len(table)) % 500 == 0, 16.0, np.nan))):
        log = read_flight_log(write(table.assign(vbat=column), tmp_path / f"b{number}.csv"))
        assert log.battery is None
        assert {note.code for note in log.notes} & {"battery_left_out", "battery_without_voltage"}


def set_back(table: pd.DataFrame, row: int = 450, seconds: float = 2.0) -> pd.DataFrame:
    return table.assign(t=table["t"] - seconds * (table.index >= row))


def test_a_clock_that_was_set_back_is_corrected_and_the_flight_is_the_same(table: pd.DataFrame, tmp_path: Path) -> None:
    log = read_flight_log(write(set_back(table), tmp_path / "a.csv"))
    check_rows(log, table)
    assert any(note.values.get("line") == 452 for note in log.notes)
    good, mended = (load_tables(tmp_path, [each])[0] for each in (table, set_back(table)))
    np.testing.assert_allclose(mended.attitude, good.attitude, atol=1e-9)
    np.testing.assert_allclose(mended.time, good.time, atol=1e-9)


def test_another_flight_in_the_same_file_is_refused_at_its_line(table: pd.DataFrame, tmp_path: Path) -> None:
    both = pd.concat((table, flight(9, seconds=4.0, rate=200.0, noise=1.0)), ignore_index=True)
    with pytest.raises(DataError, match="line 802"):
        read_flight_log(write(both, tmp_path / "a.csv"))


def test_a_set_back_with_lost_rows_is_refused_at_its_line(table: pd.DataFrame, tmp_path: Path) -> None:
    with pytest.raises(DataError, match="line 452"):
        read_flight_log(write(set_back(table).drop(index=range(450, 530)), tmp_path / "a.csv"))


@pytest.mark.parametrize("shift", [0.0, 0.0017])
@pytest.mark.parametrize("unique", [False, True])
def test_a_log_that_was_sorted_after_its_clock_was_set_back_is_refused(shift, unique, table, tmp_path) -> None:
    mixed = set_back(table, seconds=2.0 + shift).sample(frac=1.0, random_state=0).sort_values("t", kind="stable")
    if unique:
        mixed = mixed.assign(key=mixed["t"].round(9)).drop_duplicates("key").drop(columns="key")
    with pytest.raises(DataError):
        resample_log(read_flight_log(write(mixed, tmp_path / "a.csv")))


@pytest.mark.parametrize("columns", [[], ["p_x", "p_y", "p_z"], ["v_x", "v_y", "v_z"], ["acc_x", "acc_y", "acc_z"]])
@pytest.mark.parametrize("hold", [1, 2, 3, 4])
def test_one_flight_is_one_time_course(hold: int, columns: list[str], table: pd.DataFrame, tmp_path: Path) -> None:
    held = table.copy()
    pose = ["p_x", "p_y", "p_z", "q_x", "q_y", "q_z", "q_w"]
    held[pose] = held[pose].iloc[np.arange(len(table)) // hold * hold].to_numpy()
    resample_log(read_flight_log(write(held.drop(columns=columns), tmp_path / "a.csv")))


@pytest.mark.parametrize("lost", [1, 2, 5])
def test_rows_lost_beside_a_step_of_the_clock_do_not_make_the_motion_another(lost, table, tmp_path) -> None:
    for row in range(110, 700, 60):
        broken = set_back(table, row)
        broken.loc[row - lost : row - 1, "t"] = -7.0
        log = read_flight_log(write(broken, tmp_path / "a.csv"))
        check_rows(log, table.drop(index=range(row - lost, row)))


def test_a_loop_of_links_is_a_file_that_cannot_be_read(tmp_path: Path) -> None:
    (tmp_path / "loop.csv").symlink_to(tmp_path / "loop.csv")
    with pytest.raises(DataError):
        load_flights([tmp_path / "loop.csv"], ROBOT, mapping=None, bandwidth=10.0)


@pytest.mark.parametrize("size", [2, 35, 300])
@pytest.mark.parametrize("start", [0, 150])
def test_two_exchanged_blocks_of_a_file_cost_nothing(size, start, table, tmp_path) -> None:
    rows = np.arange(len(table))
    rows[start : start + 2 * size] = np.roll(rows[start : start + 2 * size], size)
    log = read_flight_log(write(table.iloc[rows], tmp_path / "a.csv"))
    check_rows(log, table)
    np.testing.assert_array_equal(log.lines[rows], np.arange(2, len(table) + 2))
    assert len(log.notes) == len(read_flight_log(write(table, tmp_path / "b.csv")).notes) + 1
