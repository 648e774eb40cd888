"""Make one case: flights of a true vehicle that the declared one does not fully describe."""

import json
from collections.abc import Container, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path

import numpy as np

from benchmarks.undeclared import effects as hidden_effects
from benchmarks.undeclared.failures import Failures, PlantFailure
from benchmarks.undeclared.logs import late, vehicle_document, write_log, write_robot
from benchmarks.undeclared.nuisance import NO_BIAS, Bias, PlantNuisance, disturb
from benchmarks.undeclared.sensors import PlantNoise, PlantSensors
from benchmarks.undeclared.simulate import CONTROL_RATE, SUBSTEPS, PlantRecord, fly, summarise
from benchmarks.undeclared.surroundings import (
    CEILING_HEIGHT,
    NOMINAL_VOLTAGE,
    VOLTAGE_NOISE,
    Battery,
    PlantSurroundings,
    companion,
    gusts,
)
from benchmarks.undeclared.trajectories import (
    LOWEST_HEIGHT,
    TEST_FAMILIES,
    TRAIN_FAMILIES,
    Reference,
    plan,
    stack,
)
from benchmarks.undeclared.vehicle import DECLARED, PlantVehicle

SETTLE_S = 2.0
"""Hover before a log starts [s], in which the integrals of the autopilot find their values."""


@dataclass(frozen=True, kw_only=True)
class CaseFiles:
    """Files of a case."""

    train: tuple[Path, ...]  # Logs to fit on
    test: tuple[Path, ...]  # Logs to judge on; other families of trajectories than train
    robot: Path  # The declared robot, YAML
    truth: Path  # What is hidden, JSON


@dataclass(frozen=True, kw_only=True)
class PlantFlight:
    """One flight that a case asks for."""

    name: str
    family: str
    stream: tuple[int, int]  # Keys of its random streams, beside the seed of the case
    lowest: float = LOWEST_HEIGHT  # Of the reference [m], above the ground or below the ceiling
    ease: float = 1.0  # Scale of the reference
    below_ceiling: bool = False  # Whether the reference hangs from the ceiling


NEAR = {
    "train": (("multisine", 5.0, 1.0), ("waypoints", 0.3, 0.5), ("low_passes", 0.2, 1.0), ("low_hover", 0.15, 1.0)),
    "test": (("figure_eight", 0.25, 0.6), ("square", 5.0, 1.0), ("lissajous", 0.2, 0.5)),
}
"""Family, lowest height [m] and scale of flights near the ground or a ceiling; some stay away for comparison."""

CEILING_ROOM = 0.03
"""Further from a ceiling than from the ground [m]: a ceiling attracts, and the autopilot must win."""

HEIGHTS = {"train": (0.8, 12.0, 3.0, 25.0), "test": (1.5, 8.0, 20.0)}
"""Lowest heights of flights that tell a wind that grows with height [m]."""


def list_flights(num_train: int, num_test: int, features: Sequence[str] = ()) -> list[PlantFlight]:
    """Return the flights of a case; families repeat in turn when there are more flights than families."""
    flights = []
    for part, count, families, key in (("train", num_train, TRAIN_FAMILIES, 3), ("test", num_test, TEST_FAMILIES, 4)):
        for i in range(count):
            flight = PlantFlight(name=f"{part}_{i + 1}", family=families[i % len(families)], stream=(key, i))
            flights.append(_place_flight(flight, part, i, features))
    return flights


def _place_flight(flight: PlantFlight, part: str, i: int, features: Sequence[str]) -> PlantFlight:
    """Return the flight where and as the features want it; with ground and ceiling they take turns."""
    if "hover" in features and part == "train":
        flight = replace(flight, family="hover")
    if "low" in features or "ceiling" in features:
        family, lowest, ease = NEAR[part][i % len(NEAR[part])]
        hanging = "ceiling" in features and ("low" not in features or i % 2 == 1)
        lowest += CEILING_ROOM if hanging else 0.0
        flight = replace(flight, family=family, lowest=lowest, ease=ease, below_ceiling=hanging)
    if "heights" in features and flight.lowest == LOWEST_HEIGHT:
        flight = replace(flight, lowest=HEIGHTS[part][i % len(HEIGHTS[part])])
    return flight


def plan_all(flights: list[PlantFlight], *, seed: int, duration_s: float, settle_s: float = SETTLE_S) -> Reference:
    """Return the references of all flights, stacked (T, F, ...)."""
    streams = [np.random.default_rng([seed, *flight.stream]) for flight in flights]
    plans = [
        plan(
            flight.family,
            duration=duration_s,
            rate=CONTROL_RATE,
            settle=settle_s,
            rng=rng,
            lowest=flight.lowest,
            ease=flight.ease,
            ceiling=CEILING_HEIGHT if flight.below_ceiling else None,
        )
        for flight, rng in zip(flights, streams, strict=True)
    ]
    return stack(plans)


