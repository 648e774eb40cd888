"""Read lines of a growing text file, also when it is truncated, replaced or rotated."""

import os
import sys
import time
from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path
from typing import BinaryIO

from aerial_gym.errors import DataError
from aerial_gym.sim2real.logs.readers.csv_lines import check_is_text
from aerial_gym.sim2real.logs.readers.log_readers import find_reader
from aerial_gym.sim2real.logs.recording import split_flight_number

POLL_S = 0.05  # Polling interval [s]
START_BYTES = 256  # Number of first bytes, header and first row, compared to detect a file rewritten in place


def stdin_lines() -> Iterator[str]:
    """Yield the lines of stdin; invalid bytes are replaced. Raise ``DataError`` if the input is not text."""
    stream = getattr(sys.stdin, "buffer", None)
    if stream is None:  # a text stream in its place
        yield from sys.stdin
        return
    for number, line in enumerate(stream):
        if number == 0:
            check_is_text(line, "stdin")
        yield line.decode("utf-8-sig", errors="replace")


def is_log_of_flights(path: str | Path) -> bool:
    """Return whether a path names a binary log or selects a flight of a file, and so no growing text file."""
    file, number = split_flight_number(path)
    return number is not None or (not Path(file).is_fifo() and find_reader(Path(file)) is not None)


def file_lines(path: Path, *, follow: bool) -> Iterator[str | None]:
    """Yield the complete lines of a file, None when it starts anew; ``follow``: wait for more. Bad bytes are replaced."""
    file, part, start = _open_text_file(path), b"", b""
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
                known, start = start, _first_bytes(file)
                if _is_replaced(path, file) or not start.startswith(known):
                    files.close()
                    file, part, start = files.enter_context(_open_text_file(path)), b"", b""
                    yield None
                else:
                    time.sleep(POLL_S)
    if part:
        yield part.decode("utf-8-sig", errors="replace")


def _open_text_file(path: Path) -> BinaryIO:
    """Return a text file opened for reading at its start."""
    if is_log_of_flights(path):
        raise DataError(f"{path}: only CSV files grow by lines that can be followed; watch it without --follow")
    if path.is_dir():
        raise DataError(f"{path}: is a folder. Give a flight log (CSV), or - for rows from stdin")
    try:
        file = path.open("rb")
    except FileNotFoundError:
        raise DataError(f"{path}: no such file. Give a flight log (CSV), or - for rows from stdin") from None
    except OSError as error:
        raise DataError(f"{path}: cannot be read ({error.strerror})") from None
    if file.seekable():
        check_is_text(file.read(START_BYTES), str(path))
        file.seek(0)
    return file


def _first_bytes(file: BinaryIO) -> bytes:
    """Return the first bytes of the part already read; empty for a pipe."""
    if not file.seekable():
        return b""
    place = file.tell()
    file.seek(0)
    start = file.read(min(START_BYTES, place))
    file.seek(place)
    return start


def _is_replaced(path: Path, file: BinaryIO) -> bool:
    """Return whether the path names another file, or the file has become shorter than the part already read."""
    try:
        named = os.stat(path)
    except OSError:  # moved away, and not yet replaced
        return False
    own = os.fstat(file.fileno())
    other = (named.st_dev, named.st_ino) != (own.st_dev, own.st_ino)
    return file.seekable() and (other or own.st_size < file.tell())
