"""The fleet's tables: Delta tables in one folder, with their settings in ``fleet.json``.

One program writes at a time (``lock.py``). A flight counts as done once its row is in ``flights``, which is written last.
"""

import json
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from datetime import UTC, datetime
from functools import reduce
from itertools import chain
from operator import and_
from pathlib import Path
from typing import Any

import pyarrow as pa
import pyarrow.dataset as arrow_dataset
from deltalake import DeltaTable, WriterProperties, write_deltalake
from deltalake.exceptions import DeltaError
from pyarrow.fs import LocalFileSystem, SubTreeFileSystem

from aerial_gym.config.storage import FULL, storage_message, write_atomic
from aerial_gym.errors import AerialGymError, ConfigError, StorageError
from aerial_gym.fleet.migration import migrate
from aerial_gym.fleet.schemas import KEY, SCHEMA_VERSION, SCHEMAS

Row = Mapping[str, Any]
_FILE_ROWS = WriterProperties(compression="ZSTD", max_row_group_size=1024)
"""Small row groups, so that a reader of a few vehicles skips most of a file."""
_HISTORY = {"delta.logRetentionDuration": "interval 1 days"}  # Of commits, which are many where a folder is watched


@contextmanager
def table_errors(out: Path) -> Iterator[None]:
    """Raise ``StorageError`` with the remedy in place of errors of the disk and of the packages of the tables."""
    try:
        yield
    except (AerialGymError, BrokenPipeError):
        raise
    except (DeltaError, pa.ArrowInvalid, OSError) as error:
        text = " ".join(str(error).split())
        code = next((code for code in FULL if f"os error {code})" in text), getattr(error, "errno", None))
        remedy = "Allow access to the folder, or restore it; then start again, as finished flights are kept"
        message = storage_message(OSError(code, "")) if code in FULL else f"the tables fail ({text}). {remedy}"
        raise StorageError(f"{out}: {message}") from None


