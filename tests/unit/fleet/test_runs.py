"""Runs of a small fleet in this process: rows, resumption, copies, refusals, robots, limits of one writer, migration."""

import json
import os
import signal
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest
from deltalake import DeltaTable

from aerial_gym.errors import ConfigError
from aerial_gym.fleet import pass_two
from aerial_gym.fleet import run as run_module
from aerial_gym.fleet.engine import run_serially
from aerial_gym.fleet.lock import writer_lock
from aerial_gym.fleet.pass_one import BATCH_ATTEMPTS, LOG_ATTEMPTS, PassOne, PassOneSettings
from aerial_gym.fleet.pass_two import PassTwoSettings
from aerial_gym.fleet.schemas import SCHEMA_VERSION, SCHEMAS
from aerial_gym.fleet.tables import FleetTables
from aerial_gym.fleet.vehicles import VehicleRule, VehicleRules
from aerial_gym.sim2real.logs.readers.mapping import MAPPING_DIR
from benchmarks.fleet.kills import table_contents
from tests.unit.fleet.fake_passes import write_fleet, write_log
from tests.unit.fleet.runs import FAKE, request, run, small_fleet


def rows(out: Path, name: str) -> list[dict[str, Any]]:
    return list(FleetTables(out).rows(name, SCHEMAS[name].names))


def test_run_names_the_changed_vehicle_and_raises_one_alert(tmp_path: Path) -> None:
    write_fleet(tmp_path / "logs", vehicles=4, flights=10, changed=[2])
    summary = run(tmp_path / "logs", tmp_path / "out")
    assert (summary.new, summary.vehicles, dict(summary.refused)) == (41, 4, {"is no log": 1})
    assert summary.changed == ["vehicle vehicle_2, rotor 1: changed since flight 6"]
    verdicts = {row["vehicle"]: row for row in rows(tmp_path / "out", "verdicts")}
    assert [verdicts[f"vehicle_{k}"]["verdict"] for k in range(4)] == ["no_change", "no_change", "changed", "no_change"]
    assert verdicts["vehicle_2"]["onset_flight"] == 6
    last = next(row for row in rows(tmp_path / "out", "flights") if row["path"].endswith("vehicle_2/flight_9.csv"))
    assert [row["first_seen"] for row in rows(tmp_path / "out", "alerts")] == [last["log_hash"]]


