"""``aerial-gym fleet run``, ``fleet view``, ``fleet query`` and ``fleet watch``: the measured-data loop over many logs."""

import sys
import time
from collections.abc import Sequence
from contextlib import closing, nullcontext
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import tyro

from aerial_gym.cli.terminal import print_table, progress_bar
from aerial_gym.config.console import json_line, one_line
from aerial_gym.errors import ConfigError
from aerial_gym.extras import require
from aerial_gym.sim2real.json_values import finite_or_none, map_leaves

if TYPE_CHECKING:
    from aerial_gym.fleet.run import FleetRun, FleetSummary
    from aerial_gym.fleet.tables import Row

Limits = Annotated[tuple[str, ...], tyro.conf.UseAppendAction]
Tables = Annotated[Path, tyro.conf.arg(aliases=["--tables"])]


@dataclass(frozen=True, kw_only=True)
class FleetLogsCmd:
    """Base of the commands that read logs."""

    robots: Path  # Robot file (.yaml), or a folder of them, each named after its vehicle, airframe id or folder of logs
    rules: Path | None = None  # Rules (.yaml) that map logs to vehicles and robot files; docs/guides/fleet.md
    mapping: str | None = None  # Mapping of CSV files: a name or a file (.yaml)
    pattern: str = "*"  # Names of logs, such as *.ulg
    false_discovery: float = 0.01  # Largest expected share of unchanged vehicles among those that are named
    limit: Limits = ()  # EFFECT.PARAMETER=VALUE: say when a drift crosses it
    json: bool = False  # Print JSON in place of sentences

    def request(self, logs: str, out: Path) -> "FleetRun":
        """Return the request of a run; raise ``ConfigError`` with every fault."""
        from aerial_gym.fleet.pass_two import PassTwoSettings
        from aerial_gym.fleet.run import FleetRun
        from aerial_gym.fleet.sources import LogStore
        from aerial_gym.fleet.vehicles import load_fleet, try_read
        from aerial_gym.physics import EFFECTS

        faults, limits, store = list[str](), dict[str, float](), LogStore(url=logs, pattern=self.pattern)
        for text in self.limit:
            name, _, value = text.partition("=")
            try:
                limits[name] = float(value)
            except ValueError:
                faults.append(f"--limit {text}: give EFFECT.PARAMETER=VALUE, such as weak_motor.scale=0.9")
                continue
            effect, _, _parameter = name.partition(".")
            known = [f"{effect}.{one.name}" for one in EFFECTS.get(effect).parameters] if effect in EFFECTS else []
            if name not in known:
                faults.append(f"--limit {text}: no such parameter. Known: {', '.join(known or EFFECTS)}")
        if not 0.0 < self.false_discovery < 1.0:
            faults.append(f"--false-discovery {self.false_discovery:g}: must lie between 0 and 1")
        if store.is_folder(out):
            faults.append(f"--out {out}: is the folder of the logs; give another one for the tables")
        fleet = try_read(lambda: load_fleet(self.robots, self.rules), faults)
        try_read(store.check, faults)
        if faults or fleet is None:
            raise ConfigError(*faults)
        verdicts = PassTwoSettings(level=self.false_discovery, limits=limits)
        return FleetRun(logs=store, fleet=fleet, out=out, mapping=self.mapping, verdicts=verdicts)


@dataclass(frozen=True, kw_only=True)
class FleetRunCmd(FleetLogsCmd):
    """Analyse a store of logs: which vehicles have changed, in what, and since when. It continues after a stop."""

    logs: str  # Folder, or URL of an object store such as s3://bucket/logs
    out: Tables  # Folder of the tables
    workers: int | None = None  # Number of worker processes; all cores if not given
    reports: int = 10  # Most changed vehicles whose last flights close-loop compares for a report, the clearest first
    address: str | None = None  # Ray cluster to run on; the tables must then lie on storage that all its machines share

    def run(self) -> int:
        """Bring the tables up to date and print what has changed."""
        require("fleet run", "ray", "deltalake", "pyarrow", "fsspec")
        from aerial_gym.fleet.engine import ray_engine, run_serially
        from aerial_gym.fleet.run import run_fleet
        from aerial_gym.workloads.measure import require_at_least

        if self.workers is not None:
            require_at_least(1, workers=self.workers)
        require_at_least(0, reports=self.reports)
        request = replace(self.request(self.logs, self.out), reports=self.reports)
        if self.address:
            print(f"--address {self.address}: whoever can reach this Ray cluster can run code on it", file=sys.stderr)
        in_memory = self.logs.startswith("memory://")  # of this process alone
        started = nullcontext(run_serially) if in_memory else ray_engine(self.workers, self.address)
        with started as engine, progress_bar() as progress:
            summary = run_fleet(request, engine, progress)
        print_summary(summary, self.out, as_json=self.json)
        return 0


