"""Flights of two vehicles above each other, each with its own log, and what is hidden in them.

The lower vehicle flies a reference of ``trajectories``; the other one flies it too, higher and back and forth. They take turns
from flight to flight. Each vehicle has small errors and noise of its own. Both are flown twice, the second time each with the
place of the other one in the first: only the lower one feels a wake, so the second time is exact.
Letters: F flights, T samples.
"""

import json
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from benchmarks.undeclared.cases import SETTLE_S, PlantFlight, list_flights, plan_flights
from benchmarks.undeclared.effects import CAUSES, effect_parameters, split_vehicles
from benchmarks.undeclared.logs import delay_sensors, log_table, write_robot
from benchmarks.undeclared.plant_effect import Params
from benchmarks.undeclared.sensors import LOGGED, Bias, PlantNoise, PlantSensors, add_nuisance
from benchmarks.undeclared.simulate import CONTROL_RATE, PlantRecord, fly_references
from benchmarks.undeclared.surroundings import PlantSurroundings, gust_series
from benchmarks.undeclared.trajectories import Reference
from benchmarks.undeclared.vehicle import DECLARED, Array, PlantVehicle

HIDDEN: dict[str, tuple[str, ...]] = {
    "control": (),
    "downwash": ("downwash", "downwash/jet"),
    "downwash and ground effect": ("downwash",),
    "gusts on both": ("gusts",),
    "gusts on each": ("gusts",),
    "effect on one": ("payload_mass", "com_offset", "weak_motor", "thrust_coefficient", "quadratic_drag"),
    "clocks apart": ("downwash",),
}
"""Kinds of cases, each with the effects that take turns in it."""

NUM_TRAIN, NUM_TEST = 4, 3  # Flights of both vehicles
LOW = (("low_passes", 0.2), ("low_hover", 0.15), ("waypoints", 0.3))  # Family and lowest height of single flights [m]
STRAY, STRAY_RATES = 0.5, (0.9, 1.3)  # Amplitude [m] and frequencies [rad/s] of the other vehicle beside the lower one
ABOVE = (0.8, 1.5)  # Height over the lower vehicle [m]
CLOCK_OFF = (0.15, 0.4)  # Undeclared offset of the second clock, either way [s]
PARTS = ("first", "second")


@dataclass(frozen=True, kw_only=True)
class PairFiles:
    """Files of a case."""

    train: tuple[Path, ...]
    test: tuple[Path, ...]
    pairs: tuple[tuple[Path, Path], ...]  # Logs of one flight
    robot: Path  # The declared robot, YAML
    truth: dict[str, object]


