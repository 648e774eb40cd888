"""Write the content of a log as CSV, Parquet or MCAP. Letters: T samples, R rotors."""

import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, fields
from heapq import merge
from operator import attrgetter
from pathlib import Path

import numpy as np
import pandas as pd

from aerial_gym.config.shape import PartCfg
from aerial_gym.errors import DataError
from aerial_gym.extras import optional_import
from aerial_gym.sim2real.arrays import Array, Indices
from aerial_gym.sim2real.json_values import select_fields, write_json
from aerial_gym.sim2real.logs import foxglove as fox
from aerial_gym.sim2real.logs.inspection import csv_raw_log
from aerial_gym.sim2real.logs.raw_log import RawLog, Topic
from aerial_gym.sim2real.logs.readers.csv_log import FlightFacts
from aerial_gym.sim2real.logs.readers.exports import HEAD_TOPIC, LIBRARY, MARK, METADATA
from aerial_gym.sim2real.logs.readers.flight_log import open_log
from aerial_gym.sim2real.logs.readers.log_readers import read_raw_log
from aerial_gym.sim2real.logs.readers.mapping import COLUMNS, LogMapping, find_mapping
from aerial_gym.sim2real.logs.recording import FlightLog, interpolate_setpoint, split_flight_number

LAST_S = 9e9  # Latest time [s] that MCAP holds
BLOCK = 4096  # Rows that are converted to JSON at once
POSES_HZ = 50.0  # Largest rate of poses for viewers [Hz], which interpolate them
MOST_POINTS = 2000  # Of the line along a flight

RELATIVE = "share_{n}"  # Columns of commands that are shares of the largest speed


@dataclass(frozen=True, kw_only=True)
class PlotTable:
    """Values of a flight over time."""

    time: Array  # Since the start of the flight [s], (T,)
    columns: Mapping[str, Array]  # (T,) each
    units: Mapping[str, str]


def convert_log(
    path: str | Path, kind: str, out: Path, mapping: LogMapping | None = None, *,
    vehicle: Sequence[PartCfg] = (), residuals: Mapping[str, PlotTable] | None = None,
) -> list[Path]:  # fmt: skip
    """Write a log into the folder ``out`` and return the files; raise ``DataError`` if the log is unusable.

    Args:
        kind: ``csv``: one file for each flight, in the layout of this package. ``parquet``: lossless, one file for each topic,
            and ``metadata.json``. ``mcap``: all topics in JSON, and the flights as Foxglove and Lichtblick show them.
        vehicle: Parts of the vehicle for ``mcap``.
        residuals: Prediction residuals of flights by path, for ``mcap``.
    """
    out.mkdir(parents=True, exist_ok=True)
    if kind == "csv":
        return [_write_flight(flight, out) for flight in open_log(path, mapping).flights()]
    file = Path(split_flight_number(path)[0])
    raw = read_raw_log(file) or csv_raw_log(file, mapping)
    if kind == "parquet":
        return _write_parquet(raw, out)
    shown = list[Iterable[fox.McapMessage]]()
    for name, log in _flights(path, mapping):
        shown += _flight_messages(log, name, vehicle)
        if residual := (residuals or {}).get(log.path):
            time = residual.time + log.time[0]
            shown.append(_plot_messages(f"/{name}/residual", time, residual.columns, residual.units))
    return _write_mcap(raw, out, shown)


def _flights(path: str | Path, mapping: LogMapping | None) -> Iterator[tuple[str, FlightLog]]:
    """Yield the usable flights with names for topics."""
    with suppress(DataError):
        opened = open_log(path, mapping)
        for number in opened.numbers:
            with suppress(DataError):
                yield f"flight_{number}", opened.flight(number)


