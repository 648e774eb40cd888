"""Cheap passes for tests: pass 1 reads a small JSON log, pass 2 compares means of the first and second half."""

import json
import os
import time
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from math import nan
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np

from aerial_gym.config.robot import RobotCfg
from aerial_gym.sim2real.findings import Finding

VERSION = "1+test"


@dataclass(frozen=True, kw_only=True)
class Column:
    effect: str
    parameter: str
    rotor: int = 0
    start: int = 0
    scale: float = 1.0
    neutral: float = 0.0
    low: float = -float("inf")
    high: float = float("inf")


COLUMNS = (
    *(Column(effect="weak_motor", parameter="scale", rotor=k) for k in (1, 2)),
    Column(effect="", parameter="mass"),
)


def model_version() -> str:
    return os.environ.get("FAKE_VERSION", VERSION)


def log_airframe(path: Path) -> str:
    return json.loads(path.read_text(encoding="utf-8")).get("airframe", "")


def flight_evidences(robot: RobotCfg, logs: Sequence[Path], *, mapping: str | None = None) -> list[Any]:
    """Return the evidence of logs ``{"value": [2 numbers], "airframe": ..., "time": ...}``."""
    return [_evidence(path) for path in logs]


def _evidence(path: Path) -> Any:
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
    except ValueError:
        return SimpleNamespace(reason=f"{path}: is no log")
    if "end" in content:
        raise SystemExit
    if os.environ.get("FAKE_SLOW"):
        time.sleep(float(os.environ["FAKE_SLOW"]))
    product, value = np.diag([100.0, 100.0, 1.0]), np.array([*content["value"], 0.0])
    effects = [
        SimpleNamespace(effect="weak_motor", rotor=k + 1, start=0, params=(v,), cov=(0.01,), score=v)
        for k, v in enumerate(content["value"])
    ]
    return SimpleNamespace(
        columns=COLUMNS, product=product, gradient=product @ value, square=float(value @ product @ value), rows=10,
        effects=tuple(effects), checks=(Finding("one_command", "", {}),), events=(), duration_s=20.0,
        airframe=content.get("airframe", ""), firmware=content.get("firmware", ""),
        start_time=content.get("time", nan),
    )  # fmt: skip