@dataclass(frozen=True, kw_only=True)
class FleetWatchCmd(FleetLogsCmd):
    """Analyse new logs of a folder as they are completed, and report each vehicle that changes, once."""

    folder: Annotated[str, tyro.conf.Positional]  # Folder, or URL of an object store
    out: Tables  # Folder of the tables; they are made if they do not exist
    poll_s: float = 2.0  # Time between two looks at the folder [s]; a log that stays the same for so long is complete
    webhook: str | None = None  # URL that receives each alert as JSON by POST
    allow_remote_webhook: bool = False  # Allow a webhook on another machine

    def run(self) -> int:
        """Print each alert until interrupted; one that has not arrived everywhere comes again after a new start."""
        require("fleet watch", "deltalake", "pyarrow", "fsspec")
        from aerial_gym.fleet.alerts import Webhook
        from aerial_gym.fleet.watch import watch_fleet

        webhook = Webhook(self.webhook, allow_remote=self.allow_remote_webhook) if self.webhook else None
        printed = set[str]()

        def deliver(alerts: "Sequence[Row]") -> "Sequence[Row]":
            for alert in alerts:
                if alert["id"] not in printed:
                    print(json_line(alert) if self.json else alert["text"], flush=True)
                    printed.add(alert["id"])
            return webhook.send(alerts) if webhook else alerts

        tell = partial(print, "fleet watch:", file=sys.stderr, flush=True)
        with closing(watch_fleet(self.request(self.folder, self.out), deliver, tell)) as looks:
            try:
                for _ in looks:
                    time.sleep(self.poll_s)
            except KeyboardInterrupt:
                tell("stopped")
        return 0


@dataclass(frozen=True, kw_only=True)
class FleetQueryCmd:
    """Query the tables of a fleet by SQL: flights, evidence, vehicles, verdicts, alerts."""

    sql: Annotated[str, tyro.conf.Positional]  # One SELECT, WITH or DESCRIBE
    out: Tables  # Folder of the tables
    json: bool = False  # Print one JSON object a line in place of a table

    def run(self) -> int:
        """Print the rows."""
        require("fleet query", "duckdb", "deltalake", "pyarrow")
        from aerial_gym.fleet.query import query

        names, rows = query(self.out, self.sql)
        if not self.json:
            print_table((tuple(one_line(str(value)) for value in row) for row in rows), names)
        for row in rows if self.json else ():
            print(json_line(map_leaves(dict(zip(names, row, strict=True)), _json_value)))
        return 0


@dataclass(frozen=True, kw_only=True)
class FleetViewCmd:
    """Show the tables of a fleet in the browser, on this machine alone."""

    out: Tables  # Folder of the tables
    port: int = 8080  # Port on 127.0.0.1; 0 takes a free one
    open: bool = False  # Open the page in the browser

    def run(self) -> int:
        """Serve the page until interrupted."""
        require("fleet view", "duckdb", "deltalake", "pyarrow", "jinja2")
        from aerial_gym.fleet.page import serve

        serve(self.out, self.port, self.open)
        return 0


def _json_value(value: object) -> object:
    """Return a value of a table as JSON: numbers that are not finite as null, bytes in hexadecimal, others as text."""
    if isinstance(value, bytes):
        return value.hex()
    return finite_or_none(value) if isinstance(value, int | float | str | None) else str(value)


def print_summary(summary: "FleetSummary", out: Path, *, as_json: bool) -> None:
    """Print the result of a run: changed vehicles first."""
    from aerial_gym.fleet.wording import texts_of_differences

    if as_json:
        print(json_line(vars(summary)))
        return
    unchanged = "no vehicle has changed" if summary.judged else "no vehicle can be judged by its flights"
    for text in summary.changed or [unchanged]:
        print(text)
    for vehicle, text in summary.reports.items():
        print(f"close-loop on vehicle {vehicle}, {text}")
    for text in texts_of_differences(summary.cohorts):
        print(text)
    word = "vehicle" if summary.vehicles == 1 else "vehicles"
    counts = f"{summary.vehicles} {word} with usable flights; logs: {summary.new} new, {summary.known} known"
    refused, unread = sum(summary.refused.values()), len(summary.unread)
    parts = [(refused, "refused"), (summary.copies, "with known content"), (unread, "not delivered by the store")]
    print(", ".join([counts, *(f"{count} {state}" for count, state in parts if count)]))
    for reason, count in summary.refused.most_common(3):
        print(f"  refused {count}: {reason}")
    if hidden := summary.refused.most_common()[3:]:
        print(f"  refused {sum(count for _, count in hidden)} for other reasons: column reason of table flights")
    for path, reason in list(summary.unread.items())[:3]:
        print(one_line(f"  not delivered, tried again by the next run: {path} ({reason})"))
    print(f"next: aerial-gym fleet view --tables {out}")
