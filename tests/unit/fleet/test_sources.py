"""Stores of logs, the rules that assign them to vehicles, and queries."""

import json
import os
import socket
import struct
from collections.abc import Iterator
from contextlib import chdir
from pathlib import Path

import fsspec
import numpy as np
import pytest

from aerial_gym.cli.fleet import print_summary
from aerial_gym.cli.main import main
from aerial_gym.errors import ConfigError
from aerial_gym.fleet.moments import pack_moments
from aerial_gym.fleet.query import query
from aerial_gym.fleet.sources import LogStore, hash_of_log, sort_by_time
from aerial_gym.fleet.vehicles import VehicleRule, VehicleRules, load_fleet
from aerial_gym.sim2real.flight_evidence.evidence import log_airframe
from tests.unit.fleet.fake_passes import write_fleet, write_log
from tests.unit.fleet.runs import run, small_fleet
from tests.unit.sim2real.ulog_files import write_ulog


def test_logs_come_in_natural_order_without_other_files(tmp_path: Path) -> None:
    for name in ("a/flight_10.ulg", "a/flight_9.ulg", "b.csv", "a/notes.md", ".hidden.csv", "truth.json"):
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).write_text("x", encoding="utf-8")
    logs = list(LogStore(url=str(tmp_path)).logs())
    assert [log.path.removeprefix(f"{tmp_path}/") for log in logs] == ["a/flight_9.ulg", "a/flight_10.ulg", "b.csv"]
    assert [log.path[-5:] for log in LogStore(url=str(tmp_path), pattern="*.csv").logs()] == ["b.csv"]


def test_folder_of_parquet_files_is_one_log(tmp_path: Path) -> None:
    (tmp_path / "log").mkdir()
    for name in ("metadata.json", "table.parquet"):
        (tmp_path / "log" / name).write_text(name, encoding="utf-8")
    (log,) = LogStore(url=str(tmp_path)).logs()
    assert log.path == str(tmp_path / "log")
    before = hash_of_log(tmp_path / "log")
    (tmp_path / "log" / "table.parquet").write_text("other", encoding="utf-8")
    assert hash_of_log(tmp_path / "log") != before


def test_links_are_followed_once_and_pipes_sockets_and_empty_folders_are_no_logs(tmp_path: Path) -> None:
    logs = tmp_path / "logs"
    (logs / "folder.ulg").mkdir(parents=True)
    (logs / "a.ulg").write_text("x", encoding="utf-8")
    os.mkfifo(logs / "pipe.ulg")
    (logs / "pipe_link.ulg").symlink_to(logs / "pipe.ulg")
    with socket.socket(socket.AF_UNIX) as local, chdir(logs):
        local.bind("socket.ulg")
    (tmp_path / "far").mkdir()
    (tmp_path / "far" / "b.ulg").write_text("y", encoding="utf-8")
    (tmp_path / "far" / "back").symlink_to(logs)
    (logs / "linked").symlink_to(tmp_path / "far")
    (logs / "loop").symlink_to(logs)
    (logs / "link.ulg").symlink_to(logs / "a.ulg")
    (logs / "none.ulg").symlink_to(tmp_path / "nowhere")
    names = [log.path.removeprefix(f"{logs}/") for log in LogStore(url=str(logs)).logs()]
    assert names == ["a.ulg", "link.ulg", "linked/b.ulg", "none.ulg"]


def test_pipe_in_the_folder_of_a_log_is_not_read(tmp_path: Path) -> None:
    (tmp_path / "table.parquet").write_text("x", encoding="utf-8")
    before = hash_of_log(tmp_path)
    os.mkfifo(tmp_path / "pipe.parquet")
    assert hash_of_log(tmp_path) == before


