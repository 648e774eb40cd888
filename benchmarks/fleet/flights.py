"""Logs of a fleet whose vehicles are healthy but for a few, in which one cause begins or grows.

``python -m benchmarks.fleet.flights --out DIR --vehicles 500 --flights 20``: one folder per vehicle, ``robot.yaml`` for all of
them, and ``truth.json`` with what is hidden. Every vehicle has small errors of its own (``TRACKED``), every flight its own
light wind, charge and trajectory. A run that was interrupted continues. Shares no code with the package.
"""

import json
from concurrent.futures import ProcessPoolExecutor, as_completed
from dataclasses import asdict, dataclass, replace
from pathlib import Path

import numpy as np
import tyro
from rich.console import Console
from rich.progress import track

from benchmarks.undeclared.cases import SETTLE_S, PlantFlight, plan_flights
from benchmarks.undeclared.effects import effect_parameters, split_vehicles
from benchmarks.undeclared.loggers import LOGGERS, disturb_record, write_rows, write_ulog
from benchmarks.undeclared.logs import write_robot
from benchmarks.undeclared.sensors import TRACKED, PlantNoise, PlantSensors, add_nuisance
from benchmarks.undeclared.simulate import CONTROL_RATE, fly_references
from benchmarks.undeclared.surroundings import VOLTAGE_NOISE, Battery, PlantSurroundings
from benchmarks.undeclared.vehicle import DECLARED

CAUSES = ("weak_motor", "thrust_coefficient", "com_offset", "imu_misalignment", "motor_time_constant")
"""Hidden causes: a worn propeller, worn propellers, a battery that moved, a loose autopilot, worn bearings."""

WORK = (
    "waypoints",
    "figure_eight",
    "square",
    "lissajous",
    "vertical",
)  # Families of trajectories, drawn for each flight
WIND = 0.7  # Steady wind of a flight, standard deviation along x and y [m/s]
NUMBERS = ("motor",)  # Parameters that a drift does not change


@dataclass(frozen=True, kw_only=True)
class FleetCmd:
    """Write the logs of a fleet."""

    out: Path  # Folder of the fleet
    vehicles: int = 500  # Number of vehicles
    flights: int = 20  # Flights of each vehicle
    duration_s: float = 20.0  # Length of each log [s]
    changed: float = 0.02  # Share of vehicles with a cause
    size: str = "moderate"  # Final size of each cause
    logger: str = "gps"  # How the flights are recorded
    seed: int = 40000  # Of everything
    workers: int = 2  # Number of processes

    def run(self) -> int:
        """Fly the vehicles whose folders are not complete; return the exit status."""
        if unknown := {self.logger} - set(LOGGERS):
            raise SystemExit(f"--logger {unknown.pop()}: take one of {', '.join(LOGGERS)}")
        plans = plan_fleet(self)
        self.out.mkdir(parents=True, exist_ok=True)
        write_robot(self.out / "robot.yaml", DECLARED)
        hidden = {plan.name: asdict(plan) for plan in plans if plan.cause}
        (self.out / "truth.json").write_text(json.dumps({"seed": self.seed, "changed": hidden}, indent=1) + "\n")
        left = [plan for plan in plans if not (self.out / plan.name).is_dir()]
        with ProcessPoolExecutor(self.workers) as pool:
            jobs = [pool.submit(fly_vehicle, plan, self) for plan in left]
            for job in track(as_completed(jobs), total=len(jobs), description="vehicles", console=Console(stderr=True)):
                job.result()
        return 0


@dataclass(frozen=True, kw_only=True)
class VehiclePlan:
    """What happens to one vehicle."""

    name: str
    seed: int
    cause: str = ""  # Empty: healthy
    kind: str = ""  # ``step`` or ``drift``
    onset: int = 0  # Flight from which it acts, from 1 on