def flight_table(log: FlightLog) -> pd.DataFrame:
    """Return a flight as a table in the layout of this package."""
    columns = {"t": log.time}
    for quantity, names in COLUMNS.items():
        values = getattr(log, quantity)
        if values is None:
            continue
        table = values.reshape(log.time.size, -1)
        pattern = RELATIVE if quantity == "rotor_command" and log.relative_commands else names[0]
        if "{n}" in pattern:
            names = [pattern.format(n=n + 1) for n in range(table.shape[1])]
        columns |= dict(zip(names, table.T, strict=True))
    layout = find_mapping("aerial_gym").quantities()
    for quantity in log.setpoints:
        values, known = interpolate_setpoint(log, quantity)
        values[~known] = np.nan
        columns |= dict(zip(layout[quantity].columns, values.T, strict=True))
    return pd.DataFrame(columns)


def _write_flight(log: FlightLog, out: Path) -> Path:
    table = flight_table(log)
    if log.attitude_integrated:  # the gyro gives it again
        table = table.drop(columns=list(COLUMNS["attitude"]))
    path = out / f"{log.name.replace('#', '_flight_')}.csv"
    own = {entry.name: getattr(log, entry.name) for entry in fields(FlightFacts)}
    facts = FlightFacts(**{**own, "parameters": _finite_numbers(log.parameters)})
    with path.open("w", encoding="utf-8", newline="") as stream:
        stream.write(facts.line())
        table.to_csv(stream, index=False)
    return path


def _files_of_topics(raw: RawLog) -> dict[str, Topic]:
    """Return the topics by file name; a number tells apart those whose names differ only in signs that a file has not."""
    files: dict[str, Topic] = {}
    for topic in raw.topics:
        name = f"{re.sub(r'[^A-Za-z0-9_-]+', '_', topic.name).strip('_')}.{topic.instance}"
        files[name if name not in files else f"{name}.{len(files)}"] = topic
    return files


def _write_parquet(raw: RawLog, out: Path) -> list[Path]:
    """Write one file for each topic, and parameters, messages, units and names in ``metadata.json``."""
    with optional_import("writing Parquet"):
        import pyarrow
        from pyarrow import parquet
    files, topics = list[Path](), _files_of_topics(raw)
    for file, topic in topics.items():
        columns = {{"time": "time_logged"}.get(name, name): values for name, values in topic.columns.items()}
        table = {"time": topic.time} | {name: np.ascontiguousarray(values) for name, values in columns.items()}
        files.append(out / f"{file}.parquet")
        parquet.write_table(pyarrow.table(table), files[-1])
    write_json(out / METADATA, _log_head(raw, topics))
    return [*files, out / METADATA]


def _log_head(raw: RawLog, topics: Mapping[str, Topic]) -> dict[str, object]:
    """Return all but the samples of a log for JSON, with the topics by the names of their files or channels."""
    entries = {
        file: {"name": one.name, "instance": one.instance, "units": dict(one.units)} for file, one in topics.items()
    }
    head = {MARK: 1, **select_fields(raw, "path", "format", "metadata"), "topics": entries}
    return head | {"parameters": _finite_numbers(raw.parameters), **select_fields(raw, "parameter_changes", "messages")}


def _finite_numbers(parameters: Mapping[str, float | str]) -> dict[str, float | str]:
    """Return parameters for JSON; numbers that are not finite become text."""
    return {name: v if isinstance(v, str) or np.isfinite(v) else str(v) for name, v in parameters.items()}


def _json_numbers(values: Array) -> list[float | None]:
    """Return numbers for JSON, which knows neither NaN nor infinity: they become None."""
    numbers = np.asarray(values)
    return (numbers if np.isfinite(numbers).all() else np.where(np.isfinite(numbers), numbers, np.array(None))).tolist()


def _write_mcap(raw: RawLog, out: Path, shown: Sequence[Iterable[fox.McapMessage]]) -> list[Path]:
    """Write one topic of JSON messages for each topic of the log, and further messages, in the order of time."""
    path = out / f"{Path(raw.path).stem}.mcap"
    stamps = [_nanoseconds(topic.time) for topic in raw.topics]
    head = _log_head(raw, {topic.source: topic for topic in raw.topics})
    parts = [_table_messages(t.source, t.columns, time, t.name) for t, time in zip(raw.topics, stamps, strict=True)]
    file = fox.McapFile(path, LIBRARY)
    file.write(fox.McapMessage(min((int(time.min()) for time in stamps if time.size), default=0), HEAD_TOPIC, head))
    for message in merge(*parts, *shown, key=attrgetter("time")):
        file.write(message)
    file.close()
    return [path]


