"""Conversion of logs: a CSV file of each flight, and all topics as Parquet or MCAP, read back by other libraries."""

import json
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from aerial_gym.errors import DataError
from aerial_gym.sim2real.logs.conversion import _write_parquet, convert_log
from aerial_gym.sim2real.logs.raw_log import RawLog, Topic
from aerial_gym.sim2real.logs.readers.flight_log import read_flights
from aerial_gym.sim2real.logs.readers.log_readers import read_raw_log
from aerial_gym.sim2real.logs.recording import FlightLog, row_arrays
from tests.unit.sim2real.flat_flights import flight, write
from tests.unit.sim2real.ulog_files import topics, write_ulog


@pytest.fixture(scope="module")
def table() -> pd.DataFrame:
    return flight(5, seconds=4.0, rate=200.0)


def assert_same_flights(originals: list[FlightLog], copies: list[FlightLog], tolerance: float = 0.0) -> None:
    for original, copy in zip(originals, copies, strict=True):
        arrays = row_arrays(copy)
        assert row_arrays(original).keys() == arrays.keys() - {"lines"}
        for name, values in row_arrays(original).items():
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


@pytest.mark.parametrize(
    "text",
    [
        '{"aerial_gym_log": 1}',
        '{"aerial_gym_log": 1, "topics": {"a": {}}}',
        '{"aerial_gym_log": 1, "topics": 3}',
        "{",
    ],
)
def test_a_damaged_folder_is_refused(text: str, tmp_path: Path) -> None:
    (tmp_path / "metadata.json").write_text(text)
    with pytest.raises(DataError):
        read_flights([tmp_path])


def test_a_converted_csv_file_names_its_remedy(table: pd.DataFrame, tmp_path: Path) -> None:
    pytest.importorskip("pyarrow", exc_type=ImportError)
    convert_log(write(table, tmp_path / "a.csv"), "parquet", tmp_path / "out")
    with pytest.raises(DataError, match="give that file"):
        read_flights([tmp_path / "out"])


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
    table = parquet.read_table(files[1]).to_pydict()
    np.testing.assert_array_equal(table["time"], seconds)
    np.testing.assert_array_equal(table["time_logged"], 1e6 * seconds)


def test_mcap_holds_every_sample(table: pd.DataFrame, tmp_path: Path) -> None:
    reader = pytest.importorskip("mcap.reader")
    results = topics(table)
    (file,) = convert_log(write_ulog(tmp_path / "a.ulg", results), "mcap", tmp_path)
    with file.open("rb") as stream:
        messages = list(reader.make_reader(stream).iter_messages(topics=["vehicle_attitude[0]"]))
    attitude = results["vehicle_attitude"]
    np.testing.assert_array_equal([m.log_time // 1000 for _, _, m in messages], attitude["timestamp"])
    np.testing.assert_array_equal([json.loads(m.data)["q[0]"] for _, _, m in messages], attitude["q[0]"])
