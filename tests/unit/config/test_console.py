"""Characters that a console or a file system lacks."""

import io
import json
import sys
from pathlib import Path

import pytest

from aerial_gym.config.console import accept_any_console, json_line
from aerial_gym.config.storage import write_atomic


@pytest.mark.parametrize(
    ("encoding", "text", "shown"),
    [
        ("ascii", "3 m/s² ± 5 % → 90° ü 日", "3 m/s2 +- 5 % -> 90deg u ?"),
        ("gbk", "m/s² 日", "m/s2 日"),
        ("cp932", "m/s² ± ü", "m/s2 ± u"),
        ("utf-8", "m/s² → 日", "m/s² → 日"),
        ("utf-8", "fl\udcfcg", "fl?g"),
    ],
)
def test_a_console_shows_plain_letters_for_what_it_lacks(encoding, text, shown, monkeypatch) -> None:
    stream = io.TextIOWrapper(io.BytesIO(), encoding=encoding)
    monkeypatch.setattr(sys, "stdout", stream)
    monkeypatch.setattr(sys, "stderr", io.StringIO())  # cannot be told
    accept_any_console()
    print(text, end="", flush=True)
    assert stream.buffer.getvalue().decode(encoding) == shown


@pytest.mark.parametrize("encoding", ["ascii", "gbk", "UTF8", None])
def test_json_on_stdout_loses_nothing(encoding: str | None, monkeypatch: pytest.MonkeyPatch) -> None:
    stream = type("Stream", (io.StringIO,), {"encoding": encoding})()
    monkeypatch.setattr(sys, "stdout", stream)
    line = json_line({"unit": "m/s²", "path": "日"})
    line = json_line({"unit": "m/s²", "path": "日"})
    assert json.loads(line) == {"unit": "m/s²", "path": "日"}
    assert line.isascii() is (encoding in ("ascii", "gbk"))


def test_names_that_are_no_text_are_written_as_their_bytes(tmp_path: Path) -> None:
    write_atomic(tmp_path / "a.txt", b"fl\xfcg".decode("utf-8", "surrogateescape"))
    assert (tmp_path / "a.txt").read_bytes() == b"fl\xfcg"
