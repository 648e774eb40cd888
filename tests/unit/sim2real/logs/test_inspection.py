"""Inspection of logs: topics, flights, streams, messages and refusals as data.
Conversion of logs: a CSV file of each flight, and all topics as Parquet or MCAP, read back by other libraries.
"""

import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from scipy.signal import lfilter

from aerial_gym.cli.main import main
from aerial_gym.config import dump_yaml
from aerial_gym.errors import DataError
from aerial_gym.robots.catalog import robot_by_name
from aerial_gym.sim2real.logs.conversion import _write_parquet, convert_log
from aerial_gym.sim2real.logs.flights import scale_relative_commands
from aerial_gym.sim2real.logs.inspection import inspect_log, topic_summary
from aerial_gym.sim2real.logs.raw_log import RawLog, Topic
from aerial_gym.sim2real.logs.readers.flight_log import read_flights
from aerial_gym.sim2real.logs.readers.follow import file_lines
from aerial_gym.sim2real.logs.readers.log_readers import read_raw_log
from aerial_gym.sim2real.logs.recording import FlightLog, row_arrays
from aerial_gym.sim2real.logs.rotor_model import mean_time_constant, total_rotor_force
from tests.unit.sim2real.flat_flights import ROBOT, flight, write
from tests.unit.sim2real.logs.foxglove_files import read_and_check
from tests.unit.sim2real.logs.readers import dataflash_files
from tests.unit.sim2real.ulog_files import topics, write_ulog


@pytest.fixture(scope="module")
def table() -> pd.DataFrame:
    return flight(5, seconds=6.0, rate=200.0)


def test_a_topic_has_rate_span_and_longest_gap() -> None:
    time = np.concatenate((np.arange(100) * 0.01, 2.0 + np.arange(100) * 0.01, [np.nan]))
    summary = topic_summary(Topic(name="imu", instance=2, time=time, columns={}))
    assert (summary.name, summary.instance, summary.samples) == ("imu", 2, 201)
    assert (summary.rate, summary.start) == (pytest.approx(100.0), 0.0)
    assert (summary.end, summary.longest_gap) == (pytest.approx(2.99), pytest.approx(1.01))
    for stamps in (np.zeros(1), np.repeat(np.arange(5.0), 40) + np.tile(np.arange(40) * 8e-6, 5)):  # the last: bursts
        assert topic_summary(Topic(name="one", time=stamps, columns={})).rate is None


def test_a_flight_that_comparisons_refuse_says_so(table: pd.DataFrame, tmp_path: Path, capsys) -> None:
    for step, slow in ((10, False), (20, True)):
        (one,) = inspect_log(write(table.iloc[::step], tmp_path / "a.csv")).flights
        assert (one.refusal is not None) is slow
        assert main(["log", "inspect", str(tmp_path / "a.csv")]) == int(slow)
        assert ("next: " in capsys.readouterr().out) is not slow


def test_a_ulog_has_flights_with_native_rates(table: pd.DataFrame, tmp_path: Path) -> None:
    results = topics(table)
    stamp = results["esc_status"]["timestamp"]
    results["actuator_armed"] = {"timestamp": stamp[::40], "armed": (stamp[::40] > 6_000_000).astype(float)}
    log = inspect_log(write_ulog(tmp_path / "a.ulg", results))
    assert (log.raw.format, len(log.topics), log.refusals) == ("ulog", 7, ())
    ((start, end),) = log.armed
    assert (start, end) == (pytest.approx(6.2, abs=0.21), pytest.approx(10.8, abs=0.21))
    (one,) = log.flights
    assert (one.start, one.ended_by) == (pytest.approx(start, abs=0.01), "log_end")
    assert one.rate == pytest.approx(200.0, rel=1e-3)
    assert one.streams["attitude"].rate == pytest.approx(100.0, rel=1e-3)
    assert one.battery == (15.0, 15.0)
    mapping = log.as_mapping()
    rates = {one["name"]: one["rate_hz"] for one in mapping["topics"]}
    assert rates["vehicle_attitude"] == pytest.approx(100.0, rel=1e-3)
    assert mapping["flights"][0]["streams"]["attitude"]["source"] == "vehicle_attitude[0]"


