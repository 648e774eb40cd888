"""Files that are whole or not there at all, and what is said of a disk that takes no more."""

import errno
import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from aerial_gym.errors import AerialGymError, StorageError

FULL = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG)
"""Codes of a disk, a quota or a limit that is reached."""


def write_whole(path: str | Path, content: bytes | str) -> None:
    """Write a file so that at any moment, also after a crash, either the old or the new content is there.

    The content goes to a temporary file beside it, which is synced and then renamed.

    Raises:
        StorageError: If it cannot be written; the old content, if any, is still there and the temporary file is not.
    """
    path = Path(path)
    partial = path.with_name(f".{path.name}.partial")
    data = content.encode("utf-8") if isinstance(content, str) else content
    with told_storage(path):
        try:
            with partial.open("wb") as file:
                file.write(data)
                file.flush()
                os.fsync(file.fileno())
            partial.replace(path)
            _sync_folder(path.parent)
        finally:
            partial.unlink(missing_ok=True)


@contextmanager
def told_storage(where: str | Path, *, only_full: bool = False) -> Iterator[None]:
    """Turn an ``OSError`` of writing into one sentence that names ``where``; with ``only_full``, only that of a full disk.

    Raises:
        StorageError: In place of such an ``OSError``.
    """
    try:
        yield
    except AerialGymError:
        raise
    except OSError as error:
        if only_full and error.errno not in FULL:
            raise
        raise StorageError(storage_sentence(error, where)) from None


def storage_sentence(error: OSError, where: str | Path | None = None) -> str:
    """Return what a person reads of a file that could not be written, and the way out."""
    name = error.filename if where is None else where
    place = "" if name is None else f"{name}: "
    if error.errno in FULL:
        return f"{place}cannot be written, the disk is full. Free some space, or write elsewhere"
    return f"{place}cannot be written ({(error.strerror or str(error)).lower()})"


def _sync_folder(folder: Path) -> None:
    """Let the new name of a file survive a power cut as well, where the system can."""
    descriptor = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    except OSError as error:
        if error.errno in FULL:
            raise
    finally:
        os.close(descriptor)
