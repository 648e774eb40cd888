"""Readers of binary logs. Each decodes one format and finds the vehicle's quantities in it; one file each."""

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import replace
from functools import lru_cache
from pathlib import Path

from aerial_gym.registry.log_formats import LOG_READERS, reader_names
from aerial_gym.sim2real.findings import Finding
from aerial_gym.sim2real.logs.raw_log import LogChannel, RawLog

CSV = "csv"  # Format of a CSV file, which has no reader of a binary log
HEAD_BYTES = 4096  # Length of the beginning by which a reader recognises its format


class LogReader(ABC):
    """Decoder of one log format."""

    name: str  # Name in ``LOG_READERS``
    summary: str  # One line for ``aerial-gym list``

    @abstractmethod
    def recognises(self, head: bytes) -> bool:
        """Return whether a file has this format, from its first ``HEAD_BYTES``; the suffix does not count.

        For a folder, such as a ROS 2 bag, they are those of its ``metadata.yaml`` or ``metadata.json``.
        """

    @abstractmethod
    def read(self, path: Path) -> RawLog:
        """Return the content of a file; raise ``DataError`` if nothing can be decoded."""

    @abstractmethod
    def channels(self, log: RawLog) -> Sequence[LogChannel]:
        """Return the vehicle's quantities, the best source first where several topics hold one quantity."""


def find_reader(path: Path) -> LogReader | None:
    """Return the reader that recognises a file by its content; None for any other file, which may be CSV, or for no file."""
    names = ("metadata.yaml", "metadata.json") if path.is_dir() else ("",)
    file = next((path / name for name in names if (path / name).exists()), path)
    try:
        with file.open("rb") as stream:
            head = stream.read(HEAD_BYTES)
    except OSError:  # the reader of CSV files reports it
        return None
    readers = (LOG_READERS.get(name) for name in reader_names(head))
    return next((reader for reader in readers if reader.recognises(head)), None)


def read_raw_log(path: Path) -> RawLog | None:
    """Return the content of a binary log; None for a CSV file, also a converted one."""
    raw = _read_known_format(path)
    return None if raw is None or raw.format == CSV else raw


def read_csv_export(path: Path) -> RawLog | None:
    """Return the content of a CSV file that was converted to Parquet or MCAP; None for other files."""
    raw = _read_known_format(path)
    return raw if raw is not None and raw.format == CSV else None


def _read_known_format(path: Path) -> RawLog | None:
    """Return the content of a file of a registered format, None for others. The last file that was read stays in memory."""
    reader = find_reader(path)
    if reader is None:
        return None
    states = [file.stat() for file in (path.iterdir() if path.is_dir() else (path,))]
    version = max(one.st_mtime_ns for one in states), sum(one.st_size for one in states)
    return _read_once(reader.name, str(path), *version)


@lru_cache(maxsize=1)
def _read_once(format_name: str, path: str, *_version: int) -> RawLog:
    raw = LOG_READERS.get(format_name).read(Path(path))
    return replace(raw, notes=(*raw.notes, *findings_on_simulation(raw)))


def findings_on_simulation(raw: RawLog) -> list[Finding]:
    """Return the finding that a log is of a simulation, with its evidence; empty if the log shows none.

    Source: PX4 parameter reference, SYS_HITL; PX4's ``ver_hw`` and topics ``*_groundtruth``, which only simulators publish;
    ArduPilot documentation, *SITL*: parameters SIM_* are of builds for simulation; Gazebo's topics of ROS.
    """
    evidence = [f"SYS_HITL = {raw.number('SYS_HITL', 0.0):g}"] if raw.number("SYS_HITL", 0.0) > 0.0 else []
    evidence += [f"hardware {name}" for name in [raw.metadata.get("ver_hw", "")] if "SITL" in name]
    evidence += [f"topic {one.name}" for one in raw.topics if "groundtruth" in one.name or "/gazebo/" in one.name][:1]
    if raw.format == "dataflash":
        evidence += [f"parameter {name}" for name in raw.parameters if name.startswith("SIM_")][:1]
    return [Finding("log_simulated", "", {"evidence": evidence})] if evidence else []