@pytest.mark.parametrize(("name", "value"), [("SYS_HITL", 1.0), ("SYS_HITL", 0.0)])
def test_a_log_of_a_simulation_is_named(name: str, value: float, table: pd.DataFrame, tmp_path: Path) -> None:
    log = inspect_log(write_ulog(tmp_path / "a.ulg", topics(table), {name: value}))
    assert [note.values["evidence"] for note in log.notes if note.code == "log_simulated"] == [["SYS_HITL = 1"]] * int(
        value
    )
    assert log.flights[0].vertical_force == pytest.approx(9.81, abs=0.02)


@pytest.mark.parametrize(
    ("columns", "sensor"), [(("omega_x", "omega_y", "omega_z"), "gyro"), (("acc_x", "acc_y"), "accelerometer")]
)
def test_a_sensor_at_rest_in_flight_is_named(columns, sensor, table: pd.DataFrame, tmp_path: Path) -> None:
    """Noise without motion has gain 0 on the motion; the sound sensors of the same flight are not named."""
    draw = np.random.default_rng(0)
    rest = table.assign(**{name: 0.01 * draw.normal(size=len(table)) for name in columns})
    if sensor == "accelerometer":
        rest["acc_z"] = 9.81 + 0.01 * draw.normal(size=len(table))
    log = inspect_log(write(rest, tmp_path / "a.csv"))
    notes = [note for note in log.flights[0].notes if note.code == "sensor_at_rest"]
    assert [note.values["sensor"] for note in notes] == [sensor]
    assert abs(notes[0].values["gain"]) < 0.1
    assert not inspect_log(write(table, tmp_path / "b.csv")).flights[0].notes
    scaled = inspect_log(write(table.assign(acc_z=0.4 * table["acc_z"]), tmp_path / "c.csv")).flights[0]
    assert [note.code for note in scaled.notes] == ["vertical_force_off"]


def test_an_inspection_needs_no_torch() -> None:
    """Its import takes longer than reading most logs."""
    code = "import sys, aerial_gym.sim2real.logs.inspection; sys.exit('torch' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0


def test_a_log_without_a_flight_still_lists_its_topics(table: pd.DataFrame, tmp_path: Path) -> None:
    results = {name: part for name, part in topics(table).items() if name == "battery_status"}
    log = inspect_log(write_ulog(tmp_path / "a.ulg", results))
    assert (log.flights, [one.name for one in log.topics]) == ((), ["battery_status"])
    assert len(log.refusals) == 1


def test_a_csv_file_has_one_topic(table: pd.DataFrame, tmp_path: Path) -> None:
    log = inspect_log(write(table, tmp_path / "a.csv"))
    assert (log.raw.format, [one.samples for one in log.topics]) == ("csv", [len(table)])
    assert log.flights[0].streams["ang_vel"].rate == pytest.approx(200.0, rel=1e-3)
    bad = inspect_log(write(table.drop(columns=["q_x"]), tmp_path / "b.csv"))
    assert (bad.flights, len(bad.refusals)) == ((), 1)
    other = inspect_log(write(table.rename(columns={"t": "stamp"}), tmp_path / "c.csv"))
    assert (other.flights, len(other.refusals)) == ((), 1)
    assert other.raw.metadata["columns"].startswith("stamp, p_x")


def test_a_number_selects_one_flight(table: pd.DataFrame, tmp_path: Path) -> None:
    path = write_ulog(tmp_path / "a.ulg", topics(table))
    assert [one.path for one in inspect_log(f"{path}#1").flights] == [f"{path}#1"]
    with pytest.raises(DataError, match="holds 1 flights"):
        inspect_log(f"{path}#2")
    with pytest.raises(DataError, match="holds 1 flights"):
        inspect_log(f"{write(table, tmp_path / 'a.csv')}#2")