class FleetTables:
    """Tables in a folder; ``schemas.py`` has their columns."""

    def __init__(self, out: Path) -> None:
        """Open existing tables; raise ``ConfigError`` if there are none, or if a newer version has written them."""
        self.out = out
        if not (out / "fleet.json").is_file():
            raise ConfigError(f"{out}: holds no fleet tables. Make them with: aerial-gym fleet run --out {out}")
        if (version := self.description()["schema_version"]) > SCHEMA_VERSION:
            raise ConfigError(
                f"{out}: its tables have schema {version}, and this version of aerial-gym knows {SCHEMA_VERSION}. "
                "Update aerial-gym, or give another --out"
            )

    @classmethod
    def create(cls, out: Path, settings: Mapping[str, object]) -> "FleetTables":
        """Open the tables for writing: make them, or migrate older ones. Other settings than theirs raise ``ConfigError``."""
        if (out / "fleet.json").is_file():
            tables = cls(out)
            tables._check_settings(settings)
            migrate(out, tables.description()["schema_version"])
        for name, schema in SCHEMAS.items():
            DeltaTable.create(out / name, schema, mode="ignore", configuration=_HISTORY)
        write_atomic(out / "fleet.json", json.dumps({"schema_version": SCHEMA_VERSION, "settings": settings}, indent=1))
        return cls(out)

    def _check_settings(self, settings: Mapping[str, object]) -> None:
        known = self.description()["settings"]
        faults = [
            f"{self.out}: was made with {name} = {known.get(name)!r}, not {value!r}; give another --out, or the same {name}"
            for name, value in settings.items()
            if known.get(name) != value
        ]
        if faults:
            raise ConfigError(*faults)

    def description(self) -> dict[str, Any]:
        """Return the content of ``fleet.json``."""
        return json.loads((self.out / "fleet.json").read_text(encoding="utf-8"))

    def dataset(self, name: str) -> arrow_dataset.Dataset:
        """Return a table as an Arrow dataset, of its present version."""
        files = SubTreeFileSystem(
            str(self.out / name), LocalFileSystem()
        )  # deltalake's own can abort Python at its end
        with table_errors(self.out):
            return DeltaTable(self.out / name).to_pyarrow_dataset(filesystem=files)

    def versions(self) -> list[int]:
        """Return the version of each table."""
        with table_errors(self.out):
            return [DeltaTable(self.out / name).version() for name in SCHEMAS]

    def rows(self, name: str, columns: Iterable[str], /, **equal: object) -> Iterator[dict[str, Any]]:
        """Yield rows of a table, batch by batch; ``equal``: the value of a column that rows must have, or a list of texts."""
        ahead = {"batch_readahead": 1, "fragment_readahead": 1}  # Arrow reads 16 batches of moments ahead by itself
        for batch in self.dataset(name).to_batches(columns=list(columns), filter=match_columns(**equal), **ahead):
            yield from batch.to_pylist()

    def keys(self, name: str) -> set[tuple[str, ...]]:
        """Return the keys of flights in a table."""
        keys = set[tuple[str, ...]]()
        for batch in self.dataset(name).to_batches(columns=list(KEY)):
            distinct = pa.table(batch).group_by(list(KEY)).aggregate([])
            keys.update(zip(*(column.to_pylist() for column in distinct.select(KEY).columns), strict=True))
        return keys

    def append(self, name: str, rows: Iterable[Row]) -> None:
        """Append rows in one commit."""
        table = _table(name, rows)
        if table.num_rows:
            write_deltalake(self.out / name, table, mode="append", writer_properties=_FILE_ROWS)

    def replace(self, name: str, where: arrow_dataset.Expression, rows: Iterable[Row] = ()) -> None:
        """Replace the rows that satisfy a condition, in one commit that streams the table.

        Delta's own ``delete`` and ``update`` write text in a form that Arrow cannot compare.
        """
        new, data = _table(name, rows), self.dataset(name)
        batches = chain(data.to_batches(filter=~where), new.to_batches())
        stream = pa.RecordBatchReader.from_batches(
            data.schema, (batch.select(data.schema.names).cast(data.schema) for batch in batches)
        )
        write_deltalake(self.out / name, stream, mode="overwrite", writer_properties=_FILE_ROWS)

    def columns_by_digest(self) -> dict[str, Any]:
        """Return the columns of the evidence by digest."""
        return self._read_json("columns.json", {})

    def cohorts(self) -> list[dict[str, Any]]:
        """Return the differences between firmware versions, which the last run found in a sample of the vehicles."""
        return self._read_json("cohorts.json", [])

    def _read_json(self, name: str, default: Any) -> Any:
        file = self.out / name
        return json.loads(file.read_text(encoding="utf-8")) if file.is_file() else default

    def add_columns(self, columns: Mapping[str, str]) -> None:
        """Add columns of the evidence: JSON by digest."""
        known = self.columns_by_digest()
        if columns.keys() - known.keys():
            content = known | {digest: json.loads(text) for digest, text in columns.items()}
            write_atomic(self.out / "columns.json", json.dumps(content, sort_keys=True))

    def discard_incomplete(self) -> None:
        """Remove evidence whose flights are not written, as the program was killed, and refusals for want of a robot."""
        no_robot = match_columns(robot_hash="")
        if self.dataset("flights").count_rows(filter=no_robot):
            self.replace("flights", no_robot)
        orphans = self.keys("evidence") - self.keys("flights")
        for robot_hash, version in {key[1:] for key in orphans}:
            logs = [log for log, *rest in orphans if rest == [robot_hash, version]]
            self.replace("evidence", match_columns(log_hash=logs, robot_hash=robot_hash, model_version=version))

    def compact(self, most_files: int = 1) -> None:
        """Join the files of tables that have more than ``most_files``; remove those that no reader of the last hour can use."""
        for name in SCHEMAS:
            table = DeltaTable(self.out / name)
            if len(table.file_uris()) > most_files:
                table.optimize.compact(writer_properties=_FILE_ROWS)
            table.vacuum(retention_hours=1, dry_run=False, enforce_retention_duration=False)


def match_columns(**values: object) -> arrow_dataset.Expression:
    """Return the condition that columns have values; a list of texts allows each of them."""
    fields = ((arrow_dataset.field(name), value) for name, value in values.items())
    rules = (f.isin(pa.array(v, pa.string())) if isinstance(v, list) else f == v for f, v in fields)
    return reduce(and_, rules, arrow_dataset.scalar(True))


def _table(name: str, rows: Iterable[Row]) -> pa.Table:
    now = datetime.now(UTC)
    return pa.Table.from_pylist([{**row, "written_at": now} for row in rows], schema=SCHEMAS[name])
