"""Logs in folders and object stores (fsspec): listing, fetching and hashing, each with flat memory."""

import hashlib
import os
import re
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from fnmatch import fnmatch
from math import isfinite
from pathlib import Path
from typing import TYPE_CHECKING, Any

from aerial_gym.errors import ConfigError, MissingDependencyError

if TYPE_CHECKING:
    from fsspec import AbstractFileSystem

NO_LOGS = {
    ".json", ".yaml", ".yml", ".xml", ".md", ".html", ".pdf", ".png", ".jpg", ".svg", ".zip", ".gz", ".npz", ".py",
}  # fmt: skip
DESCRIPTIONS = {"metadata.json": {".parquet"}, "metadata.yaml": {".db3", ".mcap"}}
"""Files that make a folder one log, with the suffixes of its data: Parquet of ``log convert``, and bags of ROS 2."""

CHUNK = 1 << 20  # Bytes hashed at once


@dataclass(frozen=True, kw_only=True)
class LogReference:
    """A log in a store, before it is read."""

    path: str  # Path or URL
    size: int  # [bytes]
    modified: str  # State of the file, as its store reports it: the time of its last change, or a tag of its content
    rank: int  # Place among the logs of the store


@dataclass(frozen=True, kw_only=True)
class LogStore:
    """A folder, or the URL of an object store, with logs in any depth."""

    url: str
    pattern: str = "*"  # Names of logs

    def filesystem(self) -> "tuple[AbstractFileSystem, str]":
        """Return the file system and the path in it; raise ``MissingDependencyError`` if its package is not installed."""
        from fsspec.core import url_to_fs

        try:
            return url_to_fs(self.url)
        except ImportError as error:
            raise MissingDependencyError(f"--logs {self.url}: {error}") from None
        except ValueError as error:
            raise ConfigError(f"--logs {self.url}: {error}. Give a folder, or a URL such as s3://bucket/logs") from None

    def check(self) -> None:
        """Raise ``ConfigError`` if the store does not exist or cannot be reached."""
        system, root = self.filesystem()
        try:
            exists = system.exists(root)
        except Exception as error:  # of any file system's own type
            raise ConfigError(f"--logs {self.url}: cannot be reached ({error})") from None
        if not exists:
            raise ConfigError(f"--logs {self.url}: no such folder or store")

    def logs(self) -> Iterator[LogReference]:
        """Yield the logs folder by folder, in the order of their names, numbers in them by value."""
        system, root = self.filesystem()
        system.invalidate_cache()
        try:
            for rank, entry in enumerate(self._entries(system, root, set())):
                path = entry["name"] if "file" in _protocols(system) else system.unstrip_protocol(entry["name"])
                yield LogReference(path=path, size=entry["size"] or 0, modified=_state_of_file(entry), rank=rank)
        except OSError as error:
            raise ConfigError(f"--logs {self.url}: cannot be listed ({error})") from None

    def _entries(self, system: "AbstractFileSystem", folder: str, entered: set[str]) -> Iterator[dict[str, Any]]:
        """Yield files and folders that are logs. Links count as their targets, but each folder is entered once."""
        if "file" in _protocols(system):
            if (place := os.path.realpath(folder)) in entered:
                return
            entered.add(place)
        listed = [_link_target(system, entry) for entry in system.ls(folder, detail=True)]
        entries = [entry for entry in listed if entry["name"].rstrip("/") != folder.rstrip("/")]
        if any(Path(entry["name"]).name == "fleet.json" for entry in entries):  # tables of a fleet
            return
        suffixes = {Path(entry["name"]).suffix for entry in entries}
        for name in {Path(entry["name"]).name for entry in entries} & DESCRIPTIONS.keys():
            if suffixes & DESCRIPTIONS[name]:
                size, modified = sum(entry["size"] or 0 for entry in entries), max(map(_state_of_file, entries))
                yield {"name": folder, "size": size, "mtime": modified}
                return
        for entry in sorted(entries, key=lambda entry: natural_order(entry["name"])):
            name = Path(entry["name"]).name
            if name.startswith("."):
                continue
            if entry["type"] == "directory":
                yield from self._entries(system, entry["name"], entered)
            elif entry["type"] == "file" and Path(name).suffix.lower() not in NO_LOGS and fnmatch(name, self.pattern):
                yield entry  # and no pipe, socket or device, which could keep a reader waiting

    def is_folder(self, folder: Path) -> bool:
        """Return whether the store is a folder of this machine, this one."""
        return "://" not in self.url and Path(self.url).resolve() == folder.resolve()

    def fetch(self, reference: LogReference, folder: Path) -> Path:
        """Return a local path of a log; one of a remote store is copied into ``folder``."""
        system, _ = self.filesystem()
        if "file" in _protocols(system):
            return Path(reference.path)
        local = folder / f"{reference.rank}" / reference.path.rstrip("/").rpartition("/")[2]
        local.parent.mkdir(parents=True, exist_ok=True)
        system.get(system._strip_protocol(reference.path), str(local), recursive=True)
        return local


def _link_target(system: "AbstractFileSystem", entry: dict[str, Any]) -> dict[str, Any]:
    """Return an entry, that of its target for a link. A broken link stays, as a file that is not delivered."""
    try:
        return system.info(entry["name"]) if entry.get("islink") else entry
    except OSError:
        return entry | {"type": "file"}


def _protocols(system: "AbstractFileSystem") -> Iterable[str]:
    return (system.protocol,) if isinstance(system.protocol, str) else system.protocol


def natural_order(name: str) -> list[tuple[int, str]]:
    """Return a key that sorts ``flight_9`` before ``flight_10``."""
    return [(int(part), "") if part.isdigit() else (-1, part) for part in re.split(r"(\d+)", name) if part]


ORDER = ("path", "start_time", "written_at")  # Columns of ``flights`` that order the flights of a vehicle


def sort_by_time(flights: Iterable[dict[str, Any]]) -> list[dict[str, Any]]:
    """Return the rows of a vehicle's flights by their start times, or all by their paths if a log does not state its time.

    Of a log that was completed after it was read, the last row counts.
    """
    newest = {row["path"]: row for row in sorted(flights, key=lambda row: row["written_at"])}
    rows = sorted(newest.values(), key=lambda row: natural_order(row["path"]))
    return sorted(rows, key=lambda row: row["start_time"]) if all(isfinite(row["start_time"]) for row in rows) else rows


def _state_of_file(entry: Mapping[str, Any]) -> str:
    return next((str(entry[key]) for key in ("ETag", "mtime", "LastModified", "created") if entry.get(key)), "")


def hash_of_log(path: Path) -> str:
    """Return the SHA-256 of a file, or of a folder's files with their names."""
    digest = hashlib.sha256()
    for file in sorted(file for file in path.iterdir() if file.is_file()) if path.is_dir() else [path]:
        if path.is_dir():
            digest.update(file.name.encode() + b"\0")
        with file.open("rb") as stream:
            while chunk := stream.read(CHUNK):
                digest.update(chunk)
    return digest.hexdigest()