@pytest.mark.parametrize(
    ("head", "word"),
    [
        *(
            (b"\x1f\x8b\x08\0", "gzip"),
            (b"PK\x03\x04\0", "zip"),
            (b"ab\0c", "log-formats"),
            (b"ULogEnc\x01", "private key"),
        ),
        *(
            (b"MATLAB 5.0 MAT-file", "MATLAB"),
            (b"\x89HDF\r\n\x1a\n", "HDF5"),
            (b"PAR1", "Parquet"),
            (b"\xfd\x1c\0\0", "tlog"),
        ),
    ],
)
def test_packed_and_unknown_files_are_refused(head: bytes, word: str, tmp_path: Path) -> None:
    (tmp_path / "a.ulg").write_bytes(head + bytes(100))
    with pytest.raises(DataError, match=word):
        inspect_log(tmp_path / "a.ulg")
    with pytest.raises(DataError, match="folder"):
        inspect_log(tmp_path)


def test_a_binary_log_has_no_lines_to_follow(table: pd.DataFrame, tmp_path: Path) -> None:
    path = write_ulog(tmp_path / "a.ulg", topics(table))
    for name in (path, Path(f"{path}#1")):
        with pytest.raises(DataError, match="without --follow"):
            next(file_lines(name, follow=True))


def test_unequal_numbers_of_speeds_and_commands_are_refused() -> None:
    log = FlightLog(
        path="a", time=np.arange(3.0), attitude=np.zeros((3, 4)), rotor_speed=np.ones((3, 1)),
        rotor_command=np.ones((3, 4)), relative_commands=True,
    )  # fmt: skip
    with pytest.raises(DataError, match="1 rotor speeds and 4 commands"):
        scale_relative_commands(log, robot_by_name("tinyprop"))


def test_a_full_command_is_that_of_steady_speeds_whatever_the_lag() -> None:
    """Quick commands, and rotors with a fifth more lag than declared: 300 + 1500 u rad/s."""
    robot, rate = robot_by_name("tinyprop"), 200.0
    share = np.random.default_rng(0).uniform(0.2, 0.8, (2000, 4))
    kept = np.exp(-1.0 / (rate * 1.2 * mean_time_constant(robot)))
    speed = lfilter([0.0, 1.0 - kept], [1.0, -kept], 300.0 + 1500.0 * share, axis=0)[400:]
    log = FlightLog(
        path="a", time=np.arange(1600) / rate, attitude=np.tile((0.0, 0.0, 0.0, 1.0), (1600, 1)), rotor_speed=speed,
        rotor_command=share[400:], relative_commands=True,
    )  # fmt: skip
    (note,) = scale_relative_commands(log, robot).notes
    assert note.values["full"] == pytest.approx(1800.0, rel=0.01)


@pytest.mark.parametrize("late", [-0.006, 0.0, 0.006])
def test_a_full_command_is_that_of_steady_speeds_whatever_the_delay(late: float) -> None:
    """Rotors behind a tenth more lag than declared, in closed form; a delay left out costs a quick flight 1 % of its slope."""
    robot, time, rng = robot_by_name("tinyprop"), np.arange(0.0, 10.0, 0.005), np.random.default_rng(0)
    angle, size = 2.0 * np.pi * rng.uniform(1.0, 8.0, (6, 4)), 0.06 * np.exp(1j * rng.uniform(0.0, 6.0, (6, 4)))
    waves = size * np.exp(1j * angle * time[:, None, None])
    lag = np.exp(-1j * angle * late) / (1.0 + 1j * angle * 1.1 * mean_time_constant(robot))
    log = FlightLog(
        path="a", time=time, attitude=np.tile((0.0, 0.0, 0.0, 1.0), (time.size, 1)), relative_commands=True,
        rotor_speed=300.0 + 1500.0 * (0.5 + (lag * waves).sum(axis=1).real), rotor_command=0.5 + waves.sum(axis=1).real,
    )  # fmt: skip
    (note,) = scale_relative_commands(log, robot).notes
    assert note.values["full"] == pytest.approx(1800.0, rel=0.001)