def surround(
    true: PlantVehicle,
    flights: list[PlantFlight],
    reference: Reference,
    *,
    seed: int,
    features: Sequence[str],
    failures: Mapping[str, PlantFailure] | None = None,
) -> tuple[PlantSurroundings, Battery | None]:
    """Return the surroundings of the flights, and the battery with a charge of 0 to 1500 C already used in each flight."""
    fails = Failures([failures.get(f.name) for f in flights], SETTLE_S) if failures else None
    gust = other = battery = None
    if true.extra.gust[0] > 0.0:
        series = [gusts(*true.extra.gust, len(reference.yaw), CONTROL_RATE, _stream(seed, 20, f)) for f in flights]
        gust = np.stack(series, axis=1)
    if "other" in features:
        paths = [companion(reference, i, CONTROL_RATE, _stream(seed, 30, f)) for i, f in enumerate(flights)]
        other = np.stack(paths, axis=1)
    if "battery" in features:
        battery = Battery(true, np.array([_stream(seed, 40, f).uniform(0.0, 1500.0) for f in flights]))
    ceiling = CEILING_HEIGHT if "ceiling" in features else None
    surroundings = PlantSurroundings(gust=gust, other=other, ceiling=ceiling, rate=CONTROL_RATE, failures=fails)
    return surroundings, battery


def _stream(seed: int, kind: int, flight: PlantFlight) -> np.random.Generator:
    return np.random.default_rng([seed, kind + flight.stream[0], flight.stream[1]])


def _read_voltage(record: PlantRecord, flights: list[PlantFlight], seed: int) -> PlantRecord:
    """Return the record with noise on the voltage."""
    noise = [_stream(seed, 50, f).standard_normal(len(record.voltage)) for f in flights]
    return replace(record, voltage=record.voltage + VOLTAGE_NOISE * np.stack(noise, axis=1))


@dataclass(frozen=True, kw_only=True)
class CaseRecord:
    """A case in memory; flights include the hover before the logs."""

    params: dict[str, dict[str, float]]  # Hidden effects and their parameters
    declared: PlantVehicle
    true: PlantVehicle
    bias: Bias  # Of the IMU, by nuisance
    features: tuple[str, ...]
    failures: dict[str, PlantFailure]  # By the name of the flight
    flights: list[PlantFlight]
    reference: Reference
    record: PlantRecord


def fly_case(
    *,
    effects: Mapping[str, str | Mapping[str, float]],
    seed: int,
    num_train: int = 4,
    num_test: int = 3,
    duration_s: float = 16.0,
    nuisance: bool | PlantNuisance = False,
    noise: PlantNoise | None = None,
    features: Sequence[str] = (),
    failures: Mapping[str, PlantFailure] | None = None,
) -> CaseRecord:
    """Return the flights of a case; arguments and errors as in ``make_case``."""
    params = hidden_effects.resolve(effects, declared=DECLARED, seed=seed)
    declared, true = hidden_effects.split(DECLARED, params)
    bias = NO_BIAS
    if nuisance:
        sizes = nuisance if isinstance(nuisance, PlantNuisance) else PlantNuisance()
        true, bias = disturb(true, sizes, seed=seed, hidden=params, num_flights=num_train + num_test)
    features = hidden_effects.flight_features(effects, features)
    flights, failures = list_flights(num_train, num_test, features), failures or {}
    if unknown := set(failures) - {flight.name for flight in flights}:
        raise ValueError(f"no flight {sorted(unknown)}. Flown: {', '.join(flight.name for flight in flights)}")
    reference = plan_all(flights, seed=seed, duration_s=duration_s)
    streams = [_stream(seed, 10, flight) for flight in flights]
    sensors = PlantSensors(noise or PlantNoise(), bias, streams, len(reference.yaw), extra=true.extra)
    surroundings, battery = surround(true, flights, reference, seed=seed, features=features, failures=failures)
    record = fly(
        true=true, declared=declared, reference=reference, sensors=sensors, surroundings=surroundings, battery=battery
    )
    if bias.delay.any():
        record = late(record, bias.delay)
    _require_air(record, flights, failures)
    if battery is not None:
        record = _read_voltage(record, flights, seed)
    return CaseRecord(
        params=params,
        declared=declared,
        true=true,
        bias=bias,
        features=features,
        failures=dict(failures),
        flights=flights,
        reference=reference,
        record=record,
    )


