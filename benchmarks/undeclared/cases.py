"""Make one case: flights of a true vehicle that the declared one does not fully describe."""

import json
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.undeclared import effects as hidden_effects
from benchmarks.undeclared.evidence import FlightStates, evidence_over_rivals
from benchmarks.undeclared.loggers import LOGGERS, PlantLogger, disturb_record, write_rows, write_ulog
from benchmarks.undeclared.logs import delay_sensors, vehicle_document, write_log, write_robot
from benchmarks.undeclared.other_laws import gust_series_by_law
from benchmarks.undeclared.sensors import NO_BIAS, Bias, PlantNoise, PlantNuisance, PlantSensors, add_nuisance
from benchmarks.undeclared.simulate import CONTROL_RATE, SUBSTEPS, PlantRecord, fly_references, summarise
from benchmarks.undeclared.surroundings import (
    CEILING_HEIGHT,
    NOMINAL_VOLTAGE,
    VOLTAGE_NOISE,
    Battery,
    Failures,
    PlantFailure,
    PlantSurroundings,
    companion_path,
    gust_series,
)
from benchmarks.undeclared.trajectories import (
    LOWEST_HEIGHT,
    TEST_FAMILIES,
    TRAIN_FAMILIES,
    Reference,
    plan_flight,
    stack_references,
)
from benchmarks.undeclared.vehicle import DECLARED, PlantVehicle

SETTLE_S = 2.0  # Hover before a log starts [s], in which the integrals of the autopilot find their values
LOWEST_ROOM = 0.05  # Least distance of a log from ground and ceiling, which have no contact [m]


@dataclass(frozen=True, kw_only=True)
class CaseFiles:
    """Files of a case."""

    train: tuple[Path, ...]  # Logs to fit on
    test: tuple[Path, ...]  # Logs to judge on; other families of trajectories than train
    robot: Path  # The declared robot, YAML
    truth: Path  # What is hidden, JSON


@dataclass(frozen=True)
class PlantFlight:
    """One flight that a case asks for."""

    name: str
    family: str
    stream: tuple[int, int]  # Keys of its random streams, beside the seed of the case
    lowest: float = LOWEST_HEIGHT  # Of the reference [m], above the ground or below the ceiling
    scale: float = 1.0  # Scale of the reference
    below_ceiling: bool = False  # Whether the reference hangs from the ceiling


NEAR = {
    "train": (("multisine", 5.0, 1.0), ("waypoints", 0.3, 0.5), ("low_passes", 0.2, 1.0), ("low_hover", 0.15, 1.0)),
    "test": (("figure_eight", 0.25, 0.6), ("square", 5.0, 1.0), ("lissajous", 0.2, 0.5)),
}
"""Family, lowest height [m] and scale of flights near the ground or a ceiling; some stay away for comparison."""

CEILING_ROOM = 0.03  # Further from a ceiling than from the ground [m]: a ceiling attracts, and the autopilot must win

HEIGHTS = {"train": (0.8, 12.0, 3.0, 25.0), "test": (1.5, 8.0, 20.0)}
"""Lowest heights of flights that tell a wind that grows with height [m]."""


def list_flights(num_train: int, num_test: int, features: Sequence[str] = ()) -> list[PlantFlight]:
    """Return the flights of a case; families repeat in turn when there are more flights than families."""
    parts = (("train", num_train, TRAIN_FAMILIES, 3), ("test", num_test, TEST_FAMILIES, 4))
    return [
        _place_flight(PlantFlight(f"{part}_{i + 1}", families[i % len(families)], (key, i)), part, i, features)
        for part, count, families, key in parts
        for i in range(count)
    ]