@pytest.mark.parametrize("force", [True, False])
def test_shares_are_scaled_by_the_flight_without_the_ground_or_an_accelerometer(force: bool) -> None:
    """On the ground for half the time; in hover each of 4 rotors carries a quarter of the weight at a share of 0.5."""
    robot, rows = robot_by_name("base_quadrotor"), 800
    share = np.full((rows, 4), 0.5)
    share[: rows // 2] = 0.02
    level = np.tile((0.0, 0.0, 0.0, 1.0), (rows, 1))
    given = {"specific_force": np.tile((0.0, 0.0, 9.81), (rows, 1))} if force else {"lin_vel": np.zeros((rows, 3))}
    log = FlightLog(
        path="a.csv", time=0.01 * np.arange(rows), attitude=level, ang_vel=np.zeros((rows, 3)), rotor_command=share,
        relative_commands=True, **given,
    )  # fmt: skip
    scaled = scale_relative_commands(log, robot).rotor_command
    thrust = total_rotor_force(robot, scaled[-1:])
    assert thrust[0] == pytest.approx(robot.body.mass * 9.81, rel=1e-3)


def assert_same_flights(originals: list[FlightLog], copies: list[FlightLog], tolerance: float = 0.0) -> None:
    for original, copy in zip(originals, copies, strict=True):
        arrays, expected = ({n: v for n, v in row_arrays(one).items() if n != "lines"} for one in (copy, original))
        assert arrays.keys() == expected.keys()
        for name, values in expected.items():
            np.testing.assert_allclose(arrays[name], values, rtol=0.0, atol=tolerance, err_msg=name)
        for name in ("streams", "torques", "relative_commands", "attitude_integrated"):
            assert getattr(copy, name) == getattr(original, name) or tolerance > 0.0


@pytest.mark.parametrize("kind", ["speeds", "slow shares", "no attitude"])
def test_flights_as_csv_are_the_flights_of_the_log(kind: str, table: pd.DataFrame, tmp_path: Path) -> None:
    """Also slow commands in shares, which show no torques, and a missing attitude, which the gyro gives."""
    results = topics(pd.concat([table, table.assign(t=table["t"] + 10.0)]))
    if kind == "slow shares":
        stamp = results.pop("esc_status")["timestamp"][::10]
        wave = 0.5 + 0.1 * np.sin(1e-6 * stamp.astype(float))
        results["actuator_motors"] = {"timestamp": stamp} | {f"control[{i}]": wave for i in range(4)}
    if kind == "no attitude":
        del results["vehicle_attitude"]
    path = write_ulog(tmp_path / "a.ulg", results)
    files = convert_log(path, "csv", tmp_path / "out")
    assert len(files) == 2
    assert_same_flights(read_flights([path]), read_flights(files))


def test_setpoints_and_firmware_survive_csv(table: pd.DataFrame, tmp_path: Path) -> None:
    """Setpoints at 20 Hz, linear between samples and missing for a second, and the numbers of the control law."""
    results, count = topics(table), len(table) // 10
    stamp = results["esc_status"]["timestamp"][::5]
    fields = {"roll": np.sin(np.arange(count)), "pitch": np.zeros(count), "yaw": np.ones(count)}
    part = np.abs(stamp - stamp[count // 2].astype(float)) > 500_000
    results["vehicle_rates_setpoint"] = {name: one[part] for name, one in ({"timestamp": stamp} | fields).items()}
    path = write_ulog(tmp_path / "a.ulg", results, {"MC_ROLLRATE_P": 0.125, "B": np.nan})
    (original,), (copy,) = read_flights([path]), read_flights(convert_log(path, "csv", tmp_path / "out"))
    assert (copy.log_format, dict(copy.parameters)) == ("ulog", {"MC_ROLLRATE_P": 0.125, "B": "nan"})
    (time, values), (rows, asked) = (log.setpoints["rate_setpoint"] for log in (original, copy))
    np.testing.assert_allclose(asked[:, 0], np.interp(rows, time, values[:, 0]), atol=1e-9)
    assert np.diff(rows).max() == pytest.approx(1.0, abs=0.11)
    assert np.ptp(rows) == pytest.approx(np.ptp(time), abs=0.01)


@pytest.mark.parametrize("kind", ["parquet", "mcap"])
def test_a_converted_log_is_the_log(kind: str, table: pd.DataFrame, tmp_path: Path) -> None:
    pytest.importorskip("pyarrow", exc_type=ImportError)
    path = write_ulog(tmp_path / "a.ulg", topics(table), {"A": 1.5, "B": np.nan})
    file = tmp_path / "out" if kind == "parquet" else tmp_path / "out" / "a.mcap"
    convert_log(path, kind, tmp_path / "out")
    first, second = read_raw_log(path), read_raw_log(file)
    assert first is not None
    assert second is not None
    assert (second.format, second.messages, second.metadata) == (first.format, first.messages, first.metadata)
    np.testing.assert_equal(dict(second.parameters), dict(first.parameters))
    assert_same_flights(read_flights([path]), read_flights([file]), tolerance=0.0 if kind == "parquet" else 1e-7)


@pytest.mark.parametrize("kind", ["parquet", "mcap"])
def test_changes_of_parameters_are_kept(kind: str, tmp_path: Path) -> None:
    """A gain is set at 3 and at 5 s; each time has the value in force, and NaN of a column stays."""
    pytest.importorskip("pyarrow", exc_type=ImportError)
    changes = [
        dataflash_files.message("PARM", at, "ATC_RAT_RLL_P", value) for at, value in ((10**6, 0.5), (3 * 10**6, 1.0))
    ]
    changes += [dataflash_files.message("PARM", 5 * 10**6, "ATC_RAT_RLL_P", 2.0)]
    changes += [dataflash_files.message("BAT", 10**6, 1, np.nan)]
    (tmp_path / "a.bin").write_bytes(dataflash_files.log()[0] + b"".join(changes))
    convert_log(tmp_path / "a.bin", kind, tmp_path / "out")
    for file in (tmp_path / "a.bin", tmp_path / "out" / ("a.mcap" if kind == "mcap" else "")):
        raw = read_raw_log(file)
        assert raw is not None
        assert [raw.parameters_in_force(at)["ATC_RAT_RLL_P"] for at in (2.0, 4.0, 6.0)] == [0.5, 1.0, 2.0]
        assert [(one.time, one.before) for one in raw.parameter_changes] == [(3.0, 0.5), (5.0, 1.0)]
        battery = next(one for one in raw.topics if one.source == "BAT[1]")
        np.testing.assert_array_equal(battery.columns["Volt"], [np.nan])


EMPTY_EXPORT = {"aerial_gym_log": 1, "topics": {}, "messages": [], "format": "ulog", "metadata": {}}


@pytest.mark.parametrize(
    "text",
    [
        '{"aerial_gym_log": 1}',
        '{"aerial_gym_log": 1, "topics": {"a": {}}}',
        '{"aerial_gym_log": 1, "topics": 3}',
        json.dumps(EMPTY_EXPORT | {"parameters": {"A": 10**400}}),
        "{",
    ],
)
def test_a_damaged_folder_is_refused(text: str, tmp_path: Path) -> None:
    (tmp_path / "metadata.json").write_text(text)
    with pytest.raises(DataError):
        read_flights([tmp_path])


@pytest.mark.parametrize("kind", ["parquet", "mcap"])
@pytest.mark.parametrize("source", ["csv", "ulog"])
def test_a_converted_csv_file_is_the_flight(source: str, kind: str, table: pd.DataFrame, tmp_path: Path) -> None:
    """Also one that was converted from a ULog, with its facts; all values are the same bit for bit."""
    pytest.importorskip("pyarrow", exc_type=ImportError)
    log = write(table, tmp_path / "a.csv")
    if source == "ulog":
        (log,) = convert_log(write_ulog(tmp_path / "a.ulg", topics(table), {"A": 1.5}), "csv", tmp_path)
    files = convert_log(log, kind, tmp_path / "out")
    assert_same_flights(
        read_flights([log]), read_flights([tmp_path / "out" if kind == "parquet" else files[0]]), tolerance=0.0
    )
    assert inspect_log(files[0].parent if kind == "parquet" else files[0]).flights[0].refusal is None


@pytest.mark.parametrize("name", ["nothing", "log_export"])
def test_a_log_of_an_unknown_format_is_refused(name: str, tmp_path: Path) -> None:
    (tmp_path / "metadata.json").write_text(json.dumps(EMPTY_EXPORT | {"parameters": {}, "format": name}))
    with pytest.raises(DataError, match=name):
        read_flights([tmp_path])


def test_mcap_shows_vehicle_path_states_and_residuals(table: pd.DataFrame, tmp_path: Path) -> None:
    """The residual of a rotor speed is 0 within the rounding of the table, and lies on the flight's own time."""
    pytest.importorskip("mcap")
    (tmp_path / "robot.yaml").write_text(dump_yaml(ROBOT))
    shifted = table.assign(t=table["t"] + 100.0)
    command = ["log", "convert", str(write(shifted, tmp_path / "a.csv")), "--to", "mcap", "--out", str(tmp_path)]
    assert main([*command, "--robot", str(tmp_path / "robot.yaml")]) == 0
    seen = read_and_check(tmp_path / "a.mcap")
    assert len(seen["/flight_1/vehicle"][0][1]["entities"][0]["cylinders"]) == 4
    assert [row["p_x"] for _, row in seen["/flight_1/state"]] == shifted["p_x"].tolist()
    poses = {at: message["pose"]["position"] for at, message in seen["/flight_1/pose"]}
    row = int(np.argmin(np.abs(shifted["t"] - 103.0)))
    assert poses[103_000_000_000]["x"] == pytest.approx(shifted["p_x"][row], abs=1e-6)
    times, residuals = zip(*seen["/flight_1/residual"], strict=True)
    assert 1e9 * shifted["t"].iloc[0] <= times[0] < times[-1] <= 1e9 * shifted["t"].iloc[-1] + 1
    assert max(abs(one["specific_force_z"]) for one in residuals) < 0.1
    assert main([*command[:4], "csv", "--out", str(tmp_path / "b"), "--robot", str(tmp_path / "robot.yaml")]) == 2


def test_bad_facts_are_refused(table: pd.DataFrame, tmp_path: Path) -> None:
    (file,) = convert_log(write_ulog(tmp_path / "a.ulg", topics(table)), "csv", tmp_path)
    _, _, rest = file.read_text().partition("\n")
    streams = '{"streams": {"ang_vel": {"source": "a", "rate": -1.0}}}'
    for facts in ("", "[" * 5000, "[]", '{"torque": true}', '{"streams": 3}', streams):
        file.write_text(f"# flight: {facts}\n{rest}")
        with pytest.raises(DataError, match="line 1"):
            read_flights([file])


def test_relative_commands_have_their_own_columns(table: pd.DataFrame, tmp_path: Path) -> None:
    results = topics(table)
    stamp = results.pop("esc_status")["timestamp"]
    results["actuator_motors"] = {"timestamp": stamp} | {f"control[{i}]": np.full(stamp.size, 0.5) for i in range(4)}
    (file,) = convert_log(write_ulog(tmp_path / "a.ulg", results), "csv", tmp_path)
    columns = set(pd.read_csv(file, comment="#"))
    assert {"share_1", "share_4"} < columns
    assert "cmd_1" not in columns


def test_parquet_holds_every_column_with_its_type(table: pd.DataFrame, tmp_path: Path) -> None:
    parquet = pytest.importorskip("pyarrow.parquet", exc_type=ImportError)
    results = topics(table)
    *files, meta = convert_log(write_ulog(tmp_path / "a.ulg", results, {"A": 1.5, "B": np.nan}), "parquet", tmp_path)
    assert {file.name for file in files} == {f"{name}.0.parquet" for name in results}
    for name, fields in results.items():
        columns = parquet.read_table(tmp_path / f"{name}.0.parquet").to_pydict()
        for key, values in fields.items():
            np.testing.assert_array_equal(columns[key], values)
    content = json.loads(meta.read_text())
    assert content["parameters"] == {"A": 1.5, "B": "nan"}
    assert content["topics"]["esc_status.0"]["name"] == "esc_status"


def test_parquet_loses_no_topic_and_no_column_to_another_of_its_name(tmp_path: Path) -> None:
    """``/a/b`` and ``/a_b`` have one file name without signs, and a blackbox has a column ``time``."""
    parquet = pytest.importorskip("pyarrow.parquet", exc_type=ImportError)
    seconds = np.arange(3.0)
    topics = tuple(Topic(name=name, time=seconds, columns={"time": 1e6 * seconds}) for name in ("/a/b", "/a_b"))
    files = _write_parquet(RawLog(path="a", format="ros", topics=topics), tmp_path)
    assert len(set(files)) == 3
    content = parquet.read_table(files[1]).to_pydict()
    np.testing.assert_array_equal(content["time"], seconds)
    np.testing.assert_array_equal(content["time_logged"], 1e6 * seconds)


def test_mcap_holds_every_sample(table: pd.DataFrame, tmp_path: Path) -> None:
    reader = pytest.importorskip("mcap.reader")
    results = topics(table)
    (file,) = convert_log(write_ulog(tmp_path / "a.ulg", results), "mcap", tmp_path)
    with file.open("rb") as stream:
        messages = list(reader.make_reader(stream).iter_messages(topics=["vehicle_attitude[0]"]))
    attitude = results["vehicle_attitude"]
    np.testing.assert_array_equal([m.log_time // 1000 for _, _, m in messages], attitude["timestamp"])
    np.testing.assert_array_equal([json.loads(m.data)["q[0]"] for _, _, m in messages], attitude["q[0]"])


def test_a_full_command_is_that_of_steady_speeds_if_rotors_fall_slower_than_they_rise() -> None:
    """Falls that take 1.6 times as long lift the mean speed of a quick flight."""
    robot, time, rng = robot_by_name("tinyprop"), np.arange(0.0, 10.0, 0.001), np.random.default_rng(0)
    angle, phase = 2.0 * np.pi * rng.uniform(0.5, 6.0, (6, 4)), rng.uniform(0.0, 6.0, (6, 4))
    share = 0.5 + 0.06 * np.sin(angle * time[:, None, None] + phase).sum(axis=1)
    speed, lag = np.empty_like(share), mean_time_constant(robot)
    speed[0] = share[0]
    for k in range(len(share) - 1):
        away = share[k] - speed[k]
        speed[k + 1] = speed[k] + np.where(away > 0.0, 1e-3 / lag, 1e-3 / (1.6 * lag)) * away
    log = FlightLog(
        path="a", time=time[::5], attitude=np.tile((0.0, 0.0, 0.0, 1.0), (2000, 1)), relative_commands=True,
        rotor_speed=300.0 + 1500.0 * speed[::5], rotor_command=share[::5],
    )  # fmt: skip
    (note,) = scale_relative_commands(log, robot).notes
    assert note.values["full"] == pytest.approx(1800.0, rel=0.003)
