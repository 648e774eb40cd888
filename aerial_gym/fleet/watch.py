"""``fleet watch``: new logs of a store as they are completed, and the verdicts of their vehicles.

A log is complete when its size and state stay the same from one look at the store to the next.
"""

from collections.abc import Callable, Generator, Sequence
from importlib import import_module

from aerial_gym.fleet.alerts import new_alerts
from aerial_gym.fleet.engine import run_serially
from aerial_gym.fleet.lock import writer_lock
from aerial_gym.fleet.pass_two import judge_fleet, vehicles_to_judge
from aerial_gym.fleet.run import BATCH, FleetRun, FlightWriter, batches_of_logs, pass_one_settings
from aerial_gym.fleet.tables import FleetTables, Row

MOST_FILES = 64  # Of a table, before they are joined
Deliver = Callable[[Sequence[Row]], Sequence[Row]]  # Takes alerts; returns those that have arrived


def watch_fleet(run: FleetRun, deliver: Deliver, tell: Callable[[str], None]) -> Generator[None]:
    """Look at the store once for each step; between looks, the caller waits.

    What an interrupted watch or run has not judged or delivered is made up for. ``tell`` takes sentences on the progress.
    """
    with writer_lock(run.out):
        tables = FleetTables.create(run.out, run.settings())
        version, seen = import_module(run.pass_one).model_version(), dict[str, tuple[int, str]]()
        writer = FlightWriter(tables, run.fleet, version)
        worker, robots = pass_one_settings(run, writer.keys).make_worker(), run.fleet.hashes.values()
        vehicles, alerts = vehicles_to_judge(tables, robots, version), None
        known, judged = (tables.dataset(name).count_rows() for name in ("flights", "verdicts"))
        tell(f"watching {run.logs.url}; known from {run.out}: {known} logs, verdicts of {judged} vehicles")
        while True:
            logs = [log for log in run.logs.logs() if not writer.is_known(log)]
            complete = [log for log in logs if seen.get(log.path) == (log.size, log.modified)]
            seen = {log.path: (log.size, log.modified) for log in logs}
            for number, batch in enumerate(batches_of_logs(iter(complete))):
                tell(f"reading logs {number * BATCH + 1} to {number * BATCH + len(batch)} of {len(complete)}")
                rows = worker(batch)
                writer.add(rows)
                vehicles |= {one.flight["vehicle"] for one in rows if one.flight.get("status") == "ok"}
            writer.commit()
            if vehicles:
                tell(f"judging {len(vehicles)} vehicles")
                judge_fleet(tables, robots, version, run_serially, run.verdicts, only=vehicles)
            if vehicles or alerts is None:
                alerts = new_alerts(tables, robots, version)
            if complete:
                tables.compact(MOST_FILES)
            vehicles, arrived = set[str](), deliver(alerts)
            tables.append("alerts", arrived)
            alerts = [alert for alert in alerts if alert not in arrived]
            yield
