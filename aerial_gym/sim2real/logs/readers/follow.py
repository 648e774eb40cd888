"""Lines of a text file while it is written, across restarts: it may be truncated, replaced or rotated."""

import os
import sys
import time
from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path
from typing import BinaryIO

from aerial_gym.errors import DataError
from aerial_gym.sim2real.logs.readers.csv_lines import check_text

POLL_S = 0.05
"""Time between two looks for more [s]."""

START_BYTES = 256
"""So many first bytes tell whether a file was written anew in place: a log begins with its header and first row."""


def stdin_lines() -> Iterator[str]:
    """Yield the lines of stdin; bytes that are no text are replaced.

    Raises:
        DataError: If it is no text.
    """
    stream = getattr(sys.stdin, "buffer", None)
    if stream is None:  # a text stream in its place
        yield from sys.stdin
        return
    for number, line in enumerate(stream):
        if number == 0:
            check_text(line, "stdin")
        yield line.decode("utf-8-sig", errors="replace")


def file_lines(path: Path, *, follow: bool) -> Iterator[str | None]:
    """Yield the whole lines of a file, and None where it begins anew; bytes that are no text are replaced.

    Args:
        path: The file.
        follow: Whether to wait for more lines at its end, for ever.

    Raises:
        DataError: If it cannot be read, or is no text.
    """
    file, part, start = _opened(path), b"", b""
    with ExitStack() as files:
        files.enter_context(file)
        while True:
            more = file.readline()
            part += more
            if part.endswith(b"\n"):
                yield part.decode("utf-8-sig", errors="replace")
                part = b""
            elif not more and not follow:
                break
            elif not more:
                known, start = start, _start_of(file)
                if _is_replaced(path, file) or not start.startswith(known):
                    files.close()
                    file, part, start = files.enter_context(_opened(path)), b"", b""
                    yield None
                else:
                    time.sleep(POLL_S)
    if part:
        yield part.decode("utf-8-sig", errors="replace")


def _opened(path: Path) -> BinaryIO:
    """Return a file opened at its beginning, if it is text."""
    if path.is_dir():
        raise DataError(f"{path}: is a folder. Give a flight log (CSV), or - for rows from stdin")
    try:
        file = path.open("rb")
    except FileNotFoundError:
        raise DataError(f"{path}: no such file. Give a flight log (CSV), or - for rows from stdin") from None
    except OSError as error:
        raise DataError(f"{path}: cannot be read ({error.strerror})") from None
    if file.seekable():
        check_text(file.read(START_BYTES), str(path))
        file.seek(0)
    return file


def _start_of(file: BinaryIO) -> bytes:
    """Return the first bytes of what was read of a file; nothing of a pipe."""
    if not file.seekable():
        return b""
    place = file.tell()
    file.seek(0)
    start = file.read(min(START_BYTES, place))
    file.seek(place)
    return start


def _is_replaced(path: Path, file: BinaryIO) -> bool:
    """Return whether the name stands for another file, or the file is shorter than what was read of it."""
    try:
        named = os.stat(path)
    except OSError:  # moved away, and not yet replaced
        return False
    own = os.fstat(file.fileno())
    other = (named.st_dev, named.st_ino) != (own.st_dev, own.st_ino)
    return file.seekable() and (other or own.st_size < file.tell())