def test_second_run_reads_no_log_and_changes_no_table(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    write_fleet(tmp_path / "logs", vehicles=3, flights=6, changed=[1])
    run(tmp_path / "logs", tmp_path / "out")
    before = table_contents(tmp_path / "out")
    monkeypatch.setattr(PassOne, "_fetch", lambda *_: pytest.fail("a log was read"))
    summary = run(tmp_path / "logs", tmp_path / "out")
    assert (summary.new, summary.known, summary.alerts) == (0, 19, [])
    assert table_contents(tmp_path / "out") == before


def test_interrupted_run_keeps_its_rows_and_continues(tmp_path: Path) -> None:
    """The engine stops after two batches, of which the rows are written; evidence without its flight is deleted."""

    def break_off(batches: Any, make_worker: Any) -> Any:
        for number, result in enumerate(run_serially(batches, make_worker)):
            if number == 2:
                raise KeyboardInterrupt
            yield result

    write_fleet(tmp_path / "logs", vehicles=4, flights=12, changed=[2])
    run(tmp_path / "logs", tmp_path / "calm")
    with pytest.raises(KeyboardInterrupt):
        run(tmp_path / "logs", tmp_path / "out", break_off)
    assert len(rows(tmp_path / "out", "flights")) == 2 * run_module.BATCH
    lost = {**rows(tmp_path / "calm", "evidence")[-1]}
    FleetTables(tmp_path / "out").append("evidence", [lost])
    assert run(tmp_path / "logs", tmp_path / "out").known == 2 * run_module.BATCH
    assert table_contents(tmp_path / "out") == table_contents(tmp_path / "calm")


def test_killed_run_continues_without_ray(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """SIGKILL within a commit, between evidence and flights."""
    write_fleet(tmp_path / "logs", vehicles=3, flights=8)
    run(tmp_path / "logs", tmp_path / "calm")
    code = (
        "import os, sys; from pathlib import Path; from aerial_gym.fleet.tables import FleetTables\n"
        "from tests.unit.fleet.runs import run\n"
        "append = FleetTables.append\n"
        "end = lambda: os.kill(os.getpid(), 9)\n"
        "FleetTables.append = lambda self, name, rows: end() if name == 'flights' else append(self, name, rows)\n"
        f"run({str(tmp_path / 'logs')!r}, Path({str(tmp_path / 'out')!r}))"
    )
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == -signal.SIGKILL
    assert len(rows(tmp_path / "out", "evidence")) == 48
    assert rows(tmp_path / "out", "flights") == []
    run(tmp_path / "logs", tmp_path / "out")
    assert table_contents(tmp_path / "out") == table_contents(tmp_path / "calm")


def test_copies_of_a_log_are_one_flight_of_the_first_path(tmp_path: Path) -> None:
    for name in ("b", "a"):
        (tmp_path / "logs" / name).mkdir(parents=True)
        write_log(tmp_path / "logs" / name / "flight.csv", [0.1, 0.2])
    assert run(tmp_path / "logs", tmp_path / "out").copies == 1
    assert [row["vehicle"] for row in rows(tmp_path / "out", "flights")] == ["a"]


def test_moved_and_touched_logs_are_hashed_and_not_analysed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    write_fleet(tmp_path / "logs", vehicles=2, flights=4)
    run(tmp_path / "logs", tmp_path / "out")
    before = table_contents(tmp_path / "out")
    (tmp_path / "logs" / "vehicle_1").rename(tmp_path / "logs" / "archive")
    os.utime(tmp_path / "logs" / "vehicle_0" / "flight_0.csv", (0, 0))
    monkeypatch.setattr(PassOne, "_results", lambda *_: pytest.fail("a log was analysed"))
    for _ in range(2):
        summary = run(tmp_path / "logs", tmp_path / "out")
        assert (summary.new, summary.known, summary.copies, dict(summary.refused)) == (0, 4, 5, {})
    assert table_contents(tmp_path / "out") == before


def test_other_mapping_file_of_the_same_name_is_refused(tmp_path: Path) -> None:
    write_fleet(tmp_path / "logs", vehicles=1, flights=1, bad=False)
    mapping, columns = tmp_path / "mapping.yaml", (MAPPING_DIR / "aerial_gym.yaml").read_text(encoding="utf-8")
    for text in (columns, f"{columns}# comment"):
        mapping.write_text(text, encoding="utf-8")
        run(tmp_path / "logs", tmp_path / "out", mapping=str(mapping))
    mapping.write_text((MAPPING_DIR / "crazypad.yaml").read_text(encoding="utf-8"), encoding="utf-8")
    with pytest.raises(ConfigError, match="was made with mapping = 'content "):
        run(tmp_path / "logs", tmp_path / "out", mapping=str(mapping))


def test_other_robot_file_or_model_version_makes_new_rows(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    write_fleet(tmp_path / "logs", vehicles=2, flights=4, bad=False)
    run(tmp_path / "logs", tmp_path / "out")
    monkeypatch.setenv("FAKE_VERSION", "2+test")
    assert run(tmp_path / "logs", tmp_path / "out").new == 8
    assert len(rows(tmp_path / "out", "flights")) == 16
    assert {row["model_version"] for row in rows(tmp_path / "out", "verdicts")} == {"2+test"}
    assert {row["model_version"] for row in rows(tmp_path / "out", "vehicles")} == {"2+test"}


def test_log_without_robot_file_is_tried_again(tmp_path: Path) -> None:
    robot = small_fleet()
    both = {"robots": {"vehicle_0": robot.robots["quad"]} | {"other": robot.robots["quad"]}}
    both["hashes"] = {"vehicle_0": robot.hashes["quad"], "other": robot.hashes["quad"]}
    write_fleet(tmp_path / "logs", vehicles=2, flights=2, bad=False)
    summary = run(tmp_path / "logs", tmp_path / "out", fleet=type(robot)(**both))
    (reason,) = summary.refused
    assert reason.startswith("no robot file for vehicle 'vehicle_1': give vehicle_1.yaml in --robots")
    assert reason.endswith("Known robots: vehicle_0, other")
    assert run(tmp_path / "logs", tmp_path / "out").new == 2
    assert {row["status"] for row in rows(tmp_path / "out", "flights")} == {"ok"}


def test_vehicle_is_the_airframe_of_the_log(tmp_path: Path) -> None:
    for k in range(2):
        write_log(tmp_path / f"{k}.csv", [0.1, 0.2], airframe="A7")
    assert run(tmp_path, tmp_path / "out").vehicles == 1
    assert {row["vehicle"] for row in rows(tmp_path / "out", "flights")} == {"A7"}


def test_log_that_ends_the_process_again_and_again_is_refused(tmp_path: Path) -> None:
    for k in range(3):
        write_log(tmp_path / f"{k}.csv", [0.1, 0.2 * k], **({"end": True} if k == 1 else {}))
    scratch = tmp_path / "out" / "fetched"
    scratch.mkdir(parents=True)
    task = request(tmp_path, tmp_path / "out")
    settings = PassOneSettings(store=task.logs, fleet=task.fleet, module=FAKE, scratch=scratch)
    logs = list(task.logs.logs())
    for _ in range(BATCH_ATTEMPTS + LOG_ATTEMPTS):
        with pytest.raises(SystemExit):
            settings.make_worker()(logs)
    statuses = [(one.flight["status"], one.flight["reason"][:30]) for one in settings.make_worker()(logs)]
    assert statuses == [("ok", ""), ("refused", "its analysis has ended the pro"), ("ok", "")]
    assert list(scratch.iterdir()) == []


def test_second_writer_is_refused_until_the_first_ends(tmp_path: Path) -> None:
    write_fleet(tmp_path / "logs", vehicles=1, flights=1, bad=False)
    with (
        writer_lock(tmp_path / "out"),
        pytest.raises(ConfigError, match=f"process {os.getpid()} on .* writes these tables"),
    ):
        run(tmp_path / "logs", tmp_path / "out")
    assert run(tmp_path / "logs", tmp_path / "out").new == 1


@pytest.mark.parametrize("fault", ["file size", "no folder", "damaged"])
def test_failures_of_the_disk_are_one_sentence_with_the_remedy(tmp_path: Path, fault: str) -> None:
    """In a process of its own: a limit of the file size acts like a full disk, also for users who may write anywhere."""
    write_fleet(tmp_path / "logs", vehicles=2, flights=6)
    out = tmp_path / "out"
    if fault == "no folder":
        out.write_text("a file")
    else:
        run(tmp_path / "logs", out)
        write_log(tmp_path / "logs" / "new.csv", [0.0, 0.0])
    if fault == "damaged":
        for file in (out / "flights").glob("*.parquet"):
            file.write_bytes(b"nothing")
    code = (
        "import resource, signal; from pathlib import Path; from tests.unit.fleet.runs import run\n"
        "signal.signal(signal.SIGXFSZ, signal.SIG_IGN)\n"
        f"{'resource.setrlimit(resource.RLIMIT_FSIZE, (900, 900))' if fault == 'file size' else ''}\n"
        f"run({str(tmp_path / 'logs')!r}, Path({str(out)!r}))"
    )
    result = subprocess.run([sys.executable, "-c", code], check=False, capture_output=True, text=True)
    remedy = {"file size": "the disk is full. Free some space"}.get(fault, "start again, as finished flights are kept")
    last = result.stderr.strip().splitlines()[-1]
    assert last.startswith(f"aerial_gym.errors.StorageError: {out}: ")
    assert remedy in last


def test_empty_store_and_other_settings_are_refused(tmp_path: Path) -> None:
    (tmp_path / "logs").mkdir()
    with pytest.raises(ConfigError, match="holds no log whose name matches '\\*'"):
        run(tmp_path / "logs", tmp_path / "out")
    write_fleet(tmp_path / "logs", vehicles=1, flights=1)
    run(tmp_path / "logs", tmp_path / "out")
    rules = VehicleRules(rules=(VehicleRule(vehicle="all"),))
    with pytest.raises(ConfigError, match="was made with rules"):
        run(tmp_path / "logs", tmp_path / "out", fleet=small_fleet(rules))


def test_drift_is_compared_with_the_limit_of_its_parameter(tmp_path: Path) -> None:
    """A vehicle without a change has neither an onset nor a limit that it crosses."""
    write_fleet(tmp_path / "logs", vehicles=2, flights=8, changed=[1])
    verdicts = PassTwoSettings(module=FAKE, wording=FAKE, limits={"weak_motor.scale": 0.9})
    run(tmp_path / "logs", tmp_path / "out", verdicts=verdicts)
    by_flag = {row["rejected"]: row for row in rows(tmp_path / "out", "verdicts")}
    assert (by_flag[True]["crosses_limit_at"], by_flag[False]["crosses_limit_at"]) == (2e9, None)
    assert (by_flag[True]["onset_flight"], by_flag[False]["onset_flight"]) == (5, None)


def test_tables_of_version_1_are_migrated_and_of_newer_versions_refused(tmp_path: Path) -> None:
    """Version 1 had no firmware."""
    write_fleet(tmp_path / "logs", vehicles=2, flights=4)
    out = tmp_path / "out"
    FleetTables.create(out, request(tmp_path / "logs", out).settings())
    for name in ("flights", "vehicles"):
        old = SCHEMAS[name].remove(SCHEMAS[name].get_field_index("firmware"))
        DeltaTable.create(out / name, old, mode="overwrite")
    description = json.loads((out / "fleet.json").read_text(encoding="utf-8"))
    flight = {name: None for name in SCHEMAS["flights"].names if name not in ("firmware", "written_at")}
    flight |= {"log_hash": "h", "robot_hash": "r", "model_version": "0", "path": "p", "vehicle": "v", "size": 1}
    import pyarrow as pa
    from deltalake import write_deltalake

    schema = SCHEMAS["flights"].remove(SCHEMAS["flights"].get_field_index("firmware"))
    write_deltalake(out / "flights", pa.Table.from_pylist([flight], schema=schema), mode="append")
    (out / "fleet.json").write_text(json.dumps(description | {"schema_version": 1}), encoding="utf-8")
    assert run(tmp_path / "logs", out).new == 9
    assert FleetTables(out).description()["schema_version"] == SCHEMA_VERSION
    assert {row["firmware"] for row in rows(out, "flights")} == {"", None}
    (out / "fleet.json").write_text(json.dumps(description | {"schema_version": 3}), encoding="utf-8")
    with pytest.raises(ConfigError, match="its tables have schema 3"):
        run(tmp_path / "logs", out)


def test_verdicts_state_odd_and_damaged_flights_and_blind_vehicles(tmp_path: Path) -> None:
    """A vehicle without visible effects is no vehicle with too few flights. Rows without a change keep no causes."""
    import pyarrow as pa
    from deltalake import write_deltalake

    for vehicle, mark in (("a", 0.0), ("odd", 9.0), ("blind", 8.0)):
        (tmp_path / "logs" / vehicle).mkdir(parents=True)
        for flight in range(6):
            value = [0.01 * flight, mark if flight == 2 or mark == 8.0 else 0.0]
            write_log(tmp_path / "logs" / vehicle / f"{flight}.csv", value, airframe=vehicle)
    run(tmp_path / "logs", tmp_path / "out")
    table = FleetTables(tmp_path / "out").dataset("flights").to_table()
    vehicle, moments = (table.column(name).to_pylist() for name in ("vehicle", "moments"))
    moments[vehicle.index("a")], moments[vehicle.index("a") + 1] = b"damaged", moments[0]
    place = table.schema.get_field_index("moments")
    table = table.set_column(place, "moments", pa.array(moments, pa.binary()))
    write_deltalake(tmp_path / "out" / "flights", table, mode="overwrite")
    run(tmp_path / "logs", tmp_path / "out")
    verdicts = rows(tmp_path / "out", "verdicts")
    damaged = "; the moments of 1 of 6 flights are damaged, and left out"
    assert {row["text"].split(": ")[1] for row in verdicts} == {
        f"no_change, 0 odd flights{damaged}", "no_change, 1 odd flights", "not_testable, 0 odd flights",
    }  # fmt: skip
    assert {row["causes"] for row in verdicts} == {"[]"}


def test_verdict_rests_on_the_last_flights_and_numbers_all(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(pass_two, "MOST_FLIGHTS", 8)
    write_fleet(tmp_path / "logs", vehicles=2, flights=16, changed=[1], bad=False)
    assert run(tmp_path / "logs", tmp_path / "out").changed == []
    for flight in range(16, 20):
        write_log(tmp_path / "logs" / "vehicle_0" / f"flight_{flight}.csv", [-1.0, 0.0], time=1e9 + 1e3 * flight)
    assert run(tmp_path / "logs", tmp_path / "out").changed == [
        "vehicle vehicle_0, rotor 1: changed since flight 17; judged by its last 8 flights"
    ]
    (row,) = (row for row in rows(tmp_path / "out", "verdicts") if row["rejected"])
    assert (row["onset_flight"], row["onset_time"], json.loads(row["causes"])[0]["onset"]) == (17, 1e9 + 16e3, 16)


def test_watched_vehicle_is_compared_with_those_of_present_robot_files(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Verdicts under another robot file do not count for the false discovery rate."""
    write_fleet(tmp_path / "logs", vehicles=3, flights=6, bad=False)
    run(tmp_path / "logs", tmp_path / "out")
    tables, sizes = FleetTables(tmp_path / "out"), list[int]()
    tables.append(
        "verdicts", [row | {"robot_hash": "old", "vehicle": "x"} for row in rows(tmp_path / "out", "verdicts")]
    )
    decide = pass_two.decide
    monkeypatch.setattr(pass_two, "decide", lambda *some: sizes.append(some[1].size) or decide(*some))
    pass_two.judge_fleet(
        tables, small_fleet().hashes.values(), "1+test", run_serially, PassTwoSettings(module=FAKE, wording=FAKE),
        only={"vehicle_0"},
    )  # fmt: skip
    assert sizes == [2]


def test_log_that_was_completed_counts_once(tmp_path: Path) -> None:
    write_fleet(tmp_path / "logs", vehicles=1, flights=5, bad=False)
    run(tmp_path / "logs", tmp_path / "out")
    log = tmp_path / "logs" / "vehicle_0" / "flight_0.csv"
    log.write_text(log.read_text(encoding="utf-8") + " ", encoding="utf-8")
    run(tmp_path / "logs", tmp_path / "out")
    assert len(rows(tmp_path / "out", "flights")) == 6
    assert {row["flights"] for row in rows(tmp_path / "out", "vehicles")} == {5}


def test_change_that_many_vehicles_share_is_no_fault_of_each(tmp_path: Path) -> None:
    write_fleet(tmp_path / "few", vehicles=5, flights=8, changed=[1, 3], bad=False)
    run(tmp_path / "few", tmp_path / "a")
    assert {row["verdict"] for row in rows(tmp_path / "a", "verdicts") if row["rejected"]} == {"changed"}
    write_fleet(tmp_path / "many", vehicles=5, flights=8, changed=[0, 1, 3], bad=False)
    run(tmp_path / "many", tmp_path / "b")
    shared = [row for row in rows(tmp_path / "b", "verdicts") if row["rejected"]]
    assert [row["verdict"] for row in shared] == ["shared"] * 3
    assert "3 of 5 vehicles changed alike at that time" in shared[0]["text"]