def _place_flight(flight: PlantFlight, part: str, i: int, features: Sequence[str]) -> PlantFlight:
    """Return the flight with the family, height and scale of the features; ground and ceiling take turns."""
    if "low" in features or "ceiling" in features:
        family, lowest, scale = NEAR[part][i % len(NEAR[part])]
        hanging = "ceiling" in features and ("low" not in features or i % 2 == 1)
        lowest += CEILING_ROOM if hanging else 0.0
        flight = replace(flight, family=family, lowest=lowest, scale=scale, below_ceiling=hanging)
    if "heights" in features and flight.lowest == LOWEST_HEIGHT:
        flight = replace(flight, lowest=HEIGHTS[part][i % len(HEIGHTS[part])])
    hovers = "hover" in features and part == "train"
    return replace(flight, family="hover", scale=1.0) if hovers else flight


def plan_flights(flights: list[PlantFlight], *, seed: int, duration_s: float, settle_s: float = SETTLE_S) -> Reference:
    """Return the references of all flights, stacked (T, F, ...)."""
    times = {"duration": duration_s, "rate": CONTROL_RATE, "settle": settle_s}
    return stack_references([
        plan_flight(
            flight.family, **times, rng=_stream(seed, 0, flight), lowest=flight.lowest, scale=flight.scale,
            ceiling=CEILING_HEIGHT if flight.below_ceiling else None,
        )
        for flight in flights
    ])  # fmt: skip


def _stream(seed: int, kind: int, flight: PlantFlight) -> np.random.Generator:
    return np.random.default_rng([seed, kind + flight.stream[0], flight.stream[1]])


@dataclass(frozen=True, kw_only=True)
class PlantCase:
    """Request of a case; flights and noise do not depend on the effects, but for the features that these need."""

    effects: Mapping[str, str | Mapping[str, float]]
    """Hidden effect to its size (small, moderate, large: values drawn from the seed) or to its parameters."""

    seed: int  # Decides values, trajectories and noise
    num_train: int = 4  # Training flights
    num_test: int = 3  # Test flights
    duration_s: float = 16.0  # Length of each log [s]

    nuisance: bool | PlantNuisance = False
    """Whether mass, rotors, inertia, lag, centre of mass and sensors are slightly off, or by how much."""

    noise: PlantNoise = field(default_factory=PlantNoise)  # Of the sensors
    features: Sequence[str] = ()  # Of the flights (``FEATURES``), beside those that the effects need

    failures: Mapping[str, PlantFailure] = field(default_factory=dict)
    """Failure of a flight by its name (``train_1``); the log of that flight ends before it comes to the ground."""

    def __post_init__(self) -> None:
        if self.num_train < 0 or self.num_test < 0 or self.num_train + self.num_test == 0 or not self.duration_s >= 1.0:
            numbers = f"num_train={self.num_train}, num_test={self.num_test}, duration_s={self.duration_s}"
            raise ValueError(f"{numbers}: needs a flight, of at least 1 s")

    @property
    def nuisance_sizes(self) -> PlantNuisance | None:
        """Sizes of the small errors; None for none."""
        return self.nuisance if isinstance(self.nuisance, PlantNuisance) else PlantNuisance() if self.nuisance else None


@dataclass(frozen=True, kw_only=True)
class CaseRecord:
    """A case in memory; flights include the hover before the logs."""

    case: PlantCase
    params: dict[str, dict[str, float]]  # Hidden effects and their parameters
    declared: PlantVehicle
    true: PlantVehicle
    bias: Bias  # Of the IMU, by nuisance
    features: tuple[str, ...]  # Of the flights, with those that the effects need
    flights: list[PlantFlight]
    reference: Reference
    record: PlantRecord

    def room(self) -> np.ndarray:
        """Return the distance from the ground and from the ceiling, if there is one, [m], (T, F)."""
        height, ceiling = self.record.position[:, :, 2], self.record.surroundings.ceiling
        return height if ceiling is None else np.minimum(height, ceiling - height)


