"""``aerial-gym watch``: each failure of an independent plant is named within 10 s of its onset, from rows as they come."""

import io
import json
from pathlib import Path

import pandas as pd
import pytest

from aerial_gym.cli.main import main
from aerial_gym.config.loader import dump_yaml
from aerial_gym.sim2real.logs.readers.mapping import find_mapping
from benchmarks.undeclared import CaseFiles, make_case
from benchmarks.undeclared import PlantFailure as Hidden
from tests.unit.sim2real.ulog_files import topics, write_ulog

HIDDEN = {
    "train_1": Hidden(kind="motor_failure", motor=2, scale=0.85, time=4.4),
    "train_2": Hidden(kind="stuck_rotor", motor=4, time=4.1),
    "train_3": Hidden(kind="brown_out", scale=0.8, time=4.77, duration=0.6),
    "train_4": Hidden(kind="weak_motor", motor=1, scale=0.8, time=5.2),
}
"""The test flight has none."""

LATEST_S = 10.0


@pytest.fixture(scope="module")
def files(tmp_path_factory: pytest.TempPathFactory) -> CaseFiles:
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("benchmarks.undeclared.simulate.SUBSTEPS", 2)  # as the fixture coarser_plant
        return make_case(
            tmp_path_factory.mktemp("watched"), effects={}, seed=741, num_test=1, duration_s=8.0, rate_hz=200,
            nuisance=True, failures=HIDDEN,
        )  # fmt: skip


@pytest.mark.parametrize("flight", HIDDEN)
def test_a_failure_is_named_soon(flight: str, files: CaseFiles, capsys: pytest.CaptureFixture[str]) -> None:
    path = next(path for path in files.train if path.stem == flight)
    assert main(["watch", str(files.robot), str(path), "--json"]) == 0
    told, hidden = [json.loads(line) for line in capsys.readouterr().out.splitlines()], HIDDEN[flight].document()
    assert [one["stage"] for one in told] == ["suspected", "named"]
    named = told[1]
    assert named["name"] == hidden["kind"]
    assert named["told_s"] < HIDDEN[flight].time + LATEST_S
    for name in ("motor", "scale", "time"):
        if name in hidden:
            assert named["params"][name] == pytest.approx(hidden[name], abs=4.0 * named["std"].get(name, 0.0)), name


def test_a_failure_in_a_binary_log_is_named(files: CaseFiles, tmp_path: Path, capsys) -> None:
    path = next(path for path in files.train if path.stem == "train_4")
    log = write_ulog(tmp_path / "a.ulg", topics(pd.read_csv(path)))
    for name in (log, f"{log}#1"):
        assert main(["watch", str(files.robot), str(name), "--json"]) == 0
        told = [json.loads(line) for line in capsys.readouterr().out.splitlines()]
        assert [(one["stage"], one["name"], one["params"]["motor"]) for one in told[1:]] == [("named", "weak_motor", 1)]


def test_a_mapping_names_the_columns_of_a_watched_log(files: CaseFiles, tmp_path: Path, capsys) -> None:
    """Rows as they come need the layout of the package."""
    path, words = next(path for path in files.train if path.stem == "train_4"), {"t": "seconds", "q_x": "quaternion_x"}
    pd.read_csv(path).rename(columns=words).to_csv(tmp_path / "other.csv", index=False)
    mapping = dump_yaml(find_mapping("aerial_gym"))
    for word, other in words.items():
        mapping = mapping.replace(f"- {word}\n", f"- {other}\n")
    (tmp_path / "m.yaml").write_text(mapping)
    assert main(["watch", str(files.robot), str(path), "--json"]) == 0
    own = capsys.readouterr().out.splitlines()
    command = ["watch", str(files.robot), str(tmp_path / "other.csv"), "--mapping", str(tmp_path / "m.yaml"), "--json"]
    assert main(command) == 0
    mapped = capsys.readouterr().out.splitlines()
    assert [json.loads(line)["name"] for line in mapped] == [json.loads(line)["name"] for line in own]
    assert mapped
    assert main([*command, "--follow"]) == 2


def test_nothing_is_told_of_a_flight_without_a_failure_on_stdin(files, capsys, monkeypatch) -> None:
    monkeypatch.setattr("sys.stdin", io.StringIO(files.test[0].read_text()))
    assert main(["watch", str(files.robot), "-"]) == 0
    out, err = capsys.readouterr()
    assert out == ""
    assert "watched 8.0 s: no failures" in err


