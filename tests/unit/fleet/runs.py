"""Runs of a small fleet with the cheap passes of ``stand_in``."""

from pathlib import Path
from typing import Any

from aerial_gym.fleet.engine import Engine, run_serially
from aerial_gym.fleet.pass_two import PassTwoSettings
from aerial_gym.fleet.run import FleetRun, FleetSummary, run_fleet
from aerial_gym.fleet.sources import LogStore
from aerial_gym.fleet.tables import FleetTables
from aerial_gym.fleet.vehicles import Fleet, VehicleRules, robot_hash
from aerial_gym.robots.catalog import robot_by_name

STAND_IN = "tests.unit.fleet.stand_in"


def small_fleet(rules: VehicleRules | None = None) -> Fleet:
    robot = robot_by_name("base_quadrotor")
    return Fleet(robots={"quad": robot}, hashes={"quad": robot_hash(robot)}, rules=rules or VehicleRules())


def request(logs: Path | str, out: Path, **changes: Any) -> FleetRun:
    verdicts = PassTwoSettings(module=STAND_IN, wording=STAND_IN)
    settings = {"fleet": small_fleet(), "pass_one": STAND_IN, "verdicts": verdicts} | changes
    return FleetRun(logs=LogStore(url=str(logs)), out=out, **settings)


def run(logs: Path | str, out: Path, engine: Engine = run_serially, **changes: Any) -> FleetSummary:
    return run_fleet(request(logs, out, **changes), engine, lambda stage, share: None)


def contents(out: Path) -> dict[str, list[tuple[Any, ...]]]:
    """Return the rows of all tables as sorted texts, without ``written_at``."""
    tables = FleetTables(out)
    return {
        name: sorted(
            repr({key: value for key, value in row.items() if key != "written_at"})
            for row in tables.dataset(name).to_table().to_pylist()
        )
        for name in ("flights", "evidence", "vehicles", "verdicts", "alerts")
    }
