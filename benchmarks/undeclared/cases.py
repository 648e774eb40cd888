"""Make one case: flights of a true vehicle that the declared one does not fully describe."""

import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np

from benchmarks.undeclared import effects as hidden_effects
from benchmarks.undeclared.logs import vehicle_document, write_log, write_robot
from benchmarks.undeclared.nuisance import NO_BIAS, Nuisance, disturb
from benchmarks.undeclared.sensors import Noise, Sensors
from benchmarks.undeclared.simulate import CONTROL_RATE, SUBSTEPS, fly, summarise
from benchmarks.undeclared.trajectories import TEST_FAMILIES, TRAIN_FAMILIES, Reference, plan, stack
from benchmarks.undeclared.vehicle import DECLARED

SETTLE_S = 2.0
"""Hover before a log starts [s], in which the integrals of the autopilot find their values."""


@dataclass(frozen=True, kw_only=True)
class CaseFiles:
    """Where a case lies."""

    train: tuple[Path, ...]
    """Logs to fit on."""

    test: tuple[Path, ...]
    """Logs to judge on; other families of trajectories than train."""

    robot: Path
    """The declared robot, YAML."""

    truth: Path
    """What is hidden, JSON."""


@dataclass(frozen=True, kw_only=True)
class Flight:
    """One flight that a case asks for."""

    name: str
    family: str
    stream: tuple[int, int]
    """Keys of its random streams, beside the seed of the case."""


def flights_of(num_train: int, num_test: int) -> list[Flight]:
    """Return the flights of a case; families repeat in turn when there are more flights than families."""
    train = [Flight(name=f"train_{i + 1}", family=TRAIN_FAMILIES[i % 4], stream=(3, i)) for i in range(num_train)]
    test = [Flight(name=f"test_{i + 1}", family=TEST_FAMILIES[i % 3], stream=(4, i)) for i in range(num_test)]
    return train + test


def plan_all(flights: list[Flight], *, seed: int, duration_s: float, settle_s: float = SETTLE_S) -> Reference:
    """Return the references of all flights, stacked (T, F, ...)."""
    streams = [np.random.default_rng([seed, *flight.stream]) for flight in flights]
    plans = [
        plan(flight.family, duration=duration_s, rate=CONTROL_RATE, settle=settle_s, rng=rng)
        for flight, rng in zip(flights, streams, strict=True)
    ]
    return stack(plans)


def make_case(
    out_dir: str | Path,
    *,
    effects: Mapping[str, str | Mapping[str, float]],
    seed: int,
    num_train: int = 4,
    num_test: int = 3,
    duration_s: float = 16.0,
    nuisance: bool = False,
    rate_hz: int = CONTROL_RATE,
    noise: Noise | None = None,
) -> CaseFiles:
    """Simulate a case and write its logs, the declared robot and the truth.

    Args:
        out_dir: Folder, made if missing.
        effects: Hidden effect to its size (small, moderate, large: values drawn from the seed) or to its parameters.
            Empty: nothing is hidden.
        seed: Decides values, trajectories and noise; flights and noise do not depend on the effects.
        num_train: Training flights.
        num_test: Test flights.
        duration_s: Length of each log [s].
        nuisance: Whether mass, rotors, inertia, lag, centre of mass and sensors are slightly off.
        rate_hz: Rate of the logs [Hz], a divisor of 400.
        noise: Sensor noise; None takes the defaults.

    Raises:
        ValueError: For an unknown effect, size or parameter, or a number out of range.
    """
    if rate_hz <= 0 or CONTROL_RATE % rate_hz:
        raise ValueError(f"rate_hz = {rate_hz!r}: must divide {CONTROL_RATE}")
    if num_train < 0 or num_test < 0 or num_train + num_test == 0 or not duration_s >= 1.0:
        raise ValueError(f"{num_train=}, {num_test=}, {duration_s=}: needs a flight, of at least 1 s")
    params = hidden_effects.resolve(effects, declared=DECLARED, seed=seed)
    declared, true = hidden_effects.split(DECLARED, params)
    bias = NO_BIAS
    if nuisance:
        true, bias = disturb(true, Nuisance(), hidden=params, seed=seed)
    noise = noise or Noise()
    flights = flights_of(num_train, num_test)
    reference = plan_all(flights, seed=seed, duration_s=duration_s)
    streams = [np.random.default_rng([seed, 10 + kind, index]) for kind, index in (f.stream for f in flights)]
    sensors = Sensors(noise, bias, streams, len(reference.yaw))
    record = fly(true=true, declared=declared, reference=reference, sensors=sensors)
    first = round(SETTLE_S * CONTROL_RATE)
    summaries = summarise(record, reference, declared=declared, first=first)

    out = Path(out_dir)
    out.mkdir(parents=True, exist_ok=True)
    paths = [out / f"{flight.name}.csv" for flight in flights]
    for index, path in enumerate(paths):
        write_log(path, record, index, first=first, every=CONTROL_RATE // rate_hz)
    write_robot(out / "robot.yaml", declared)
    truth = {
        "effects": params,
        "sizes": {name: value if isinstance(value, str) else "explicit" for name, value in effects.items()},
        "seed": seed,
        "noise": asdict(noise),
        "nuisance": asdict(Nuisance()) if nuisance else None,
        "bias": {"acc": bias.acc.tolist(), "gyro": bias.gyro.tolist()},
        "true_vehicle": vehicle_document(true),
        "declared_vehicle": vehicle_document(declared),
        "rates_hz": {"log": rate_hz, "autopilot": CONTROL_RATE, "plant": CONTROL_RATE * SUBSTEPS},
        "flights": {f.name: {"family": f.family, **asdict(s)} for f, s in zip(flights, summaries, strict=True)},
    }
    (out / "truth.json").write_text(json.dumps(truth, indent=1) + "\n")
    train, test = tuple(paths[:num_train]), tuple(paths[num_train:])
    return CaseFiles(train=train, test=test, robot=out / "robot.yaml", truth=out / "truth.json")