def make_surroundings(
    case: PlantCase, true: PlantVehicle, flights: list[PlantFlight], reference: Reference, features: Sequence[str]
) -> tuple[PlantSurroundings, Battery | None]:
    """Return the surroundings of the flights, and the battery with a charge of 0 to 1500 C already used in each flight."""
    seed, gust, other, battery = case.seed, None, None, None
    fails = Failures([case.failures.get(f.name) for f in flights], SETTLE_S) if case.failures else None
    if true.extra.gust[0] > 0.0:
        series = [
            gust_series(*true.extra.gust, len(reference.yaw), CONTROL_RATE, _stream(seed, 20, f)) for f in flights
        ]
        gust = np.stack(series, axis=1)
    if true.extra.gust_law:
        series = [
            gust_series_by_law(true.extra.gust_law, len(reference.yaw), CONTROL_RATE, _stream(seed, 20, f))
            for f in flights
        ]
        gust = np.stack(series, axis=1)
    if "other" in features:
        paths = [companion_path(reference, i, CONTROL_RATE, _stream(seed, 30, f)) for i, f in enumerate(flights)]
        other = np.stack(paths, axis=1)
    if "battery" in features:
        battery = Battery(true, np.array([_stream(seed, 40, f).uniform(0.0, 1500.0) for f in flights]))
    ceiling = CEILING_HEIGHT if "ceiling" in features else None
    surroundings = PlantSurroundings(gust=gust, other=other, ceiling=ceiling, rate=CONTROL_RATE, failures=fails)
    return surroundings, battery


def fly_case(**settings: Any) -> CaseRecord:
    """Return the flights of a case; settings are the fields of ``PlantCase``, errors those of ``make_case``."""
    case = PlantCase(**settings)
    seed, params = case.seed, hidden_effects.effect_parameters(case.effects, declared=DECLARED, seed=case.seed)
    declared, true = hidden_effects.split_vehicles(DECLARED, params)
    bias, num_flights = NO_BIAS, case.num_train + case.num_test
    if case.nuisance_sizes is not None:
        true, bias = add_nuisance(true, case.nuisance_sizes, seed=seed, hidden=params, num_flights=num_flights)
    features = hidden_effects.flight_features(case.effects, case.features)
    flights = list_flights(case.num_train, case.num_test, features)
    if unknown := set(case.failures) - {flight.name for flight in flights}:
        raise ValueError(f"no flight {sorted(unknown)}. Flown: {', '.join(flight.name for flight in flights)}")
    reference = plan_flights(flights, seed=seed, duration_s=case.duration_s)
    streams = [_stream(seed, 10, flight) for flight in flights]
    sensors = PlantSensors(case.noise, bias, streams, len(reference.yaw), extra=true.extra)
    surroundings, battery = make_surroundings(case, true, flights, reference, features)
    record = fly_references(
        true=true, declared=declared, reference=reference, sensors=sensors, surroundings=surroundings, battery=battery
    )
    if bias.delay.any():
        record = delay_sensors(record, bias.delay)
    if battery is not None:
        noise = [_stream(seed, 50, f).standard_normal(len(record.voltage)) for f in flights]
        record = replace(record, voltage=record.voltage + VOLTAGE_NOISE * np.stack(noise, axis=1))
    flown = CaseRecord(
        case=case, params=params, declared=declared, true=true, bias=bias, features=features, flights=flights,
        reference=reference, record=record,
    )  # fmt: skip
    for flight, room in zip(flights, flown.room().min(axis=0), strict=True):
        if flight.name not in case.failures and not room > LOWEST_ROOM:
            raise ValueError(f"{flight.name}: came within {room:.3f} m of ground or ceiling; take a smaller effect")
    return flown


