"""Write the content of a log as CSV, Parquet or MCAP. Letters: T samples, R rotors."""

import json
import re
from collections.abc import Callable, Mapping
from dataclasses import fields
from pathlib import Path

import numpy as np
import pandas as pd

from aerial_gym.errors import MissingDependencyError
from aerial_gym.sim2real.arrays import Array
from aerial_gym.sim2real.json_values import select_fields, write_json
from aerial_gym.sim2real.logs.inspection import csv_raw_log
from aerial_gym.sim2real.logs.raw_log import RawLog, Topic
from aerial_gym.sim2real.logs.readers.csv_log import FlightFacts
from aerial_gym.sim2real.logs.readers.exports import HEAD_TOPIC, LIBRARY, MARK, METADATA
from aerial_gym.sim2real.logs.readers.flight_log import open_log
from aerial_gym.sim2real.logs.readers.log_readers import read_raw_log
from aerial_gym.sim2real.logs.readers.mapping import COLUMNS, LogMapping, find_mapping
from aerial_gym.sim2real.logs.recording import FlightLog, interpolate_setpoint, split_flight_number

NANOSECONDS = 1e9  # Unit of time in MCAP per second
LAST_S = 9e9  # Latest time [s] that MCAP holds

RELATIVE = "share_{n}"  # Columns of commands that are shares of the largest speed


def convert_log(path: str | Path, kind: str, out: Path, mapping: LogMapping | None = None) -> list[Path]:
    """Write a log into the folder ``out`` and return the files: csv, parquet or mcap.

    ``csv`` holds one file for each flight, in the layout of this package. ``parquet`` is lossless: one file for each topic,
    and ``metadata.json``. ``mcap`` holds all topics with messages in JSON. Raise ``DataError`` if the log is unusable.
    """
    out.mkdir(parents=True, exist_ok=True)
    if kind == "csv":
        return [_write_flight(flight, out) for flight in open_log(path, mapping).flights()]
    file = Path(split_flight_number(path)[0])
    raw = read_raw_log(file) or csv_raw_log(file, mapping)
    writers: dict[str, Callable[[RawLog, Path], list[Path]]] = {"parquet": _write_parquet, "mcap": _write_mcap}
    try:
        return writers[kind](raw, out)
    except ImportError:
        raise MissingDependencyError(f"writing {kind} needs more packages: pip install 'aerial-gym[logs]'") from None


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


def _write_mcap(raw: RawLog, out: Path) -> list[Path]:
    """Write one channel of JSON messages for each topic."""
    from mcap.writer import Writer

    path = out / f"{Path(raw.path).stem}.mcap"
    with path.open("wb") as stream:
        writer = Writer(stream)
        writer.start(profile="", library=LIBRARY)
        head = json.dumps(_log_head(raw, {topic.source: topic for topic in raw.topics})).encode()
        channel = writer.register_channel(topic=HEAD_TOPIC, message_encoding="json", schema_id=0)
        writer.add_message(channel_id=channel, log_time=0, publish_time=0, data=head)
        for topic in raw.topics:
            properties = {name: {"type": "number"} for name in topic.columns}
            schema = json.dumps({"type": "object", "properties": properties}).encode()
            number = writer.register_schema(name=topic.name, encoding="jsonschema", data=schema)
            channel = writer.register_channel(topic=topic.source, message_encoding="json", schema_id=number)
            rows = zip(*(_json_numbers(values) for values in topic.columns.values()), strict=True)
            for at, row in zip(np.clip(np.nan_to_num(topic.time), 0.0, LAST_S).tolist(), rows, strict=True):
                stamp = round(at * NANOSECONDS)
                data = json.dumps(dict(zip(topic.columns, row, strict=True))).encode()
                writer.add_message(channel_id=channel, log_time=stamp, publish_time=stamp, data=data)
        writer.finish()
    return [path]
