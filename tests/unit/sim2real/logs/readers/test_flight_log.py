"""Reading logs: the contract, foreign layouts, and a clear sentence for everything that is wrong with a file."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from scipy.spatial.transform import Rotation

from aerial_gym.errors import ConfigError, DataError, UnknownNameError
from aerial_gym.sim2real.findings import Finding
from aerial_gym.sim2real.logs.flights import load_flights
from aerial_gym.sim2real.logs.readers import follow
from aerial_gym.sim2real.logs.readers.flight_log import open_log, read_flight_log, read_flights
from aerial_gym.sim2real.logs.readers.follow import file_lines
from aerial_gym.sim2real.logs.readers.mapping import ColumnsCfg, LogMapping, find_mapping, mapping_names
from tests.refusals import assert_refused
from tests.unit.sim2real.flat_flights import ROBOT, flight, write


@pytest.fixture(scope="module")
def table() -> pd.DataFrame:
    return flight(0, seconds=3.0, rate=100.0)


def spans(table: pd.DataFrame, path: Path) -> list[tuple[float, float, str]]:
    opened = open_log(write(table, path))
    return [(one.start, one.end, one.ended_by) for one in opened.spans]


def test_a_table_is_split_at_gaps_states_and_an_impact(table: pd.DataFrame, tmp_path: Path) -> None:
    """Each flight keeps its rows and their lines in the file; without arming a gap of 1 s separates two flights."""
    other = flight(1, seconds=3.0, rate=100.0)
    two = pd.concat([table, other.assign(t=other["t"] + 4.0)], ignore_index=True)
    last = float(table["t"].iloc[-1])
    ends = [(0.0, last, "gap"), (4.0, 4.0 + last, "log_end")]
    assert spans(two, tmp_path / "a.csv") == [pytest.approx(one) for one in ends]
    logs = read_flights([tmp_path / "a.csv"])
    assert [log.name for log in logs] == ["a#1", "a#2"]
    second = read_flight_log(f"{tmp_path / 'a.csv'}#2")
    np.testing.assert_array_equal(second.lines, np.arange(len(table), 2 * len(table)) + 2)
    np.testing.assert_array_equal(second.ang_vel, other[["omega_x", "omega_y", "omega_z"]])
    with pytest.raises(DataError, match=r"give one of them: .*a\.csv#1 .*, .*a\.csv#2 \(4\.0 to 7\.0 s\)"):
        read_flight_log(tmp_path / "a.csv")
    assert [one.name for one in load_flights([tmp_path / "a.csv"], ROBOT, mapping=None, bandwidth=10.0)] == [
        "a#1", "a#2",
    ]  # fmt: skip
    armed = table.assign(armed=(table.index >= 50).astype(int))
    assert spans(armed, tmp_path / "b.csv") == [(pytest.approx(0.5), pytest.approx(last), "log_end")]
    flown = table.assign(landed=(table.index > 250).astype(int))
    assert spans(flown, tmp_path / "c.csv") == [(0.0, pytest.approx(2.51), "landing")]
    crash = flight(0, seconds=8.0, rate=100.0)
    crash.loc[750:752, "acc_z"] += 80.0
    assert spans(crash, tmp_path / "d.csv") == [(0.0, pytest.approx(7.4, abs=0.02), "impact")]


def mapping(**changes: object) -> LogMapping:
    contract = find_mapping("aerial_gym")
    return LogMapping(**{**vars(contract), **changes})


def test_a_log_comes_back_as_it_was_written(table: pd.DataFrame, tmp_path: Path) -> None:
    log = read_flight_log(write(table, tmp_path / "a.csv"))
    np.testing.assert_array_equal(log.attitude, table[["q_x", "q_y", "q_z", "q_w"]])
    np.testing.assert_array_equal(log.rotor_speed, table[[f"rotor_{n}" for n in range(1, 5)]])
    assert log.rotor_command is None
    assert log.num_rotors == 4
    assert log.name == "a"


@pytest.mark.parametrize(("change", "message"), [
    (
        lambda t: t.drop(columns=["q_x", "q_y", "q_z", "q_w"]).assign(roll=0.0, pitch=0.0, yaw=0.0),
        r"column 'q_x' is missing.*Euler angles are no quaternion: write q = qz\(yaw\) qy\(pitch\) qx\(roll\)",
    ),
    (
        lambda t: t.rename(columns={f"rotor_{n}": f"motor_{n}" for n in range(1, 5)}),
        r"needs the columns rotor_\{n\} or cmd_\{n\}; they are missing or empty\. Describe the columns .* mapping file",
    ),
    (lambda t: t.drop(columns="t"), r"a\.csv: column 't' is missing or empty"),
    (lambda t: t.drop(columns="acc_y"), r"column 'acc_y' is missing or empty while 'acc_x' is there; add it"),
    (lambda t: t.drop(columns=["q_x", "q_y", "q_z", "q_w"]), r"column 'q_x' is missing or empty.*mapping"),
    (lambda t: t.assign(cmd_1=900.0, cmd_2=900.0), r"has 4 rotor speeds and 2 commands"),
    (lambda t: t.assign(t=t["t"].round(1)), r"t is the same in \d+ rows as in the row before; its digits are"),
    (lambda t: t.assign(t=-t["t"]), r"time does not increase .*in the order in which they were measured"),
    (
        lambda t: t.assign(omega_x=t["omega_x"].where((t.index < 7) | (t.index > 12))),
        r"line 9: omega_x is empty \(NaN\) for 6 rows while other rows have it; cut the flight there",
    ),
    (lambda t: t.assign(acc_z=t["acc_z"].where(t.index % 2 == 0, np.inf)), r"line 3: acc_z = inf .* in 50% of the r"),
    (lambda t: t[:0], r"holds no rows"),
])  # fmt: skip
def test_a_bad_table_is_refused_with_the_place_and_the_way_out(table, tmp_path, change, message) -> None:
    with pytest.raises(DataError, match=message):
        read_flight_log(write(change(table), tmp_path / "a.csv"))


def test_a_column_that_appears_twice_is_refused(table: pd.DataFrame, tmp_path: Path) -> None:
    path = write(table, tmp_path / "a.csv")
    path.write_text(path.read_text().replace("acc_y", "acc_x", 1))
    assert_refused(DataError, r"column 'acc_x' appears twice", read_flight_log, path)


def test_files_that_are_no_text_or_not_there(tmp_path: Path) -> None:
    with pytest.raises(DataError, match=r"none\.csv: no such file"):
        read_flight_log(tmp_path / "none.csv")
    assert_refused(DataError, r"is a folder", read_flight_log, tmp_path)
    (tmp_path / "a.json").write_text('{\n "a": {\n  "b": 1\n }\n}\n')
    with pytest.raises(DataError, match=r"a\.json"):
        read_flight_log(tmp_path / "a.json")
    (tmp_path / "b.csv").write_bytes(b"\xff\xfd\x00\x01" * 50)
    with pytest.raises(DataError, match=r"cannot be read as text"):
        read_flight_log(tmp_path / "b.csv")


def test_a_foreign_layout_is_recognised_and_named(table: pd.DataFrame, tmp_path: Path) -> None:
    names = {"q": "q{}", "p": "p{}", "v": "v{}", "omega": "w{}", "acc": "f{}_b"}
    foreign = table.rename(columns={f"{own}_{a}": other.format(a) for own, other in names.items() for a in "xyzw"})
    with pytest.raises(DataError, match=r"Did you mean 'qx'\?.*give --mapping idsia_nanodrone"):
        read_flight_log(write(foreign, tmp_path / "a.csv"))


def test_units_order_and_gaps_of_a_mapping(table: pd.DataFrame, tmp_path: Path) -> None:
    other = table.assign(t=1e3 * table["t"], rotor_2=table["rotor_2"].where(table.index != 40))
    other[["omega_x", "omega_y", "omega_z"]] *= 180.0 / np.pi
    layout = mapping(
        time=ColumnsCfg(columns=("t",), unit="ms"),
        ang_vel=ColumnsCfg(columns=("omega_x", "omega_y", "omega_z"), unit="deg/s"),
        rotor_speed=ColumnsCfg(columns=("rotor_{n}",), fill_gap_s=0.05),
    )
    log = read_flight_log(write(other, tmp_path / "a.csv"), mapping=layout)
    np.testing.assert_allclose(log.time, table["t"], atol=1e-12)
    np.testing.assert_allclose(log.ang_vel, table[["omega_x", "omega_y", "omega_z"]], rtol=1e-12, atol=1e-15)
    assert log.rotor_speed[40, 1] == pytest.approx(0.5 * (table["rotor_2"][39] + table["rotor_2"][41]))
    filled = {"fields": 1, "first": "rotor_1", "last": "rotor_4", "held": False}
    assert log.notes == (Finding("fields_filled", "", filled),)


def test_single_empty_fields_become_lines_and_commands_hold(table: pd.DataFrame, tmp_path: Path) -> None:
    command = table[["rotor_1"]].set_axis(["cmd_1"], axis=1).assign(**{f"cmd_{n}": 700.0 + n for n in (2, 3, 4)})
    sparse = pd.concat((table, command), axis=1)
    sparse["omega_x"] = sparse["omega_x"].where(sparse.index % 4 == 0)
    sparse["cmd_1"] = sparse["cmd_1"].where((sparse.index != 50) & (sparse.index != 51))
    log = read_flight_log(write(sparse, tmp_path / "a.csv"))
    assert log.ang_vel[41, 0] == pytest.approx(0.75 * table["omega_x"][40] + 0.25 * table["omega_x"][44])
    np.testing.assert_array_equal(log.rotor_command[49:53, 0], command["cmd_1"][[49, 49, 49, 52]])
    filled = {"fields": 2, "first": "cmd_1", "last": "cmd_4", "held": True}
    assert log.notes[1] == Finding("fields_filled", "", filled)


def test_a_gap_that_is_too_long_for_its_mapping(table: pd.DataFrame, tmp_path: Path) -> None:
    gap = table.assign(rotor_2=table["rotor_2"].where((table.index < 40) | (table.index > 49)))
    layout = mapping(rotor_speed=ColumnsCfg(columns=("rotor_{n}",), fill_gap_s=0.05))
    with pytest.raises(DataError, match=r"line 42: rotor_2 is empty \(NaN\) for 10 rows"):
        read_flight_log(write(gap, tmp_path / "a.csv"), mapping=layout)


def test_north_east_down_and_forward_right_down_become_ours(table: pd.DataFrame, tmp_path: Path) -> None:
    world, body = np.array([[0.0, 1, 0], [1, 0, 0], [0, 0, -1]]), np.diag([1.0, -1, -1])
    other = table.copy()
    for columns, turn in (("p", world), ("v", world), ("omega", body), ("acc", body)):
        names = [f"{columns}_{axis}" for axis in "xyz"]
        other[names] = table[names].to_numpy() @ turn.T
    matrix = world @ Rotation.from_quat(table[["q_x", "q_y", "q_z", "q_w"]]).as_matrix() @ body
    other[["q_x", "q_y", "q_z", "q_w"]] = Rotation.from_matrix(matrix).inv().as_quat()
    layout = mapping(world_frame="ned", body_frame="frd", attitude_direction="world_to_body")
    log = read_flight_log(write(other, tmp_path / "a.csv"), mapping=layout)
    actual = Rotation.from_quat(table[["q_x", "q_y", "q_z", "q_w"]])
    assert (Rotation.from_quat(log.attitude).inv() * actual).magnitude().max() < 1e-9
    for name, prefix in (("position", "p"), ("lin_vel", "v"), ("ang_vel", "omega"), ("specific_force", "acc")):
        expected = table[[f"{prefix}_{axis}" for axis in "xyz"]]
        np.testing.assert_allclose(getattr(log, name), expected, rtol=1e-12, atol=1e-12)


def test_an_attitude_of_other_body_axes_than_the_gyro_becomes_ours(table: pd.DataFrame, tmp_path: Path) -> None:
    names = ["q_x", "q_y", "q_z", "q_w"]
    matrix = Rotation.from_quat(table[names]).as_matrix() @ np.diag([1.0, -1, -1])
    other = table.assign(**dict(zip(names, Rotation.from_matrix(matrix).as_quat().T, strict=True)))
    log = read_flight_log(write(other, tmp_path / "a.csv"), mapping=mapping(attitude_body_frame="frd"))
    assert (Rotation.from_quat(log.attitude).inv() * Rotation.from_quat(table[names])).magnitude().max() < 1e-9
    np.testing.assert_allclose(log.ang_vel, table[[f"omega_{axis}" for axis in "xyz"]], rtol=1e-12)


def test_mappings_say_what_is_wrong_with_them(tmp_path: Path) -> None:
    assert {"aerial_gym", "idsia_nanodrone"} < set(mapping_names())
    with pytest.raises(UnknownNameError, match=r"no log mapping 'px4'\. Known: aerial_gym, .*idsia_nanodrone"):
        find_mapping("px4")
    assert_refused(ConfigError, r"must be one of si, ms", ColumnsCfg, columns=("t",), unit="furlong")
    with pytest.raises(ConfigError, match=r"attitude\.columns .*must name 4 columns"):
        mapping(attitude=ColumnsCfg(columns=("q_x", "q_y", "q_z")))
    assert_refused(ConfigError, r"body_frame = 'up': must be one of flu, frd", mapping, body_frame="up")
    with pytest.raises(ConfigError, match=r"attitude_body_frame = 'ned': must be one of flu, frd"):
        mapping(attitude_body_frame="ned")
    (tmp_path / "m.yaml").write_text("summary: x\ntimes: {columns: [t]}\n")
    with pytest.raises(ConfigError, match=r"unknown field 'times'\. Did you mean 'time'\?"):
        find_mapping(tmp_path / "m.yaml")


@pytest.mark.parametrize("broken", ['"1', '1"2"', '"', '"a\n'])
def test_a_row_with_an_unbalanced_quote_is_left_out(broken: str, tmp_path: Path) -> None:
    lines = ["t,q_x,q_y,q_z,q_w,omega_x,omega_y,omega_z,rotor_1"]
    lines += [f"{0.01 * i},0,0,0,1,0,0,0,{broken if i == 5 else 900}" for i in range(10)]
    (tmp_path / "log.csv").write_text("\n".join(lines) + "\n")
    log = read_flight_log(tmp_path / "log.csv")
    np.testing.assert_allclose(log.time, np.delete(0.01 * np.arange(10), 5))
    assert log.notes[0].values["lines"][0] == 7


def test_rotors_at_rest_and_numbers_of_no_flight_are_refused(tmp_path: Path) -> None:
    resting = flight(0, seconds=3.0, rate=100.0)
    resting[[name for name in resting.columns if name.startswith("rotor")]] = 0.0
    with pytest.raises(DataError, match="rotor_1..4 .* give the declared robot no thrust"):
        load_flights([write(resting, tmp_path / "rest.csv")], ROBOT, mapping=None, bandwidth=10.0)
    far = flight(0, seconds=3.0, rate=100.0)
    far["acc_x"] = 1e300
    with pytest.raises(DataError, match="acc_x to acc_z reach 1e.300 in SI units"):
        read_flight_log(write(far, tmp_path / "far.csv"))


def follow_lines(path: Path, monkeypatch: pytest.MonkeyPatch, *writes: Callable[[], object]) -> list[str | None]:
    """Return the lines of a file to which something happens each time that no more is there."""
    left = iter(writes)

    def stop() -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(follow.time, "sleep", lambda _: next(left, stop)())
    result: list[str | None] = []
    with pytest.raises(KeyboardInterrupt):
        result.extend(file_lines(path, follow=True))
    return result


def append(path: Path, text: str) -> Callable[[], object]:
    return lambda: path.open("a", encoding="utf-8").write(text)


@pytest.mark.parametrize("way", ["truncated", "longer", "replaced", "rotated", "removed"])
def test_a_file_that_begins_anew_is_read_from_its_first_line(way, tmp_path, monkeypatch) -> None:
    path = tmp_path / "a.csv"
    path.write_text("t,x\n0,1\n1,1\n")
    new, other = "t,x\n5,2\n", tmp_path / "b.csv"
    other.write_text(new)
    begin: dict[str, list[Callable[[], object]]] = {
        "truncated": [lambda: path.write_text(""), append(path, new)],
        "longer": [lambda: path.write_text("t,x\n5,2\n6,2\n7,2\n")],
        "replaced": [lambda: other.replace(path)],
        "rotated": [lambda: path.rename(tmp_path / "a.csv.1"), lambda: other.rename(path)],
        "removed": [path.unlink, lambda: None, lambda: path.write_text(new)],
    }
    result = follow_lines(path, monkeypatch, append(path, "2,1\n"), *begin[way], append(path, "8,2\n"))
    more = ["6,2\n", "7,2\n"] if way == "longer" else []
    assert result == ["t,x\n", "0,1\n", "1,1\n", "2,1\n", None, "t,x\n", "5,2\n", *more, "8,2\n"]


def test_a_line_that_is_half_written_is_completed_first(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "a.csv"
    path.write_text("t,x\n0,")
    assert follow_lines(path, monkeypatch, append(path, "1"), append(path, "5\n")) == ["t,x\n", "0,15\n"]


def test_a_file_that_is_not_followed_ends(tmp_path: Path) -> None:
    path = tmp_path / "a.csv"
    path.write_bytes(b"\xef\xbb\xbft,x\r\n0,\xff")
    assert list(file_lines(path, follow=False)) == ["t,x\r\n", "0,\ufffd"]


def test_what_is_no_text_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "a.ulg").write_bytes(b"ULog\x01\x12\x35\x01" + bytes(100))
    (tmp_path / "b.csv").write_bytes(bytes(range(256)))
    for path in (tmp_path / "a.ulg", tmp_path / "b.csv", tmp_path, tmp_path / "none.csv"):
        with pytest.raises(DataError):
            list(file_lines(path, follow=False))

    def forbid(*_: object) -> None:
        raise PermissionError(13, "Permission denied")

    (tmp_path / "c.csv").write_text("t\n")
    monkeypatch.setattr(Path, "open", forbid)
    with pytest.raises(DataError):
        list(file_lines(tmp_path / "c.csv", follow=False))
