"""Readers of binary logs. Each decodes one format and finds the vehicle's quantities in it; one file each."""

from abc import ABC, abstractmethod
from collections.abc import Sequence
from functools import lru_cache
from pathlib import Path

from aerial_gym.registry.log_formats import LOG_READERS, reader_names
from aerial_gym.sim2real.logs.raw_log import LogChannel, RawLog

HEAD_BYTES = 4096  # Length of the beginning by which a reader recognises its format


class LogReader(ABC):
    """Decoder of one log format."""

    name: str  # Name in ``LOG_READERS``
    summary: str  # One line for ``aerial-gym list``

    @abstractmethod
    def recognises(self, head: bytes) -> bool:
        """Return whether a file has this format, from its first ``HEAD_BYTES``; the suffix does not count.

        For a folder, such as a ROS 2 bag, they are those of its ``metadata.yaml``.
        """

    @abstractmethod
    def read(self, path: Path) -> RawLog:
        """Return the content of a file; raise ``DataError`` if nothing can be decoded."""

    @abstractmethod
    def channels(self, log: RawLog) -> Sequence[LogChannel]:
        """Return the vehicle's quantities, the best source first where several topics hold one quantity."""


def find_reader(path: Path) -> LogReader | None:
    """Return the reader that recognises a file by its content; None for any other file, which may be CSV, or for no file."""
    file = path / "metadata.yaml" if path.is_dir() else path
    try:
        with file.open("rb") as stream:
            head = stream.read(HEAD_BYTES)
    except OSError:  # the reader of CSV files reports it
        return None
    readers = (LOG_READERS.get(name) for name in reader_names(head))
    return next((reader for reader in readers if reader.recognises(head)), None)


def read_raw_log(path: Path) -> RawLog | None:
    """Return the content of a binary log; None for a text file. The last file that was read is kept in memory."""
    reader = find_reader(path)
    if reader is None:
        return None
    state = path.stat()
    return _read_once(reader.name, str(path), state.st_mtime_ns, state.st_size)


@lru_cache(maxsize=1)
def _read_once(format_name: str, path: str, *_version: int) -> RawLog:
    return LOG_READERS.get(format_name).read(Path(path))
