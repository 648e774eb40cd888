"""Atomic writes of files, and the message for a full disk.

An archive is a zip file of ``torch.save`` whose entries carry check sums; torch itself does not look at them.
"""

import errno
import io
import os
import zipfile
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from aerial_gym.errors import AerialGymError, ConfigError, StorageError

FULL = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG)  # Codes of a disk, a quota or a limit that is reached


def user_cache_folder(content: str) -> Path:
    """Return the folder ``aerial_gym/CONTENT`` in the user's cache folder."""
    caches = os.environ.get("XDG_CACHE_HOME") or os.path.join(os.path.expanduser("~"), ".cache")
    return Path(caches) / "aerial_gym" / content


def write_atomic(path: str | Path, content: bytes | str) -> None:
    """Write a file atomically: even after a crash or with a full disk it holds either the old or the new content.

    The content goes to a temporary file in the same folder, which is synced and then renamed.
    """
    path = Path(path)
    partial = path.with_name(f".{path.name}.partial")
    data = content.encode("utf-8", "surrogateescape") if isinstance(content, str) else content
    with storage_errors(path):
        try:
            with partial.open("wb") as file:
                file.write(data)
                file.flush()
                os.fsync(file.fileno())
            partial.replace(path)
            _sync_folder(path.parent)
        finally:
            partial.unlink(missing_ok=True)


def write_archive(path: str | Path, payload: Mapping[str, object]) -> None:
    """Write nested mappings, sequences, tensors, numbers and text; a kill or a full disk leaves the old file as it was."""
    import torch

    memory = io.BytesIO()
    torch.save(dict(payload), memory)
    write_atomic(path, memory.getvalue())


def read_archive(path: str | Path, kind: str) -> dict[str, Any]:
    """Return the content of an archive by ``write_archive``, or of ``.npz``, on the CPU, without running code from the file."""
    import torch

    path = Path(path)
    if not path.is_file():
        raise ConfigError(f"{kind} {path}: no such file")
    try:
        with zipfile.ZipFile(path) as archive:
            damaged = archive.testzip()
    except Exception:  # the library raises various types for a damaged archive
        raise ConfigError(f"{kind} {path}: cannot be read, it is damaged or no {kind}") from None
    if damaged is not None:
        raise ConfigError(f"{kind} {path}: is damaged, the check sum of {damaged!r} is another")
    try:
        payload = (
            _read_arrays(path) if path.suffix == ".npz" else torch.load(path, map_location="cpu", weights_only=True)
        )
    except Exception:  # torch's own message advises to unpickle arbitrary code
        raise ConfigError(f"{kind} {path}: holds more than tensors, numbers and text: it is not opened") from None
    if not isinstance(payload, dict):
        raise ConfigError(f"{kind} {path}: must hold a mapping, found {type(payload).__name__}")
    return payload


def _read_arrays(path: Path) -> dict[str, Any]:
    """Return the arrays of an ``.npz`` file as tensors in nested mappings; a name is a path such as ``model/weight``."""
    import numpy as np
    import torch

    payload = dict[str, Any]()
    with np.load(path, allow_pickle=False) as arrays:
        for name in arrays.files:
            *above, last = name.split("/")
            place = payload
            for part in above:
                place = place.setdefault(part, {})
            place[last] = torch.from_numpy(arrays[name])
    return payload


@contextmanager
def storage_errors(where: str | Path, *, only_full: bool = False) -> Iterator[None]:
    """Convert an ``OSError`` of a write into a ``StorageError`` with ``where``; with ``only_full``, only for a full disk."""
    try:
        yield
    except AerialGymError:
        raise
    except OSError as error:
        if only_full and error.errno not in FULL:
            raise
        raise StorageError(storage_message(error, where)) from None


def storage_message(error: OSError, where: str | Path | None = None) -> str:
    """Return the message for a failed write, with the remedy."""
    name = error.filename if where is None else where
    place = "" if name is None else f"{name}: "
    if error.errno in FULL:
        return f"{place}cannot be written, the disk is full. Free some space, or write elsewhere"
    return f"{place}cannot be written ({(error.strerror or str(error)).lower()})"


def _sync_folder(folder: Path) -> None:
    """Sync a folder, so that a new file name survives a power cut if the system supports it."""
    descriptor = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    except OSError as error:
        if error.errno in FULL:
            raise
    finally:
        os.close(descriptor)
