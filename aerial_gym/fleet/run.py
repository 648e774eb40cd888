"""``fleet run``: pass 1 over the logs that have no rows yet, then pass 2 over all of them."""

import shutil
import time
from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from collections.abc import Set as AbstractSet
from dataclasses import dataclass, field
from importlib import import_module
from itertools import islice
from pathlib import Path

from aerial_gym.errors import ConfigError
from aerial_gym.fleet.alerts import new_alerts
from aerial_gym.fleet.engine import Engine
from aerial_gym.fleet.lock import writer_lock
from aerial_gym.fleet.moments import columns_digest
from aerial_gym.fleet.pass_one import LogRows, PassOneSettings, row_digest
from aerial_gym.fleet.pass_two import UNJUDGED, PassTwoSettings, judge_fleet
from aerial_gym.fleet.reports import write_reports
from aerial_gym.fleet.schemas import KEY
from aerial_gym.fleet.sources import LogReference, LogStore
from aerial_gym.fleet.tables import FleetTables, Row
from aerial_gym.fleet.vehicles import Fleet, content_hash
from aerial_gym.sim2real.logs.readers.mapping import find_mapping
from aerial_gym.sim2real.progress import Progress

FILE_STATE = ("path", "size", "modified")  # Columns that tell a log without reading it
BATCH = 16  # Logs of one batch, which share launches
COMMIT_FLIGHTS, COMMIT_S = 512, 60.0  # Rows are committed after so many flights or seconds, whichever comes first


@dataclass(kw_only=True)
class FleetSummary:
    """Result of a run."""

    new: int = 0  # Flights with new rows
    known: int = 0  # Logs with rows of an earlier run
    copies: int = 0  # Logs whose content has rows under another path, or an earlier state
    refused: Counter[str] = field(default_factory=Counter)  # New refusals by reason
    unread: dict[str, str] = field(default_factory=dict)  # Reason by log that its store did not deliver
    vehicles: int = 0
    judged: int = 0  # Vehicles with enough flights
    changed: list[str] = field(default_factory=list)  # A sentence for each vehicle that has changed
    alerts: "list[Row]" = field(default_factory=list)  # That this run has raised
    reports: dict[str, str] = field(default_factory=dict)  # What ``close-loop`` says of changed vehicles
    cohorts: "Sequence[Row]" = field(default_factory=list)  # Differences between firmware versions


class FlightWriter:
    """Writer of pass 1: one commit for many flights, and no flight twice."""

    def __init__(self, tables: FleetTables, fleet: Fleet, model_version: str) -> None:
        """Read the keys of written flights, 32 bytes each, and delete rows of an interrupted commit."""
        self._tables, self._fleet, self._version = tables, fleet, model_version
        self._waiting, self._since = list[LogRows](), time.monotonic()
        self.keys, self._files, self.summary = set[bytes](), set[bytes](), FleetSummary()
        tables.discard_incomplete()
        for row in tables.rows("flights", (*KEY, "path", "size", "modified", "airframe"), model_version=model_version):
            self._remember(row)

    def _remember(self, row: "Row") -> None:
        self.keys.add(row_digest(row))
        robot = self._fleet.assign(row["path"], row["airframe"])[1]
        if self._fleet.hashes.get(robot, "") == row["robot_hash"]:
            self._files.add(row_digest(row, FILE_STATE))

    def is_known(self, log: LogReference) -> bool:
        """Return whether the rows of a log are written, without reading the log."""
        return row_digest(vars(log), FILE_STATE) in self._files

    def add(self, rows: Iterable[LogRows]) -> None:
        """Take rows of logs; write all that wait if they are many or old."""
        self._waiting += rows
        if len(self._waiting) >= COMMIT_FLIGHTS or time.monotonic() - self._since > COMMIT_S:
            self.commit()

    def commit(self) -> None:
        """Write the rows that wait; ``flights`` last, as its rows mark what is done.

        An interrupted commit is not repeated: the next run discards its evidence, and reads those logs again.
        """
        new, waiting = list[LogRows](), self._waiting
        self._waiting, self._since = [], time.monotonic()
        for rows in waiting:
            if rows.unread:
                self.summary.unread[rows.flight["path"]] = rows.unread
            elif row_digest(rows.flight) in self.keys:
                self.summary.copies += 1
                self._remember(rows.flight)
            else:
                self._remember(rows.flight)
                new.append(rows)
        self._tables.add_columns({columns_digest(rows.columns): rows.columns for rows in new if rows.columns})
        self._tables.append("evidence", [row for rows in new for row in rows.evidence])
        self._tables.append("flights", [rows.flight for rows in new])
        self.summary.new += len(new)
        self.summary.refused.update(rows.flight["reason"] for rows in new if rows.flight["status"] == "refused")


