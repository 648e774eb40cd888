"""A file that is followed: its lines as they come, across truncation, replacement and rotation."""

from collections.abc import Callable
from pathlib import Path

import pytest

from aerial_gym.errors import DataError
from aerial_gym.sim2real.logs.readers import follow
from aerial_gym.sim2real.logs.readers.follow import file_lines


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
