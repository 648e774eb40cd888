"""Reports of changed vehicles: ``close-loop`` on their last flights.

Moments of flights are linear about the robot file, which makes them sums. ``close-loop`` fits without that limit, tests on
flights that no fit used, and says what remains. So it confirms a cause, or does not, and states its size.
"""

import json
import shutil
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from aerial_gym.config import dump_yaml
from aerial_gym.config.storage import write_atomic
from aerial_gym.errors import AerialGymError
from aerial_gym.fleet.engine import Engine
from aerial_gym.fleet.report_folder import report_folder
from aerial_gym.fleet.sources import ORDER, LogReference, LogStore, sort_by_time
from aerial_gym.fleet.tables import FleetTables, Row
from aerial_gym.fleet.vehicles import Fleet
from aerial_gym.sim2real.progress import Progress

MOST_FLIGHTS = 7  # Flights of a report: four to train on, and three to test on between them
FEWEST_FLIGHTS = 2


@dataclass(frozen=True, kw_only=True)
class ReportRequest:
    """Flights of a vehicle that ``close-loop`` compares."""

    vehicle: str
    first: int  # Number of the first flight, from 1
    last: int
    logs: tuple[LogReference, ...]
    robot: str  # Name of the robot file
    key: tuple[str, ...]  # Robot, model version and logs by their hashes


def write_reports(
    tables: FleetTables, fleet: Fleet, store: LogStore, verdicts: Sequence[Row], engine: Engine, *,
    most: int, mapping: str | None, report: Progress,
) -> dict[str, str]:  # fmt: skip
    """Write the reports of changed vehicles that lack one, those with the most evidence first.

    Args:
        most: Largest number of vehicles.

    Returns:
        A sentence for each of these vehicles.
    """
    changed = sorted((one for one in verdicts if one["rejected"]), key=lambda one: -one["log_e"])[:most]
    asked = [request for one in changed if (request := _request(tables, fleet, one)) is not None]
    settings = ReportWriter(out=tables.out, fleet=fleet, store=store, mapping=mapping)
    sentences = dict[str, str]()
    for request, sentence in zip(asked, engine(asked, settings.make_worker), strict=True):
        sentences[request.vehicle] = sentence
        report(f"reports {len(sentences)}/{len(asked)}", len(sentences) / len(asked))
    return sentences


def _request(tables: FleetTables, fleet: Fleet, verdict: Row) -> ReportRequest | None:
    """Return the last flights of a vehicle behind the onset of its change; None if they are too few."""
    names = ("log_hash", "airframe", "size", "modified", *ORDER)
    key = {name: verdict[name] for name in ("robot_hash", "model_version")}
    rows = sort_by_time(tables.rows("flights", names, vehicle=verdict["vehicle"], status="ok", **key))
    first = max(verdict["onset_high"], len(rows) - MOST_FLIGHTS + 1)
    used = [row for row in rows[first - 1 :] if row["log_hash"] not in verdict["odd_logs"]]
    if len(used) < FEWEST_FLIGHTS:
        return None
    logs = tuple(
        LogReference(rank=rank, **{name: row[name] for name in ("path", "size", "modified")})
        for rank, row in enumerate(used)
    )
    robot = fleet.assign(used[-1]["path"], used[-1]["airframe"])[1]
    hashes = tuple(row["log_hash"] for row in used)
    return ReportRequest(
        vehicle=verdict["vehicle"], first=first, last=len(rows), logs=logs, robot=robot, key=(*key.values(), *hashes)
    )


@dataclass(frozen=True, kw_only=True)
class ReportWriter:
    """Worker that writes reports."""

    out: Path
    fleet: Fleet
    store: LogStore
    mapping: str | None

    def make_worker(self) -> Callable[[ReportRequest], str]:
        """Return the worker."""
        return self.write

    def write(self, request: ReportRequest) -> str:
        """Write the report of a vehicle unless it exists, and return what it says."""
        folder = report_folder(self.out, request.vehicle)
        mark = folder / "flights.json"
        if not mark.is_file() or json.loads(mark.read_text(encoding="utf-8")) != list(request.key):
            shutil.rmtree(folder, ignore_errors=True)
            try:
                self._compare(request, folder)
            except (AerialGymError, OSError) as error:  # a store may have lost a log since
                return f"no report: {error}"
            write_atomic(mark, json.dumps(request.key))
        return f"flights {request.first} to {request.last}: {sentence_of_report(folder)}"

    def _compare(self, request: ReportRequest, folder: Path) -> None:
        from aerial_gym.sim2real.loop import close_loop

        folder.parent.mkdir(parents=True, exist_ok=True)
        with TemporaryDirectory(dir=self.out / "fetched", prefix="aerial_gym_report_") as scratch:
            robot = Path(scratch) / "robot.yaml"
            robot.write_text(dump_yaml(self.fleet.robots[request.robot]), encoding="utf-8")
            logs = [self.store.fetch(log, Path(scratch)) for log in request.logs]
            close_loop(robot, logs[::2], logs[1::2], folder, mapping=self.mapping)


def sentence_of_report(folder: Path) -> str:
    """Return the verdict of a report with its reason, in one line."""
    verdict: Mapping[str, Any] = json.loads((folder / "verdict.json").read_text(encoding="utf-8"))
    return f"{verdict['verdict']}. {verdict['reason']}"