def write_fleet(folder: Path, vehicles: int, flights: int, *, changed: Iterable[int] = (), bad: bool = True) -> int:
    """Write logs in a folder for each vehicle; rotor 1 of changed vehicles loses 1 from the middle on. Return their number."""
    rng = np.random.default_rng(0)
    for vehicle in range(vehicles):
        own = folder / f"vehicle_{vehicle}"
        own.mkdir(parents=True)
        for flight in range(flights):
            value = rng.normal(scale=0.1, size=2) - [vehicle in changed and flight >= flights // 2, 0.0]
            write_log(own / f"flight_{flight}.csv", value.tolist(), time=1e9 + 1e3 * flight)
    if bad:
        (folder / "vehicle_0" / "flight_bad.csv").write_text("no log")
    return vehicles * flights + bad


def write_log(path: Path, value: list[float], **more: object) -> None:
    path.write_text(json.dumps({"value": value} | more), encoding="utf-8")


@dataclass(frozen=True, kw_only=True)
class VehicleFlights:
    vehicle: str
    product: np.ndarray
    gradient: np.ndarray
    time: np.ndarray
    firmware: tuple[str, ...]
    is_timed: bool = True


@dataclass(frozen=True, kw_only=True)
class Change:
    effect: str
    rotor: int
    kind: str
    log_evidence: float
    onset: int
    onset_low: int
    onset_high: int
    parameters: tuple[str, ...]
    change: tuple[float, ...]

    def count_flights(self, numbers: np.ndarray) -> "Change":
        names = ("onset", "onset_low", "onset_high")
        return replace(self, **{name: int(numbers[getattr(self, name)]) for name in names})


@dataclass(frozen=True, kw_only=True)
class Result:
    log_e: float = 0.0
    causes: tuple[Change, ...] = ()
    odd_flights: tuple[int, ...] = ()
    end: int | None = None
    second: None = None

    def count_flights(self, numbers: np.ndarray) -> "Result":
        causes = tuple(one.count_flights(numbers) for one in self.causes)
        return replace(self, causes=causes, odd_flights=tuple(int(numbers[k]) for k in self.odd_flights))

    @property
    def candidates(self) -> tuple[Change, ...]:
        return self.causes


@dataclass(frozen=True, kw_only=True)
class FleetModel:
    mean: np.ndarray


def draw_vehicles(names: Iterable[str]) -> list[str]:
    return sorted(names)


def fit_fleet(vehicles: Sequence[VehicleFlights], columns: Sequence[Any]) -> Any:
    values = np.concatenate([_values(one) for one in vehicles])
    return FleetModel(mean=np.median(values, axis=0))


def _values(flights: VehicleFlights) -> np.ndarray:
    return np.linalg.solve(flights.product, flights.gradient[:, :, None])[:, :, 0]


def vehicle_posterior(model: Any, flights: VehicleFlights, columns: Sequence[Any], result: Any) -> Any:
    values = _values(flights)
    return SimpleNamespace(mean=values.mean(axis=0), std=values.std(axis=0))


def find_change(model: Any, flights: VehicleFlights, columns: Sequence[Any]) -> Any:
    """Return the step of the means in the middle. A second value of 9 marks an odd flight, and one of 8 a blind one."""
    values, middle = _values(flights), len(flights.firmware) // 2
    marks = np.round(values[:, 1])
    if not middle or (marks == 8).all():
        return Result()
    kept = np.where(marks == 9, np.nan, values[:, 0])[:, None] * [1.0, 0.0]
    steps = np.nanmean(kept[middle:], axis=0) - np.nanmean(kept[:middle], axis=0)
    rotor = int(np.argmax(np.abs(steps[:2])))
    cause = Change(
        effect="weak_motor", rotor=rotor + 1, kind="step", log_evidence=50.0 * abs(steps[rotor]) - 20.0, onset=middle,
        onset_low=middle, onset_high=middle, parameters=("scale",), change=(float(steps[rotor]),),
    )  # fmt: skip
    return Result(log_e=cause.log_evidence, causes=(cause,), odd_flights=tuple(np.flatnonzero(marks == 9).tolist()))


def campaign_evidence(results: Iterable[Any], known: Any = None) -> Any:
    return {}


def exclude_campaigns(result: Any, fleet: Any) -> Any:
    return result


@dataclass(frozen=True, kw_only=True)
class Difference:
    firmware: tuple[str, str]
    effect: str
    rotor: int
    parameters: tuple[str, ...]
    difference: tuple[float, ...]
    low: tuple[float, ...]
    high: tuple[float, ...]
    rejected: bool
    leading: bool


def compare_cohorts(
    model: Any, vehicles: Sequence[VehicleFlights], columns: Sequence[Any], level: float = 0.01
) -> list[Difference]:
    names = sorted({name for one in vehicles for name in one.firmware})
    values = {"parameters": ("scale",), "difference": (0.1,), "low": (0.05,), "high": (0.15,)}
    values |= {"firmware": (names[0], names[-1]), "effect": "weak_motor", "rotor": 1}
    return [Difference(rejected=True, leading=True, **values)] if names[1:] else []


def time_to_limit(change: Change, limit: float, parameter: str = "") -> tuple[float, float, float] | None:
    return (2e9, 1e9, 3e9)


def benjamini_hochberg(log_e: np.ndarray, level: float) -> np.ndarray:
    return log_e > np.log(max(len(log_e), 1) / level)


def text_of_change(result: Any, vehicle: str) -> str:
    return f"vehicle {vehicle}, rotor {result.causes[0].rotor}: changed since flight {result.causes[0].onset + 1}"


def text_of_no_change(result: Any, vehicle: str, verdict: str) -> str:
    return f"vehicle {vehicle}: {verdict}, {len(result.odd_flights)} odd flights"
