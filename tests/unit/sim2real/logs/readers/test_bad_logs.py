"""Logs with bad rows, stamps or headers: the flight is read without them, each fault is noted, and nothing is sorted."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from aerial_gym.errors import DataError
from aerial_gym.sim2real import FlightLog, find_mapping, read_flight_log
from aerial_gym.sim2real.findings import Finding
from aerial_gym.sim2real.logs.flights import load_flights, resample_log
from aerial_gym.sim2real.logs.readers.ulog import merge_topics
from tests.unit.sim2real.flat_flights import ROBOT, flight, load_tables, write
from tests.unit.sim2real.ulog_files import topics, write_ulog


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
    log = read_flight_log(write(broken, tmp_path / "a.csv"))
    check_rows(log, table.drop(index=[7, 300]))
    assert any(note.values.get("lines") == [9, 302] for note in log.notes)


@pytest.mark.parametrize("empty", ["nan", "NaN", "null", ""])
def test_words_for_no_value_are_empty_fields(empty: str, table: pd.DataFrame, tmp_path: Path) -> None:
    broken = table.astype({"acc_z": object}).assign(p_x=empty, p_y=empty, p_z=empty)
    broken.loc[7, "acc_z"] = empty
    log = read_flight_log(write(broken, tmp_path / "a.csv"))
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


# --- ULog ---------------------------------------------------------------------------------------------------------------


def px4(result: dict[str, dict[str, np.ndarray]]) -> tuple[pd.DataFrame, list[str]]:
    notes: list[Finding] = []
    return merge_topics(result, "a.ulg", notes)[0], notes


def change_stamps(name: str, change: Callable[[np.ndarray], object], table: pd.DataFrame, key: str = "timestamp"):
    results = topics(table)
    results[name] |= {key: np.asarray(change(results[name]["timestamp"].copy()))}
    return results


@pytest.mark.parametrize("name", list(topics(flight(2, seconds=1.0))))
def test_one_absurd_stamp_costs_one_sample(name: str, table: pd.DataFrame) -> None:
    good, _ = px4(topics(table))
    bad = 200 if len(topics(table)[name]["timestamp"]) > 200 else 5
    late = np.uint64(40_000_000)
    results, notes = px4(change_stamps(name, lambda t: t + late * (np.arange(t.size) == bad).astype(np.uint64), table))
    assert len(good) - len(results) <= 1
    assert results["t"].iloc[-1] == good["t"].iloc[-1]
    assert any(note.values["topic"] == name and note.values.get("places") == [bad] for note in notes)


@pytest.mark.parametrize("stamps", [lambda t: 0 * t, lambda t: t + np.uint64(10**12), lambda t: t[::-1]])
@pytest.mark.parametrize("name", ["battery_status", "vehicle_local_position"])
def test_an_optional_topic_with_bad_stamps_is_left_out(name: str, stamps: Callable, table: pd.DataFrame) -> None:
    good, _ = px4(topics(table))
    results, notes = px4(change_stamps(name, stamps, table))
    assert set(good) - set(results) <= {"voltage", *(f"{q}_{axis}" for q in "pv" for axis in "xyz")}
    assert abs(len(results) - len(good)) <= 4
    assert ("topic_left_out", name) in [(note.code, note.values["topic"]) for note in notes]


def test_a_sample_stamp_that_is_on_no_clock_gives_way_to_that_of_the_message(table: pd.DataFrame) -> None:
    good, _ = px4(topics(table))
    for stamps in (lambda t: 0 * t, lambda t: t - np.uint64(4_000_000), lambda t: t + np.uint64(10**12)):
        results, _ = px4(change_stamps("vehicle_local_position", stamps, table, "timestamp_sample"))
        pd.testing.assert_frame_equal(results, good)


def test_a_counter_of_32_bits_in_one_topic_is_unwrapped(table: pd.DataFrame) -> None:
    results = topics(table)
    for part in results.values():
        part["timestamp"] = part["timestamp"] + np.uint64(2**32 - 7_000_000)
    good, _ = px4(results)
    results["esc_status"]["timestamp"] = results["esc_status"]["timestamp"] % np.uint64(2**32)
    pd.testing.assert_frame_equal(px4(results)[0], good, atol=1e-9)
    for part in results.values():
        part["timestamp"] = part["timestamp"] % np.uint64(2**32)
    pd.testing.assert_frame_equal(px4(results)[0], good, atol=1e-9)


def test_a_clock_set_back_in_all_topics_is_corrected_by_one_amount(table: pd.DataFrame, tmp_path: Path) -> None:
    good, _ = px4(topics(table))
    results = topics(table)
    del results["battery_status"]
    for part in results.values():
        part["timestamp"] = part["timestamp"] - np.where(part["timestamp"] > 7_003_000, 1_500_000, 0).astype(np.uint64)
    table_of, notes = px4(results)
    columns = ["t", "q_x", "q_y", "q_z", "q_w", "p_x", "rpm_1"]  # means of other samples differ by their noise
    pd.testing.assert_frame_equal(table_of[columns], good[columns], rtol=1e-5, atol=1e-6)
    assert "clock_set_back" in [note.code for note in notes]


def test_topics_that_are_needed_are_named_where_their_stamps_are_bad(table: pd.DataFrame, tmp_path: Path) -> None:
    pytest.importorskip("pyulog", reason="pyulog is not installed: pip install 'aerial-gym[sim2real]'")
    with pytest.raises(DataError, match="esc_status"):
        read_flight_log(write_ulog(tmp_path / "a.ulg", change_stamps("esc_status", lambda t: 0 * t, table)))
    with pytest.raises(DataError, match="vehicle_attitude"):
        read_flight_log(write_ulog(tmp_path / "b.ulg", change_stamps("vehicle_attitude", lambda t: 0 * t, table)))
    log = read_flight_log(write_ulog(tmp_path / "c.ulg", change_stamps("battery_status", lambda t: 0 * t, table)))
    assert log.battery is None
    assert find_mapping("px4_ulog").battery is not None


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


def test_two_exchanged_blocks_of_a_topic_cost_nothing(table: pd.DataFrame) -> None:
    good, few = px4(topics(table))
    results = topics(table)
    rows = np.arange(len(table))
    rows[100:300] = np.roll(rows[100:300], 80)
    gyro = results["vehicle_angular_velocity"]
    results["vehicle_angular_velocity"] = {name: values[rows] for name, values in gyro.items()}
    mended, notes = px4(results)
    pd.testing.assert_frame_equal(mended, good)
    assert len(notes) == len(few) + 1