@dataclass(frozen=True, kw_only=True)
class FleetRun:
    """Request of a run."""

    logs: LogStore
    fleet: Fleet
    out: Path
    mapping: str | None = None
    pass_one: str = PassOneSettings.module
    verdicts: PassTwoSettings = field(default_factory=PassTwoSettings)
    reports: int = 0  # Most vehicles whose change ``close-loop`` checks

    def settings(self) -> dict[str, object]:
        """Return the settings that rows of flights depend on beside their keys, a mapping by its content."""
        mapping = self.mapping and f"content {content_hash(find_mapping(self.mapping))[:12]}"
        return {"mapping": mapping, "rules": repr(self.fleet.rules.rules)}


def run_fleet(run: FleetRun, engine: Engine, report: Progress) -> FleetSummary:
    """Bring the tables up to date with the logs; return what has changed."""
    total = sum(1 for _ in run.logs.logs())
    if not total:
        raise ConfigError(f"--logs {run.logs.url}: holds no log whose name matches {run.logs.pattern!r}")
    with writer_lock(run.out):
        tables = FleetTables.create(run.out, run.settings())
        version = import_module(run.pass_one).model_version()
        writer = FlightWriter(tables, run.fleet, version)
        _run_pass_one(run, writer, engine, _FlightProgress(total, writer.summary, report))
        summary = writer.summary
        if summary.new:
            report("joining small files", 1.0)
            tables.compact()
        verdicts = judge_fleet(tables, run.fleet.hashes.values(), version, engine, run.verdicts, report)
        summary.vehicles, summary.changed = len(verdicts), [one["text"] for one in verdicts if one["rejected"]]
        summary.judged = sum(one["verdict"] not in UNJUDGED for one in verdicts)
        summary.alerts = new_alerts(tables, run.fleet.hashes.values(), version)
        tables.append("alerts", summary.alerts)
        summary.cohorts = tables.cohorts()
        summary.reports = write_reports(
            tables, run.fleet, run.logs, verdicts, engine, most=run.reports, mapping=run.mapping, report=report
        )
    return summary


def _run_pass_one(run: FleetRun, writer: FlightWriter, engine: Engine, progress: "_FlightProgress") -> None:
    batches = batches_of_logs(_new_logs(run.logs, writer))
    try:
        for rows in engine(batches, pass_one_settings(run, frozenset(writer.keys)).make_worker):
            writer.add(rows)
            progress.add(rows)
    finally:
        writer.commit()


def pass_one_settings(run: FleetRun, known: AbstractSet[bytes]) -> PassOneSettings:
    """Return the inputs of the workers of a run; an empty folder receives logs that they fetch."""
    scratch = run.out / "fetched"
    shutil.rmtree(scratch, ignore_errors=True)  # what a killed run has left
    scratch.mkdir()
    return PassOneSettings(
        store=run.logs, fleet=run.fleet, module=run.pass_one, mapping=run.mapping, scratch=scratch, known=known
    )


def _new_logs(store: LogStore, writer: FlightWriter) -> Iterator[LogReference]:
    for log in store.logs():
        if writer.is_known(log):
            writer.summary.known += 1
        else:
            yield log


def batches_of_logs(logs: Iterator[LogReference]) -> Iterator[list[LogReference]]:
    """Yield logs in batches that share launches."""
    while batch := list(islice(logs, BATCH)):
        yield batch


class _FlightProgress:
    """Progress of pass 1: logs done, rate and refusals."""

    def __init__(self, total: int, summary: FleetSummary, report: Progress) -> None:
        self._total, self._summary, self._report = total, summary, report
        self._done = self._refused = 0
        self._start = time.monotonic()

    def add(self, rows: Iterable[LogRows]) -> None:
        for row in rows:
            self._done += 1
            self._refused += bool(row.unread) or row.flight["status"] == "refused"
        done, rate = self._done + self._summary.known, self._done / max(time.monotonic() - self._start, 1e-3)
        self._report(f"flights {done}/{self._total}, {rate:.1f}/s, {self._refused} refused", done / self._total)