def test_names_and_identities_with_line_breaks_break_no_line(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """A log with such a name, or one that is not UTF-8, is stated; of identities in logs, the signs are escaped."""
    for name in ("a\nb.csv", os.fsdecode(b"c\xff.csv"), "d.csv", "e f \u00e9.csv"):
        write_log(tmp_path / name, [0.1, 0.01 * len(name)], airframe="A\n\x1b[31m7", firmware="1\r2")
    (tmp_path / "broken.csv").symlink_to(tmp_path / "nowhere")
    summary = run(tmp_path, tmp_path / "out")
    print_summary(summary, tmp_path / "out", as_json=False)
    lines = capsys.readouterr().out.splitlines()
    assert [line for line in lines if "a\\nb.csv (its name has control characters" in line]
    assert [line for line in lines if "c\\udcff.csv (its name has" in line]
    assert "3 not delivered by the store" in lines[1]
    assert next(query(tmp_path / "out", "SELECT DISTINCT vehicle, firmware FROM flights")[1]) == (
        "A\\n\\x1b[31m7",
        "1\\r2",
    )


@pytest.mark.parametrize("url", ["memory://fleet", "s3://fleet/logs"])
def test_object_stores_give_the_rows_of_a_folder(tmp_path: Path, url: str, request: pytest.FixtureRequest) -> None:
    if url.startswith("s3"):
        request.getfixturevalue("s3_server")
    write_fleet(tmp_path / "logs", vehicles=2, flights=3)
    system = fsspec.url_to_fs(url)[0]
    system.put(f"{tmp_path / 'logs'}/", url, recursive=True)
    assert run(tmp_path / "logs", tmp_path / "calm").new == run(url, tmp_path / "out").new == 7
    assert run(url, tmp_path / "out").known == 7
    columns = "SELECT vehicle, reason, columns, moments, log_hash FROM flights ORDER BY log_hash"
    assert list(query(tmp_path / "out", columns)[1]) == list(query(tmp_path / "calm", columns)[1])
    assert list((tmp_path / "out" / "fetched").iterdir()) == []
    assert next(query(tmp_path / "out", "SELECT min(path) FROM flights")[1])[0].startswith(url.partition("//")[0])


@pytest.fixture
def s3_server(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """Serve an empty bucket ``fleet`` on this machine."""
    pytest.importorskip("s3fs", reason="s3fs is not installed")
    server = pytest.importorskip("moto.server", reason="moto is not installed").ThreadedMotoServer("127.0.0.1", 0)
    server.start()
    for name, value in {"ACCESS_KEY_ID": "test", "SECRET_ACCESS_KEY": "test", "DEFAULT_REGION": "us-east-1"}.items():
        monkeypatch.setenv(f"AWS_{name}", value)
    host, port = server.get_host_and_port()
    monkeypatch.setenv("AWS_ENDPOINT_URL", f"http://{host}:{port}")
    import s3fs

    s3fs.S3FileSystem.clear_instance_cache()
    s3fs.S3FileSystem().mkdir("fleet")
    yield
    server.stop()
    s3fs.S3FileSystem.clear_instance_cache()


def test_log_that_the_store_does_not_deliver_is_tried_again(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    write_fleet(tmp_path / "logs", vehicles=1, flights=3, bad=False)
    fetch = LogStore.fetch

    def refuse_first(store: LogStore, log: object, folder: Path) -> Path:
        if log.rank == 0:  # type: ignore[attr-defined]
            raise OSError("connection lost")
        return fetch(store, log, folder)  # type: ignore[arg-type]

    with monkeypatch.context() as patch:
        patch.setattr(LogStore, "fetch", refuse_first)
        summary = run(tmp_path / "logs", tmp_path / "out")
    assert (summary.new, list(summary.unread.values())) == (2, ["connection lost"])
    assert run(tmp_path / "logs", tmp_path / "out").new == 1


@pytest.mark.parametrize(
    ("path", "airframe", "vehicle"),
    [
        ("/logs/lab/x7/1.ulg", "", "lab-x7"),
        ("/logs/field/x8/1.ulg", "abc", "ABC"),
        ("/logs/field/x8/1.ulg", "", "x8"),
        ("/logs/field/x8/1.ulg", "def", "def"),
    ],
)
def test_first_rule_that_matches_names_the_vehicle(path: str, airframe: str, vehicle: str) -> None:
    rules = (
        VehicleRule(glob="*/lab/*", regex=r"(?P<name>x\d)", vehicle="lab-{name}"),
        VehicleRule(airframe="a.c", vehicle="ABC"),
    )
    assert small_fleet(VehicleRules(rules=rules)).assign(path, airframe) == (vehicle, "quad")


def test_airframe_is_the_identity_that_a_log_states(tmp_path: Path) -> None:
    """It decides the robot file before pass 1: ``sys_uuid`` of a ULog file, nothing in a CSV file."""
    battery = {
        "timestamp": np.arange(1, 20, dtype=np.uint64) * 100000,
        "voltage_v": np.full(19, 12.0, dtype=np.float32),
    }
    log, key = write_ulog(tmp_path / "log.ulg", {"battery_status": battery}), b"char[3] sys_uuid"
    text = bytes([len(key)]) + key + b"A7x"
    log.write_bytes(log.read_bytes() + struct.pack("<HB", len(text), ord("I")) + text)
    assert log_airframe(log) == "A7x"
    (tmp_path / "log.csv").write_text("t,q_x\n0,1\n", encoding="utf-8")
    assert log_airframe(tmp_path / "log.csv") == ""


def test_all_faults_of_robots_and_rules_come_at_once(tmp_path: Path) -> None:
    (tmp_path / "a.yaml").write_text("nonsense: 1", encoding="utf-8")
    (tmp_path / "rules.yml").write_text("rules: [{vehicle: x, robot: none}]", encoding="utf-8")
    with pytest.raises(ConfigError) as error:
        load_fleet(tmp_path, tmp_path / "rules.yml")
    assert "nonsense" in str(error.value)
    assert "no robot 'none'" in str(error.value)
    with pytest.raises(ConfigError, match="unknown field other. Known: airframe, folder"):
        VehicleRule(vehicle="{other}")


@pytest.mark.parametrize(
    "sql",
    [
        "SELECT 1; SELECT 2", "CREATE TABLE t AS SELECT 1", "COPY flights TO 'x.csv'",
        "INSERT INTO flights SELECT * FROM flights",
        "SET threads = 1", "ATTACH 'x.db'", "INSTALL httpfs", "EXPORT DATABASE 'x'", "SELECT * FROM read_csv('{file}')",
        "SELECT * FROM '{file}'", "SELECT * FROM glob('*')", "SELECT * FROM read_text('http://127.0.0.1/x')", "", "nonsense",
        "SELECT * FROM tables",
    ],
)  # fmt: skip
def test_queries_that_do_more_than_read_the_tables_are_refused(tmp_path: Path, sql: str) -> None:
    (tmp_path / "file.csv").write_text("a\n1\n", encoding="utf-8")
    write_fleet(tmp_path / "logs", vehicles=1, flights=1, bad=False)
    run(tmp_path / "logs", tmp_path / "out")
    with pytest.raises(ConfigError, match="the query"):
        query(tmp_path / "out", sql.replace("{file}", str(tmp_path / "file.csv")))


def test_query_command_prints_one_object_a_line(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    write_fleet(tmp_path / "logs", vehicles=2, flights=2, bad=False)
    run(tmp_path / "logs", tmp_path / "out")
    sql = "WITH v AS (SELECT * FROM flights) SELECT vehicle, count(*) AS n, NULL AS x FROM v GROUP BY vehicle ORDER BY vehicle"
    assert main(["fleet", "query", sql, "--out", str(tmp_path / "out"), "--json"]) == 0
    lines = [json.loads(line) for line in capsys.readouterr().out.splitlines()]
    assert lines == [{"vehicle": "vehicle_0", "n": 2, "x": None}, {"vehicle": "vehicle_1", "n": 2, "x": None}]
    assert main(["fleet", "query", "DESCRIBE flights", "--tables", str(tmp_path / "out")]) == 0
    assert "log_hash" in capsys.readouterr().out
    assert main(["fleet", "query", "SELECT 1", "--out", str(tmp_path / "none")]) == 2
    assert "holds no fleet tables" in capsys.readouterr().err


def test_run_command_names_all_faults_before_it_starts(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    options = {"logs": "none", "robots": "no.yaml", "out": "out", "limit": "scale"}
    words = [word for name, value in options.items() for word in (f"--{name}", str(tmp_path / value))]
    assert main(["fleet", "run", *words]) == 2
    message = capsys.readouterr().err
    assert all(
        text in message for text in ("3 faults", "no such folder or store", "no.yaml: no such file", "EFFECT.PARAMETER")
    )


def test_summary_states_the_changes_first(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    write_fleet(tmp_path / "logs", vehicles=4, flights=8, changed=[1])
    summary = run(tmp_path / "logs", tmp_path / "out")
    print_summary(summary, tmp_path / "out", as_json=False)
    lines = capsys.readouterr().out.splitlines()
    assert lines[0] == "vehicle vehicle_1, rotor 1: changed since flight 5"
    assert lines[1:3] == ["4 vehicles with usable flights; logs: 33 new, 0 known, 1 refused", "  refused 1: is no log"]
    print_summary(summary, tmp_path / "out", as_json=True)
    content = json.loads(capsys.readouterr().out)
    assert (content["new"], content["refused"], len(content["alerts"])) == (33, {"is no log": 1}, 1)


def test_summary_states_differences_between_firmware_versions(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    for flight in range(6):
        write_log(tmp_path / f"{flight}.csv", [0.01 * flight, 0.0], firmware=f"1.{flight // 3}")
    print_summary(run(tmp_path, tmp_path / "out"), tmp_path / "out", as_json=False)
    text = "firmware 1.1 against 1.0: weak motor, rotor 1: scale +0.1 (+0.05 to +0.15)"
    assert text in capsys.readouterr().out


def test_flights_keep_the_order_of_their_logs_if_one_states_no_time() -> None:
    """Logs from indoors, without GPS, came before all others."""
    rows = [{"path": f"flight_{k}.ulg", "start_time": 1e9 - k, "written_at": 0} for k in (10, 9, 2)]
    assert [row["path"] for row in sort_by_time(rows)] == ["flight_10.ulg", "flight_9.ulg", "flight_2.ulg"]
    rows[0]["start_time"] = float("nan")
    assert [row["path"] for row in sort_by_time(rows)] == ["flight_2.ulg", "flight_9.ulg", "flight_10.ulg"]


def test_moments_that_are_not_finite_are_not_stored() -> None:
    assert pack_moments(np.eye(2), np.array([0.0, 1.0])) is not None
    assert pack_moments(np.eye(2), np.array([0.0, np.nan])) is None
    assert pack_moments(1e39 * np.eye(2), np.zeros(2)) is None