def make_case(
    out_dir: str | Path, *, rate_hz: int = CONTROL_RATE, logger: str = "", evidence: bool = False, **settings: Any
) -> CaseFiles:
    """Simulate a case and write its logs, the declared robot and the truth.

    Args:
        out_dir: Folder, made if missing.
        rate_hz: Rate of the logs [Hz], a divisor of 400.
        logger: One of ``LOGGERS``, which has its own rates; empty for plain rows.
        evidence: Whether the truth states the evidence that the training flights can show (``evidence``).
        settings: Fields of ``PlantCase``.

    Raises:
        ValueError: For an unknown effect, size, parameter, feature or logger, a number out of range, or a flight that came too
            near to the ground or the ceiling.
    """
    if rate_hz <= 0 or CONTROL_RATE % rate_hz:
        raise ValueError(f"rate_hz = {rate_hz!r}: must divide {CONTROL_RATE}")
    if logger and logger not in LOGGERS:
        raise ValueError(f"no logger {logger!r}. Known: {', '.join(LOGGERS)}")
    flown, first, out = fly_case(**settings), round(SETTLE_S * CONTROL_RATE), Path(out_dir)
    case, low = flown.case, ~(flown.room() > LOWEST_ROOM)
    kind = LOGGERS[logger or "rows"]
    if kind.file == "ulg" and (lost := {"other", "ceiling"} & set(flown.features)):
        raise ValueError(f"logger {logger}: a ULog has no place for {sorted(lost)}; take another logger")
    out.mkdir(parents=True, exist_ok=True)
    record = disturb_record(flown.record, kind, case.seed) if logger else flown.record
    paths = [out / f"{flight.name}.{kind.file}" for flight in flown.flights]
    for index, path in enumerate(paths):
        comes_down = flown.flights[index].name in case.failures and low[:, index].any()
        last = int(low[:, index].argmax()) if comes_down else None
        if not logger:
            write_log(path, record, index, slice(first, last, CONTROL_RATE // rate_hz))
        elif kind.file == "ulg":
            write_ulog(path, record, index, slice(first, last), kind, flown.declared.speed_range()[1])
        else:
            write_rows(path, record, index, slice(first, last, round(CONTROL_RATE / kind.row_rate)), kind, case.seed)
    robot, truth = out / "robot.yaml", out / "truth.json"
    write_robot(robot, flown.declared, radius="low" in flown.features or "ceiling" in flown.features)
    hidden = _truth(flown, first=first, rate_hz=rate_hz)
    if evidence:
        hidden["evidence"] = _evidence(flown, first, kind)
    truth.write_text(json.dumps(hidden, indent=1) + "\n")
    train, test = tuple(paths[: case.num_train]), tuple(paths[case.num_train :])
    return CaseFiles(train=train, test=test, robot=robot, truth=truth)


def _evidence(flown: CaseRecord, first: int, logger: PlantLogger) -> dict[str, float]:
    """Return the expected evidence in the training flights for the hidden effects over each rival; empty for a control."""
    if not flown.params:
        return {}
    states = FlightStates(flown.record, range(flown.case.num_train), first, logger)
    sizes = flown.case.nuisance_sizes or PlantNuisance()
    return evidence_over_rivals(states, flown.params, flown.case.noise, sizes)


def _truth(flown: CaseRecord, *, first: int, rate_hz: int) -> dict[str, object]:
    """Return all that is hidden as plain data."""
    case, around = flown.case, flown.record.surroundings
    surroundings = {"features": flown.features, "nominal_voltage": NOMINAL_VOLTAGE, "ceiling": around.ceiling}
    failed = {f.name: row for row, f in enumerate(flown.flights) if f.name in case.failures}
    failures = {name: around.failures.document(row) for name, row in failed.items() if around.failures is not None}
    summaries = summarise(flown.record, flown.reference, declared=flown.declared, first=first)
    return {
        "effects": flown.params,
        "sizes": {name: value if isinstance(value, str) else "explicit" for name, value in case.effects.items()},
        "seed": case.seed,
        "noise": asdict(case.noise),
        "nuisance": None if case.nuisance_sizes is None else asdict(case.nuisance_sizes),
        "bias": {name: numbers.tolist() for name, numbers in vars(flown.bias).items()},
        "true_vehicle": vehicle_document(flown.true),
        "declared_vehicle": vehicle_document(flown.declared),
        "rates_hz": {"log": rate_hz, "autopilot": CONTROL_RATE, "plant": CONTROL_RATE * SUBSTEPS},
        **(surroundings if flown.features else {}),
        **({"failures": failures} if failures else {}),
        "flights": {f.name: {"family": f.family, **asdict(s)} for f, s in zip(flown.flights, summaries, strict=True)},
    }