def test_a_file_that_is_not_there_or_no_log_is_a_wrong_request(files, tmp_path, capsys) -> None:
    assert main(["watch", str(files.robot), str(tmp_path / "none.csv")]) == 2
    assert "no such file. Give a flight log" in capsys.readouterr().err
    header, *rows = files.test[0].read_text().splitlines()[:100]
    no_time = "\n".join([header, *(row[row.index(",") :] for row in rows)]).encode()
    twice = "\n".join([f"{header},q_x", *(f"{row},0" for row in rows)]).encode()
    for number, content in enumerate(
        (
            *(b"", b"\n", b"a,b\n1,2\n", f"{header}\n1,2,three\n".encode(), bytes(300), b"ULog\x01\x12\x35\x01"),
            *(header.encode(), f"{header}\n\n".encode(), "\n".join([header, *50 * rows[:1]]).encode(), no_time, twice),
        )
    ):
        wrong = tmp_path / f"wrong{number}.csv"
        wrong.write_bytes(content)
        assert main(["watch", str(files.robot), str(wrong)]) == 2
        assert capsys.readouterr().err.count("\n") <= 4
    assert main(["watch", str(files.robot), str(tmp_path)]) == 2


def test_a_followed_log_that_begins_anew_is_watched_as_another_flight(files, tmp_path, capsys, monkeypatch) -> None:
    log, failing = tmp_path / "log.csv", next(path for path in files.train if path.stem == "train_1")
    log.write_bytes(files.test[0].read_bytes())

    def stop() -> None:
        raise KeyboardInterrupt

    steps = iter(
        [
            lambda: log.write_text(""),
            lambda: log.rename(tmp_path / "old.csv"),
            lambda: log.write_text(""),  # another file that has no header yet
            lambda: log.rename(tmp_path / "older.csv"),
            lambda: log.write_bytes(failing.read_bytes().splitlines(keepends=True)[0]),  # no row
            lambda: log.write_text(""),
            lambda: log.write_bytes(failing.read_bytes()),
        ]
    )
    monkeypatch.setattr("aerial_gym.sim2real.logs.readers.follow.time.sleep", lambda _: next(steps, stop)())
    assert main(["watch", str(files.robot), str(log), "--follow", "--json"]) == 0
    out, err = capsys.readouterr()
    assert [json.loads(line)["name"] for line in out.splitlines()][-1] == "motor_failure"
    assert err.count("watched 8.0 s") == 2


WRONG = {
    "thrust_coefficient": {"scale": 0.88}, "motor_time_constant": {"tau": 0.06}, "battery_sag": {"gain": 0.8},
    "com_offset": {"x": 0.006, "y": -0.004, "z": 0.0}, "rotor_drag": {"dx": 0.3, "dy": 0.3, "dz": 0.1},
    "gusts": {"std": 1.5, "corr_time": 1.0},
}  # fmt: skip
LATE_FAILURE = Hidden(kind="motor_failure", motor=2, scale=0.8, time=37.0)


@pytest.mark.slow
def test_a_vehicle_that_does_not_fit_is_told_and_only_its_later_failure_is_named(tmp_path, capsys) -> None:
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("benchmarks.undeclared.simulate.SUBSTEPS", 2)
        files = make_case(
            tmp_path, effects=WRONG, seed=742, num_train=1, num_test=1, duration_s=44.0, rate_hz=100,
            failures={"train_1": LATE_FAILURE},
        )  # fmt: skip
    alarms = {}
    for path in (*files.train, *files.test):
        assert main(["watch", str(files.robot), str(path), "--json"]) == 0
        alarms[path.stem] = [json.loads(line) for line in capsys.readouterr().out.splitlines()]
    for told in alarms.values():
        assert [one["name"] for one in told if one["told_s"] < LATE_FAILURE.time] == ["vehicle_misfit"]
    assert [one["stage"] for one in alarms["test_1"]] == ["misfit"]
    *_, named = alarms["train_1"]
    assert (named["stage"], named["name"], named["params"]["motor"]) == ("named", "motor_failure", 2.0)
    assert named["params"]["time"] == pytest.approx(LATE_FAILURE.time, abs=0.3)
