"""Conversion of logs: a CSV file of each flight, and all topics as Parquet or MCAP, read back by other libraries."""

import json
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from aerial_gym.sim2real import read_flight_log
from aerial_gym.sim2real.logs.conversion import convert_log
from aerial_gym.sim2real.logs.recording import row_arrays
from tests.unit.sim2real.flat_flights import flight
from tests.unit.sim2real.ulog_files import topics, write_ulog


@pytest.fixture(scope="module")
def table() -> pd.DataFrame:
    return flight(5, seconds=4.0, rate=200.0)


def test_a_flight_as_csv_is_the_flight_of_the_log(table: pd.DataFrame, tmp_path: Path) -> None:
    path = write_ulog(tmp_path / "a.ulg", topics(table))
    (file,) = convert_log(path, "csv", tmp_path / "out")
    original, copy = read_flight_log(path), read_flight_log(file)
    for name, values in row_arrays(original).items():
        np.testing.assert_allclose(getattr(copy, name), values, rtol=1e-12, atol=1e-12, err_msg=name)


def test_relative_commands_have_their_own_columns(table: pd.DataFrame, tmp_path: Path) -> None:
    results = topics(table)
    stamp = results.pop("esc_status")["timestamp"]
    results["actuator_motors"] = {"timestamp": stamp} | {f"control[{i}]": np.full(stamp.size, 0.5) for i in range(4)}
    (file,) = convert_log(write_ulog(tmp_path / "a.ulg", results), "csv", tmp_path)
    columns = set(pd.read_csv(file))
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


def test_mcap_holds_every_sample(table: pd.DataFrame, tmp_path: Path) -> None:
    reader = pytest.importorskip("mcap.reader")
    results = topics(table)
    (file,) = convert_log(write_ulog(tmp_path / "a.ulg", results), "mcap", tmp_path)
    with file.open("rb") as stream:
        messages = list(reader.make_reader(stream).iter_messages(topics=["vehicle_attitude[0]"]))
    attitude = results["vehicle_attitude"]
    np.testing.assert_array_equal([m.log_time // 1000 for _, _, m in messages], attitude["timestamp"])
    np.testing.assert_array_equal([json.loads(m.data)["q[0]"] for _, _, m in messages], attitude["q[0]"])
