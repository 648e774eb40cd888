"""Runs of a small fleet with the cheap passes of ``fake_passes``."""

import sys
from pathlib import Path
from typing import Any

from aerial_gym.fleet.engine import Engine, ray_engine, run_serially
from aerial_gym.fleet.pass_two import PassTwoSettings
from aerial_gym.fleet.run import FleetRun, FleetSummary, run_fleet
from aerial_gym.fleet.sources import LogStore
from aerial_gym.fleet.vehicles import Fleet, VehicleRules, content_hash
from aerial_gym.robots.catalog import robot_by_name

FAKE = "tests.unit.fleet.fake_passes"


def small_fleet(rules: VehicleRules | None = None) -> Fleet:
    robot = robot_by_name("base_quadrotor")
    return Fleet(robots={"quad": robot}, hashes={"quad": content_hash(robot)}, rules=rules or VehicleRules())


def request(logs: Path | str, out: Path, **changes: Any) -> FleetRun:
    verdicts = PassTwoSettings(module=FAKE, wording=FAKE)
    settings = {"fleet": small_fleet(), "pass_one": FAKE, "verdicts": verdicts} | changes
    return FleetRun(logs=LogStore(url=str(logs)), out=out, **settings)


def run(logs: Path | str, out: Path, engine: Engine = run_serially, **changes: Any) -> FleetSummary:
    return run_fleet(request(logs, out, **changes), engine, lambda stage, share: None)


def main() -> None:
    """Run a fleet by Ray: ``python -m tests.unit.fleet.runs LOGS OUT``."""
    logs, out = sys.argv[1:]
    with ray_engine(2) as engine:
        run(logs, Path(out), engine)


if __name__ == "__main__":
    main()