def make_pair_case(out: Path, kind: str, *, seed: int, duration_s: float = 16.0, rate_hz: int = 400) -> PairFiles:
    """Fly two vehicles with one hidden cause of a kind, drawn from the seed, and write their logs and the declared robot."""
    out.mkdir(parents=True, exist_ok=True)
    options, rng = HIDDEN[kind], np.random.default_rng([seed, 90])
    name = options[seed % len(options)] if options else ""
    params = effect_parameters({name: "moderate"} if name else {}, declared=DECLARED, seed=seed)
    low = effect_parameters({"ground_effect": "moderate"} if "ground" in kind else {}, declared=DECLARED, seed=seed)
    clock = rng.choice((-1.0, 1.0)) * rng.uniform(*CLOCK_OFF) if kind == "clocks apart" else 0.0
    flights = list_flights(NUM_TRAIN, NUM_TEST)
    lower = plan_flights(flights, seed=seed, duration_s=duration_s)
    references = references_of_pair(lower, seed)
    vehicles = [_vehicle(params | low if alike or v else {}, seed, v, len(flights)) for v, alike in _each(kind)]
    gusts = [
        _gusts(true, len(lower.yaw), flights, seed, v if kind == "gusts on each" else 0)
        for v, (true, _) in enumerate(vehicles)
    ]
    records = _fly_both(vehicles, references, gusts, seed)
    rows = slice(round(SETTLE_S * CONTROL_RATE), None, CONTROL_RATE // rate_hz)
    pairs = []
    for i, flight in enumerate(flights):
        pairs.append(tuple(out / f"{flight.name}_{part}.csv" for part in PARTS))
        for v, path in enumerate(pairs[-1]):
            _write(path, records[v], i, rows, clock * v)
    train = [path for pair in pairs[:NUM_TRAIN] for path in pair]
    test = [path for pair in pairs[NUM_TRAIN:] for path in pair]
    if low:
        singles = _fly_low(out, vehicles[0], seed, duration_s, rows)
        train, test = [*train[:4], *singles[:2]], [*test[:2], singles[2]]
        pairs = [pair for pair in pairs if pair[0] in (*train, *test)]
    write_robot(out / "robot.yaml", split_vehicles(DECLARED, params)[0], radius=bool(low))
    truth: dict[str, object] = {"kind": kind, "effects": params | low, "clock_s": clock, "seed": seed}
    (out / "truth.json").write_text(json.dumps(truth, indent=1) + "\n")
    return PairFiles(train=tuple(train), test=tuple(test), pairs=tuple(pairs), robot=out / "robot.yaml", truth=truth)


def _each(kind: str) -> list[tuple[int, bool]]:
    """Return each vehicle, and whether both have the hidden effect; else only the second one has."""
    return [(v, kind != "effect on one") for v in range(2)]


def _vehicle(params: dict[str, Params], seed: int, v: int, flights: int) -> tuple[PlantVehicle, Bias]:
    """Return a true vehicle with small errors of its own."""
    true = split_vehicles(DECLARED, params)[1]
    return add_nuisance(true, LOGGED, seed=2 * seed + v + 1_000_000, hidden=params, num_flights=flights)


def references_of_pair(lower: Reference, seed: int) -> tuple[Reference, Reference]:
    """Return the references of both vehicles: of the lower one as given, in turns of the first and the second vehicle."""
    upper, first = _upper_reference(lower, seed), np.arange(lower.yaw.shape[1]) % 2 == 0

    def choose(own: Reference, other: Reference) -> Reference:
        parts = {}
        for name, values in vars(own).items():
            shape = (1, -1, *(1,) * (values.ndim - 2))
            parts[name] = np.where(first.reshape(shape), values, getattr(other, name))
        return Reference(**parts)

    return choose(lower, upper), choose(upper, lower)


def _upper_reference(lower: Reference, seed: int) -> Reference:
    """Return the reference of a vehicle above the lower one, back and forth in a sine on each level axis."""
    count, flights = lower.yaw.shape
    rng, time = np.random.default_rng([seed, 91]), np.arange(count) / CONTROL_RATE
    phase, height = rng.uniform(0.0, 2.0 * np.pi, (flights, 2)), rng.uniform(*ABOVE, flights)
    parts = [np.zeros((count, flights, 3)) for _ in range(4)]
    for order, part in enumerate(parts):
        for axis, rate in enumerate(STRAY_RATES):
            angle = rate * time[:, None] + phase[:, axis] + 0.5 * np.pi * order
            part[:, :, axis] = STRAY * rate**order * np.sin(angle)
    parts[0][:, :, 2] = height
    names = ("position", "velocity", "acceleration", "jerk")
    moved = {name: getattr(lower, name) + part for name, part in zip(names, parts, strict=True)}
    return replace(lower, **moved)


def _gusts(true: PlantVehicle, count: int, flights: list[PlantFlight], seed: int, v: int) -> Array | None:
    """Return the gusts of each flight [m/s], (T, F, 3); the same for the same v."""
    if true.extra.gust[0] <= 0.0:
        return None
    streams = [np.random.default_rng([seed, 92, v, i]) for i in range(len(flights))]
    return np.stack([gust_series(*true.extra.gust, count, CONTROL_RATE, rng) for rng in streams], axis=1)


def _fly_both(
    vehicles: list[tuple[PlantVehicle, Bias]],
    references: tuple[Reference, Reference],
    gusts: list[Array | None],
    seed: int,
) -> list[PlantRecord]:
    places = [reference.position for reference in references]
    wakes = any(true.extra.downwash[0] or true.extra.downwash_law for true, _ in vehicles)
    for _ in range(2 if wakes else 1):
        records = []
        for v, ((true, bias), reference) in enumerate(zip(vehicles, references, strict=True)):
            around = PlantSurroundings(gust=gusts[v], other=places[1 - v], rate=CONTROL_RATE)
            records.append(_fly(true, bias, reference, around, seed, (93, v)))
        places = [record.position for record in records]
    return records


def _fly(
    true: PlantVehicle, bias: Bias, reference: Reference, around: PlantSurroundings, seed: int, key: tuple[int, int]
) -> PlantRecord:
    count, flights = reference.yaw.shape
    streams = [np.random.default_rng([seed, *key, i]) for i in range(flights)]
    sensors = PlantSensors(PlantNoise(), bias, streams, count, extra=true.extra)
    record = fly_references(true=true, declared=DECLARED, reference=reference, sensors=sensors, surroundings=around)
    return delay_sensors(record, bias.delay)


def _fly_low(out: Path, vehicle: tuple[PlantVehicle, Bias], seed: int, duration_s: float, rows: slice) -> list[Path]:
    """Return the logs of single flights of the first vehicle near the ground."""
    flights = [PlantFlight(f"low_{i}", family, (5, i), lowest, 0.5) for i, (family, lowest) in enumerate(LOW)]
    reference = plan_flights(flights, seed=seed, duration_s=duration_s)
    far = np.full_like(reference.position, -100.0)
    true, bias = vehicle
    bias = replace(bias, acc=bias.acc[: len(flights)])
    record = _fly(true, bias, reference, PlantSurroundings(other=far, rate=CONTROL_RATE), seed, (94, 0))
    paths = [out / f"{flight.name}.csv" for flight in flights]
    for i, path in enumerate(paths):
        _write(path, record, i, rows, 0.0)
    return paths


def _write(path: Path, record: PlantRecord, flight: int, rows: slice, clock: float) -> None:
    """Write one log without the place of the other vehicle; its times are behind the true ones by ``clock`` [s]."""
    columns, digits, values = log_table(replace(record, surroundings=PlantSurroundings()), flight, rows)
    values[:, 0] -= clock
    np.savetxt(path, values, fmt=digits, delimiter=",", header=",".join(columns), comments="")


assert all(name in CAUSES for names in HIDDEN.values() for name in names)