def _nanoseconds(time: Array) -> Indices:
    """Return time stamps [ns]; one that is no number has the time before it."""
    known = pd.Series(time).where(np.isfinite(time)).ffill().bfill().fillna(0.0)
    return np.rint(np.clip(known.to_numpy(), 0.0, LAST_S) * fox.SECOND).astype(np.int64)


def _table_messages(
    topic: str, columns: Mapping[str, Array], time: Indices, schema: str, units: Mapping[str, str] | None = None
) -> Iterator[fox.McapMessage]:
    """Yield one message for each row of a table."""
    table = {name: np.asarray(values) for name, values in columns.items()}
    for start in range(0, time.size, BLOCK):
        rows = slice(start, start + BLOCK)
        numbers = zip(*(_json_numbers(values[rows]) for values in table.values()), strict=True)
        for at, row in zip(time[rows].tolist(), numbers, strict=True):
            yield fox.McapMessage(at, topic, dict(zip(table, row, strict=True)), schema, units or {})


def _plot_messages(
    topic: str, time: Array, columns: Mapping[str, Array], units: Mapping[str, str]
) -> Iterator[fox.McapMessage]:
    """Return the rows of a table as messages for plots; time [s]."""
    return _table_messages(topic, columns, _nanoseconds(time), f"aerial_gym.{topic.rsplit('/', 1)[-1]}", units)


def _flight_messages(log: FlightLog, name: str, vehicle: Sequence[PartCfg]) -> list[Iterable[fox.McapMessage]]:
    """Return poses, states and commands of a flight; a log without positions turns at the origin."""
    table = flight_table(log)
    columns = {str(column): table[column].to_numpy() for column in table.columns}
    commands = {column: columns.pop(column) for column in list(columns) if column.startswith(("cmd_", "share_", "sp_"))}
    plots = {f"/{name}/state": columns, f"/{name}/command": commands}
    return [
        _pose_messages(log, name, vehicle),
        *(_plot_messages(topic, log.time, part, fox.column_units(part)) for topic, part in plots.items() if part),
    ]


def _pose_messages(log: FlightLog, name: str, vehicle: Sequence[PartCfg]) -> Iterator[fox.McapMessage]:
    time, body = _nanoseconds(log.time), f"{name}/vehicle"
    place = np.zeros((time.size, 3)) if log.position is None else log.position
    slots = (log.time - log.time[0]) * POSES_HZ
    rows = np.flatnonzero(np.diff(np.floor(slots + 1e-6), prepend=-1.0) > 0)
    rows = rows[np.isfinite(place[rows]).all(axis=1) & np.isfinite(log.attitude[rows]).all(axis=1)]
    if not rows.size:
        return
    still, path = ((0.0, 0.0, 0.0), fox.IDENTITY), place[rows[:: 1 + rows.size // MOST_POINTS]]
    start, line = int(time[rows[0]]), {"lines": [fox.line_primitive(path)]}
    yield fox.scene_message(start, f"/{name}/vehicle", {body: fox.part_primitives((part, *still) for part in vehicle)})
    yield fox.scene_message(start, f"/{name}/path", {fox.WORLD: line})
    for at, position, attitude in zip(time[rows].tolist(), place[rows].tolist(), log.attitude[rows], strict=True):
        turn = attitude / np.linalg.norm(attitude)
        yield fox.transforms_message(at, [fox.transform(at, fox.WORLD, body, position, turn)])
        yield fox.frame_message(at, f"/{name}/pose", "PoseInFrame", fox.WORLD, pose=fox.pose(position, turn))
