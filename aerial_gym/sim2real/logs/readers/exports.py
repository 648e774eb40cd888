"""Read back logs that ``log convert`` wrote as Parquet or MCAP; quantities are found by the reader of their first format.

Letters: T samples.
"""

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from aerial_gym.errors import DataError
from aerial_gym.extras import optional_import
from aerial_gym.registry.log_formats import LOG_READERS
from aerial_gym.sim2real.arrays import Array
from aerial_gym.sim2real.logs.raw_log import (
    FREE_BYTES,
    MOST_GROWTH,
    LogChannel,
    LogMessage,
    LogParameterChange,
    RawLog,
    Topic,
)
from aerial_gym.sim2real.logs.readers.log_readers import CSV, LogReader
from aerial_gym.sim2real.logs.readers.ros_files import MCAP, json_columns, read_message_sources

MARK = "aerial_gym_log"  # First key of ``metadata.json``
LIBRARY = "aerial_gym"  # Writer of an MCAP file, in its first record
HEAD_TOPIC = "aerial_gym/log"  # Topic of an MCAP file with one message, the content of ``metadata.json``
METADATA = "metadata.json"
LARGEST_METADATA = 2**26  # [B]


class LogExportReader(LogReader):
    """Reader of Parquet folders and MCAP files of ``log convert``."""

    name = "log_export"
    summary = "Parquet folders and MCAP files of `log convert`"

    def recognises(self, head: bytes) -> bool:
        """Return whether the file, or the ``metadata.json`` of its folder, is a converted log."""
        is_mcap = head.startswith(MCAP) and head[25 : 25 + len(LIBRARY)] == LIBRARY.encode()
        return is_mcap or head.lstrip().removeprefix(b"{").lstrip().startswith(f'"{MARK}"'.encode())

    def read(self, path: Path) -> RawLog:
        """Return the content of the log before its conversion."""
        path = path.parent if path.name == METADATA else path
        try:
            head, topics = _read_folder(path) if path.is_dir() else _read_mcap(path)
            messages = [
                LogMessage(time=one["time_s"], level=one["level"], text=one["text"]) for one in head["messages"]
            ]
            changes = [
                LogParameterChange(
                    time=float(one["time_s"]), name=one["name"], before=one["before"], value=one["value"]
                )
                for one in head.get("parameter_changes", ())
            ]
            name, metadata = str(head["format"]), dict(head["metadata"])
            parameters = {key: v if isinstance(v, str) else float(v) for key, v in head["parameters"].items()}
        except DataError:
            raise
        except (KeyError, TypeError, ValueError, OverflowError, AttributeError, OSError) as error:
            raise DataError(
                f"{path}: is no complete converted log ({type(error).__name__}); convert the log again"
            ) from None
        if (name not in LOG_READERS and name != CSV) or name == self.name:
            raise DataError(f"{path}: was converted from {name!r}, which no reader here knows; give the file itself")
        return RawLog(
            path=str(path),
            format=name,
            topics=topics,
            parameters=parameters,
            parameter_changes=tuple(changes),
            messages=tuple(messages),
            metadata=metadata,
        )

    def channels(self, log: RawLog) -> Sequence[LogChannel]:
        """Return the quantities by the reader of the log's first format."""
        return LOG_READERS.get(log.format).channels(log)


def _read_folder(path: Path) -> tuple[dict[str, Any], tuple[Topic, ...]]:
    """Return the content of ``metadata.json`` and the topics, one file each."""
    with optional_import("reading Parquet"):
        from pyarrow import ArrowException, parquet  # pyright: ignore[reportMissingImports]
    file = path / METADATA
    if file.stat().st_size > LARGEST_METADATA:
        raise DataError(f"{file}: has more than {LARGEST_METADATA:,} bytes; it is no log")
    head, topics = json.loads(file.read_text(encoding="utf-8", errors="surrogateescape")), list[Topic]()
    for name, entry in head["topics"].items():
        part = path / f"{Path(name).name}.parquet"
        try:
            shape = parquet.read_metadata(part)
            if 8 * shape.num_rows * shape.num_columns > MOST_GROWTH * part.stat().st_size + FREE_BYTES:
                raise DataError(f"{part}: grows to more than {MOST_GROWTH} times its size; it is no log")
            table = parquet.read_table(part)
        except ArrowException as error:
            raise DataError(f"{part}: is no Parquet file ({type(error).__name__}); convert the log again") from None
        columns = {key: table[key].to_numpy() for key in table.column_names}
        topics.append(_topic(entry, columns.pop("time"), columns))
    return head, tuple(topics)


def _read_mcap(path: Path) -> tuple[dict[str, Any], tuple[Topic, ...]]:
    """Return the content of the message on ``HEAD_TOPIC`` and the other topics."""
    sources = {source.topic: source for source in read_message_sources(path) if source.encoding == "json"}
    if HEAD_TOPIC not in sources:
        raise DataError(f"{path}: has no message on {HEAD_TOPIC}; convert the log again")
    head, topics = json.loads(sources.pop(HEAD_TOPIC).messages[0]), list[Topic]()
    for name, entry in head["topics"].items():
        if (source := sources.get(name)) is not None:
            topics.append(_topic(entry, np.array(source.times) / 1e9, json_columns(source.messages)))
    return head, tuple(topics)


def _topic(entry: Mapping[str, Any], time: Array, columns: dict[str, Array]) -> Topic:
    if "time_logged" in columns:
        columns["time"] = columns.pop("time_logged")
    time = np.asarray(time, dtype=np.float64)
    numbers = {key: values for key, values in columns.items() if pd.api.types.is_numeric_dtype(values)}
    return Topic(
        name=str(entry["name"]), instance=int(entry["instance"]), time=time, columns=numbers, units=dict(entry["units"])
    )