def make_case(
    out_dir: str | Path,
    *,
    effects: Mapping[str, str | Mapping[str, float]],
    seed: int,
    num_train: int = 4,
    num_test: int = 3,
    duration_s: float = 16.0,
    nuisance: bool | PlantNuisance = False,
    rate_hz: int = CONTROL_RATE,
    noise: PlantNoise | None = None,
    features: Sequence[str] = (),
    failures: Mapping[str, PlantFailure] | None = None,
) -> CaseFiles:
    """Simulate a case and write its logs, the declared robot and the truth.

    Args:
        out_dir: Folder, made if missing.
        effects: Hidden effect to its size (small, moderate, large: values drawn from the seed) or to its parameters.
            Empty: nothing is hidden.
        seed: Decides values, trajectories and noise; flights and noise do not depend on the effects, but for the
            features that these need.
        num_train: Training flights.
        num_test: Test flights.
        duration_s: Length of each log [s].
        nuisance: Whether mass, rotors, inertia, lag, centre of mass and sensors are slightly off, or by how much.
        rate_hz: Rate of the logs [Hz], a divisor of 400.
        noise: Sensor noise; None takes the defaults.
        features: Of the flights (``catalog.FEATURES``), beside those that the effects need; for controls.
        failures: What fails in flight, by the name of the flight (``train_1``); its log ends before it comes to the ground.

    Raises:
        ValueError: For an unknown effect, size, parameter or feature, a number out of range, or a flight that came too
            near to the ground or the ceiling.
    """
    if rate_hz <= 0 or CONTROL_RATE % rate_hz:
        raise ValueError(f"rate_hz = {rate_hz!r}: must divide {CONTROL_RATE}")
    if num_train < 0 or num_test < 0 or num_train + num_test == 0 or not duration_s >= 1.0:
        raise ValueError(f"{num_train=}, {num_test=}, {duration_s=}: needs a flight, of at least 1 s")
    noise = noise or PlantNoise()
    case = fly_case(
        effects=effects,
        seed=seed,
        num_train=num_train,
        num_test=num_test,
        duration_s=duration_s,
        nuisance=nuisance,
        noise=noise,
        features=features,
        failures=failures,
    )
    first = round(SETTLE_S * CONTROL_RATE)
    out = Path(out_dir)
    out.mkdir(parents=True, exist_ok=True)
    paths = [out / f"{flight.name}.csv" for flight in case.flights]
    for index, path in enumerate(paths):
        last = _in_air(case.record, index) if case.flights[index].name in case.failures else None
        write_log(path, case.record, index, first=first, last=last, every=CONTROL_RATE // rate_hz)
    near = "low" in case.features or "ceiling" in case.features
    write_robot(out / "robot.yaml", case.declared, radius=near)
    sizes = {name: value if isinstance(value, str) else "explicit" for name, value in effects.items()}
    truth = _truth(case, first=first, sizes=sizes, seed=seed, noise=noise, nuisance=nuisance, rate_hz=rate_hz)
    (out / "truth.json").write_text(json.dumps(truth, indent=1) + "\n")
    train, test = tuple(paths[:num_train]), tuple(paths[num_train:])
    return CaseFiles(train=train, test=test, robot=out / "robot.yaml", truth=out / "truth.json")


def _truth(
    case: CaseRecord,
    *,
    first: int,
    sizes: dict[str, str],
    seed: int,
    noise: PlantNoise,
    nuisance: bool | PlantNuisance,
    rate_hz: int,
) -> dict[str, object]:
    """Return all that is hidden as plain data."""
    ceiling = case.record.surroundings.ceiling
    surroundings = {"features": case.features, "nominal_voltage": NOMINAL_VOLTAGE, "ceiling": ceiling}
    summaries = summarise(case.record, case.reference, declared=case.declared, first=first)
    flights = zip(case.flights, summaries, strict=True)
    return {
        "effects": case.params,
        "sizes": sizes,
        "seed": seed,
        "noise": asdict(noise),
        "nuisance": asdict(nuisance if isinstance(nuisance, PlantNuisance) else PlantNuisance()) if nuisance else None,
        "bias": {name: numbers.tolist() for name, numbers in vars(case.bias).items()},
        "true_vehicle": vehicle_document(case.true),
        "declared_vehicle": vehicle_document(case.declared),
        "rates_hz": {"log": rate_hz, "autopilot": CONTROL_RATE, "plant": CONTROL_RATE * SUBSTEPS},
        **(surroundings if case.features else {}),
        **({"failures": _failures(case)} if case.failures else {}),
        "flights": {f.name: {"family": f.family, **asdict(s)} for f, s in flights},
    }


def _failures(case: CaseRecord) -> dict[str, dict[str, object]]:
    """Return the failure of each flight that has one, by flight name."""
    flown = case.record.surroundings.failures
    assert flown is not None
    return {f.name: flown.document(row) for row, f in enumerate(case.flights) if f.name in case.failures}


LOWEST_ROOM = 0.05
"""Neither ground nor ceiling has contact: no log comes nearer [m]."""


def _in_air(record: PlantRecord, flight: int) -> int:
    """Return the number of samples before a flight comes too near to the ground or the ceiling."""
    height = record.position[:, flight, 2]
    ceiling = np.inf if record.surroundings.ceiling is None else record.surroundings.ceiling
    near = np.flatnonzero(~(np.minimum(height, ceiling - height) > LOWEST_ROOM))
    return int(near[0]) if near.size else len(height)


def _require_air(record: PlantRecord, flights: list[PlantFlight], failures: Container[str]) -> None:
    """Raise if a flight without a failure came within 5 cm of the ground or the ceiling: neither has contact."""
    height = record.position[:, :, 2]
    gap = height.min(axis=0)
    if record.surroundings.ceiling is not None:
        gap = np.minimum(gap, record.surroundings.ceiling - height.max(axis=0))
    for flight, room in zip(flights, gap, strict=True):
        if flight.name not in failures and not room > LOWEST_ROOM:
            raise ValueError(f"{flight.name}: came within {room:.3f} m of ground or ceiling; take a smaller effect")