def plan_fleet(fleet: FleetCmd) -> list[VehiclePlan]:
    """Return the plans: changed vehicles at random, causes and kinds in turn, onsets in the middle half of the flights."""
    rng, plans = np.random.default_rng([fleet.seed, 70]), []
    changed = rng.permutation(fleet.vehicles)[: round(fleet.changed * fleet.vehicles)]
    turn = {int(vehicle): place for place, vehicle in enumerate(sorted(changed))}
    for vehicle in range(fleet.vehicles):
        plan = VehiclePlan(name=f"vehicle_{vehicle + 1:05d}", seed=fleet.seed + vehicle)
        onset = int(rng.integers(fleet.flights // 4, 3 * fleet.flights // 4)) + 1
        if vehicle in turn:
            place = turn[vehicle]
            kind = ("step", "drift")[place // len(CAUSES) % 2]
            plan = replace(plan, cause=CAUSES[place % len(CAUSES)], kind=kind, onset=onset)
        plans.append(plan)
    return plans


def share_of_cause(plan: VehiclePlan, flight: int, count: int) -> float:
    """Return the share of the final size that acts in a flight, from 1 on: a drift grows linearly to the last one."""
    if not plan.cause or flight < plan.onset:
        return 0.0
    return 1.0 if plan.kind == "step" else (flight - plan.onset + 1) / (count - plan.onset + 1)


def fly_vehicle(plan: VehiclePlan, fleet: FleetCmd) -> None:
    """Write the logs of one vehicle, all at once at the end."""
    shares = [share_of_cause(plan, number + 1, fleet.flights) for number in range(fleet.flights)]
    folder = fleet.out / f".{plan.name}.part"
    folder.mkdir(exist_ok=True)
    for share in sorted(set(shares)):
        _fly_alike(plan, fleet, [k for k, own in enumerate(shares) if own == share], share, folder)
    folder.rename(fleet.out / plan.name)


def _fly_alike(plan: VehiclePlan, fleet: FleetCmd, numbers: list[int], share: float, folder: Path) -> None:
    """Write the logs of flights of the same true vehicle."""
    seed, params = plan.seed, parameters_of_cause(plan, fleet.size, share)
    declared, true = split_vehicles(DECLARED, params)
    true, bias = add_nuisance(true, TRACKED, seed=seed, hidden=params, num_flights=fleet.flights)
    bias = replace(bias, acc=bias.acc[numbers])
    streams = [[np.random.default_rng([seed, kind, k]) for k in numbers] for kind in (80, 81, 82, 83)]
    families = [str(rng.choice(WORK)) for rng in streams[0]]
    flights = [PlantFlight(f"flight_{k + 1:04d}", family, (3, k)) for k, family in zip(numbers, families, strict=True)]
    reference = plan_flights(flights, seed=seed, duration_s=fleet.duration_s)
    samples = len(reference.yaw)
    wind = np.array([[*(WIND * rng.standard_normal(2)), 0.0] for rng in streams[1]])
    around = PlantSurroundings(gust=np.broadcast_to(wind, (samples, *wind.shape)), rate=CONTROL_RATE)
    battery = Battery(true, np.array([rng.uniform(0.0, 1500.0) for rng in streams[2]]))
    noise = [np.random.default_rng([seed, 84, k]) for k in numbers]
    sensors = PlantSensors(PlantNoise(), bias, noise, samples, extra=true.extra)
    record = fly_references(
        true=true, declared=declared, reference=reference, sensors=sensors, surroundings=around, battery=battery
    )
    voltage = np.stack([rng.standard_normal(samples) for rng in streams[3]], axis=1)
    record = replace(record, voltage=record.voltage + VOLTAGE_NOISE * voltage)
    kind, first = LOGGERS[fleet.logger], round(SETTLE_S * CONTROL_RATE)
    record = disturb_record(record, kind, seed + 7919 * numbers[0])
    for place, flight in enumerate(flights):
        path = folder / f"{flight.name}.{kind.file}"
        if kind.file == "ulg":
            write_ulog(path, record, place, slice(first, None), kind, declared.speed_range()[1])
        else:
            write_rows(path, record, place, slice(first, None, round(CONTROL_RATE / kind.row_rate)), kind, seed)


def parameters_of_cause(plan: VehiclePlan, size: str, share: float) -> dict[str, dict[str, float]]:
    """Return the hidden parameters at a share of the way from neutral; empty for none."""
    if not share:
        return {}
    final = effect_parameters({plan.cause: size}, declared=DECLARED, seed=plan.seed)[plan.cause]
    lag = 0.5 * (DECLARED.tau_up + DECLARED.tau_down)
    neutral = {"scale": 1.0, "tau": lag}
    moved = {
        name: value if name in NUMBERS else neutral.get(name, 0.0) + share * (value - neutral.get(name, 0.0))
        for name, value in final.items()
    }
    return {plan.cause: moved}


if __name__ == "__main__":
    raise SystemExit(tyro.cli(FleetCmd, description=__doc__).run())
