"""Logs that tests write, opened as those of users are: by their content."""

from pathlib import Path
from typing import Any

from aerial_gym.sim2real.logs.raw_log import LogChannel, RawLog
from aerial_gym.sim2real.logs.readers.log_readers import find_reader

REAL_LOGS = Path(__file__).parents[5].parent / "shared" / "data" / "real_logs"


def read_file(path: Path, kind: type) -> RawLog:
    """Return the log of a file, which a reader of a kind must recognise."""
    reader = find_reader(path)
    assert reader is not None
    assert isinstance(reader, kind)
    return reader.read(path)


def read_bytes(folder: Path, data: bytes, kind: type) -> RawLog:
    """Return the log of bytes, from a file whose name tells nothing."""
    (folder / "log").write_bytes(data)
    return read_file(folder / "log", kind)


def first_channel(log: RawLog, quantity: str, reader: Any) -> LogChannel:
    return next(one for one in reader.channels(log) if one.quantity == quantity)
