"""Every command on consoles that are not UTF-8: no trace, the same status, and JSON that loses nothing."""

import io
import json
import sys
from pathlib import Path

import pytest

from aerial_gym.cli.main import COMMANDS, main
from aerial_gym.config import dump_yaml
from tests.unit.sim2real.flat_flights import ROBOT, flight, write

ENCODINGS = ("gbk", "cp932", "ascii", "cp1252")


class Output:
    """What a command wrote."""

    def __init__(self, status: int, out: bytes, err: bytes) -> None:
        self.status, self.out, self.err = status, out, err


def run(monkeypatch: pytest.MonkeyPatch, encoding: str, *arguments: str) -> Output:
    """Return the output of a command on strict streams of an encoding, as Python opens them."""
    streams = [io.TextIOWrapper(io.BytesIO(), encoding=encoding, errors="strict") for _ in range(2)]
    monkeypatch.setattr(sys, "stdout", streams[0])
    monkeypatch.setattr(sys, "stderr", streams[1])
    status = main(arguments)
    for stream in streams:
        stream.flush()
    out, err = (stream.buffer.getvalue() for stream in streams)
    return Output(status, out, err)


@pytest.mark.parametrize("encoding", ENCODINGS)
def test_help_of_every_command(encoding: str, monkeypatch: pytest.MonkeyPatch) -> None:
    assert run(monkeypatch, encoding, "--help").status == 0
    for name in COMMANDS:
        result = run(monkeypatch, encoding, name, "--help")
        assert (result.status, name) == (0, name)
        assert result.out.decode(encoding)


@pytest.mark.parametrize("encoding", ENCODINGS)
def test_lists_errors_and_tables(encoding: str, monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    robot = tmp_path / "Vögel ²→.yaml"
    robot.write_text(dump_yaml(ROBOT), encoding="utf-8")
    assert run(monkeypatch, encoding, "list").status == 0
    assert run(monkeypatch, encoding, "list", "effects").status == 0
    result = run(monkeypatch, encoding, "robot", "check", "quad→²ü")
    assert result.status == 2
    assert b"quad" in result.err
    assert b"Traceback" not in result.err
    assert run(monkeypatch, encoding, "watch", str(robot), str(tmp_path / "日本.csv")).status == 2
    listed = json.loads(run(monkeypatch, encoding, "list", "--json").out.decode(encoding))
    monkeypatch.undo()
    utf8 = json.loads(run(monkeypatch, "utf-8", "list", "--json").out.decode("utf-8"))
    assert listed == utf8


@pytest.mark.parametrize("encoding", ["gbk", "ascii"])
def test_a_replay_with_progress_tables_and_a_report(encoding, monkeypatch, tmp_path) -> None:
    folder = tmp_path / "Flüge 飛行"
    folder.mkdir()
    robot, log = folder / "robot ü.yaml", write(flight(0, seconds=3.0, rate=100.0, noise=1.0), folder / "flug ä.csv")
    robot.write_text(dump_yaml(ROBOT), encoding="utf-8")
    result = run(monkeypatch, encoding, "replay", str(robot), str(log), "--out", str(folder / "aus ß"))
    assert result.status == 0, result.err
    assert b"m/s" in result.out
    assert "flug ä" in (folder / "aus ß" / "replay.json").read_text(encoding="utf-8")
    result = run(monkeypatch, encoding, "replay", str(robot), str(log), "--json")
    assert json.loads(result.out.decode(encoding))["flights"] == [str(log)]
