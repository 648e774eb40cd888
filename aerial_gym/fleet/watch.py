"""``fleet watch``: new logs of a store as they are completed, and the verdicts of their vehicles.

A log is complete when its size and state stay the same from one look at the store to the next.
"""

from collections.abc import Generator
from functools import partial

from aerial_gym.fleet.alerts import add_alerts
from aerial_gym.fleet.engine import run_serially
from aerial_gym.fleet.lock import writer_lock
from aerial_gym.fleet.pass_two import judge_fleet
from aerial_gym.fleet.run import FleetRun, FlightWriter, batches_of_logs, pass_one_settings
from aerial_gym.fleet.tables import FleetTables, Row


def watch_fleet(run: FleetRun) -> Generator[list[Row], None, None]:
    """Yield the alerts of each look at the store; between looks, the caller waits. Close the generator to stop."""
    with writer_lock(run.out):
        tables = FleetTables.create(run.out, run.settings())
        settings, seen = pass_one_settings(run), dict[str, tuple[int, str]]()
        worker = settings.make_worker()
        writer = FlightWriter(tables, run.fleet, worker.version)
        judge = partial(judge_fleet, tables, run.fleet.hashes.values(), worker.version, run_serially, run.verdicts)
        try:
            while True:
                logs = [log for log in run.logs.logs() if not writer.is_known(log)]
                complete = [log for log in logs if seen.get(log.path) == (log.size, log.modified)]
                seen = {log.path: (log.size, log.modified) for log in logs}
                vehicles = set[str]()
                for batch in batches_of_logs(iter(complete)):
                    rows = worker(batch)
                    writer.add(rows)
                    vehicles |= {one.flight["vehicle"] for one in rows if one.flight.get("status") == "ok"}
                writer.commit()
                yield add_alerts(tables, judge(only=vehicles)) if vehicles else []
        finally:
            tables.compact()
