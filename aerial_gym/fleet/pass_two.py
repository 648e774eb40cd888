"""Pass 2: the model of the fleet, the state of each vehicle, and the verdicts. Letters: N flights, K columns."""

import hashlib
import json
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from functools import partial
from importlib import import_module
from io import BytesIO
from math import exp, inf
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np

from aerial_gym.config.storage import write_atomic
from aerial_gym.fleet.engine import Engine
from aerial_gym.fleet.moments import unpack_moments
from aerial_gym.fleet.sources import ORDER, sort_by_time
from aerial_gym.fleet.statistics.moments import usable_times
from aerial_gym.fleet.tables import FleetTables, Row, match_columns
from aerial_gym.sim2real.json_values import finite_or_none, map_leaves
from aerial_gym.sim2real.progress import Progress, silent

STATISTICS = "aerial_gym.fleet.statistics"
WORDING = "aerial_gym.fleet.wording"
"""Modules with the functions of the statistics and of their sentences; tests give rest."""

VEHICLES_AT_ONCE = 8
FIT_FLIGHTS, MOST_FLIGHTS = 20, 500
"""Flights of a vehicle, equally spaced, for the model of the fleet, and last ones that its verdict rests on: memory is flat."""
FEW, NOT_TESTABLE = UNJUDGED = ("too_few_flights", "not_testable")  # Verdicts of vehicles that cannot be judged
NO_CHANGE = dict.fromkeys(("onset_flight", "onset_low", "onset_high", "onset_time", "kind", "crosses_limit_at"))
NO_CHANGE |= {"causes": "[]"}  # Columns that only a change has
CAMPAIGN = "or a campaign: the other vehicles do not rule out such changes by site, season or load"
MOST_ALIKE, MOST_ALIKE_SHARE = 2, 0.2
"""Vehicles of a run that may change alike at one time, by number and share. Beyond that, something that they share is named."""
FEWEST_FLIGHTS = 4  # Two before a change and two after it, as no change may rest on one flight


@dataclass(frozen=True, kw_only=True)
class MomentGroup:
    """Flights of one robot file, model version and set of columns, whose moments add."""

    robot_hash: str
    model_version: str
    digest: str  # Of the columns

    def key(self) -> dict[str, str]:
        """Return the part of the key that its rows share."""
        return {"robot_hash": self.robot_hash, "model_version": self.model_version}

    def name(self) -> str:
        """Return a name for files."""
        return hashlib.sha256(repr(self).encode()).hexdigest()[:16]


@dataclass(frozen=True, kw_only=True)
class PassTwoSettings:
    """Settings of the verdicts."""

    level: float = 0.01  # False discovery rate
    limits: Mapping[str, float] = field(default_factory=dict)  # Value that a drift may not cross, by EFFECT.PARAMETER
    module: str = STATISTICS
    wording: str = WORDING


@dataclass(frozen=True, kw_only=True)
class VehicleResult:
    """Rows of one vehicle, before the verdicts of the fleet are compared."""

    vehicle: str
    log_e: float  # Against campaigns too, once all vehicles of the group are judged
    own_log_e: float  # Of its flights alone
    verdict: dict[str, Any]
    parameters: "tuple[Row, ...]"
    change: Any  # ``ChangeResult``
    odd_logs: tuple[str, ...]  # Hashes of the logs of its odd flights
    note: str  # On flights that do not count
    sign: tuple[str, int, bool] | None = None  # Effect, rotor and direction of its most probable change
    span: tuple[float, float] = (0.0, 0.0)  # Times of the last flight before the onset's interval, and of its last one


@dataclass(frozen=True, kw_only=True)
class VehicleReader:
    """Reader of the flights of some vehicles of a group."""

    out: Path
    group: MomentGroup
    columns: Sequence[Any]

    def model_file(self) -> Path:
        """Return the file of the model of the group."""
        return self.out / "models" / f"{self.group.name()}.npz"

    def read(
        self, vehicles: Sequence[str], module: Any, most: int | None = None
    ) -> Iterator[tuple[Any, list[dict[str, Any]], str]]:
        """Yield the last flights of each vehicle in order of time, their rows, and a note on those that do not count.

        ``most``: largest number of flights of a vehicle, equally spaced in all of them.
        """
        where = {"vehicle": list(vehicles), "status": "ok", "columns": self.group.digest} | self.group.key()
        tables, by_vehicle = FleetTables(self.out), {vehicle: list[dict[str, Any]]() for vehicle in vehicles}
        for row in tables.rows("flights", ("vehicle", "firmware", "log_hash", *ORDER), **where):
            by_vehicle[row["vehicle"]].append(row)
        for vehicle, rows in by_vehicle.items():
            rows = [row | {"number": number} for number, row in enumerate(sort_by_time(rows))]
            spaced = np.linspace(0, len(rows) - 1, min(most or 0, len(rows))).round().astype(int)
            by_vehicle[vehicle] = rows[-MOST_FLIGHTS:] if most is None else [rows[k] for k in spaced]
        where["log_hash"] = [row["log_hash"] for rows in by_vehicle.values() for row in rows]
        stored = tables.rows("flights", ("log_hash", "moments"), **where)
        moments = {row["log_hash"]: row["moments"] for row in stored}
        for vehicle, rows in by_vehicle.items():
            size, note = len(self.columns), f"; judged by its last {len(rows)} flights" if rows[0]["number"] else ""
            product, gradient = np.empty((len(rows), size, size)), np.empty((len(rows), size))
            parts = zip(rows, product, gradient, strict=True)
            intact = np.array([unpack_moments(moments.pop(row["log_hash"]), *own) for row, *own in parts], dtype=bool)
            if not intact.all():
                note += f"; the moments of {(~intact).sum()} of {len(rows)} flights are damaged, and left out"
                product, gradient = product[intact], gradient[intact]
                rows = [row for row, is_intact in zip(rows, intact, strict=True) if is_intact]
            if rows:
                times, is_timed = usable_times(np.array([row["start_time"] for row in rows], dtype=float))
                own = {
                    "product": product, "gradient": gradient, "is_timed": is_timed,
                    "time": times if is_timed else np.array([row["number"] + 1.0 for row in rows]),
                    "firmware": tuple(row["firmware"] or "" for row in rows),
                }  # fmt: skip
                yield module.VehicleFlights(vehicle=vehicle, **own), rows, note


class VehicleJudge:
    """Worker of pass 2: the state of vehicles and the evidence that they have changed."""

    def __init__(self, reader: VehicleReader, model: Any, settings: PassTwoSettings) -> None:
        self._reader, self._model, self._settings = reader, model, settings
        self._module = import_module(settings.module)

    def __call__(self, vehicles: Sequence[str]) -> list[VehicleResult]:
        """Return the rows of vehicles."""
        from aerial_gym.interop import one_thread

        with one_thread():
            return [self._judge(*one) for one in self._reader.read(vehicles, self._module)]

    def _judge(self, flights: Any, rows: Sequence[Row], note: str) -> VehicleResult:
        columns, key = self._reader.columns, {"vehicle": flights.vehicle} | self._reader.group.key()
        result = self._module.find_change(self._model, flights, columns)
        posterior = self._module.vehicle_posterior(self._model, flights, columns, result)
        last = {"flights": len(rows), "firmware": flights.firmware[-1], "last_time": rows[-1]["start_time"]}
        parameters = tuple(
            key | {"effect": column.effect, "rotor": column.rotor, "parameter": column.parameter} | last
            | {"value": float(value), "std": float(std)}
            for column, value, std in zip(columns, posterior.mean, posterior.std, strict=True)
            if column.effect
        )  # fmt: skip
        change = result.renumber(np.array([row["number"] for row in rows]))
        verdict = key | self._verdict(change, len(rows), forecasts=flights.is_timed and result.end is None)
        if result.causes:
            verdict["onset_time"] = float(flights.time[result.causes[0].onset])
        return VehicleResult(
            vehicle=flights.vehicle, log_e=float(result.log_e), own_log_e=float(result.log_e), parameters=parameters,
            change=change, verdict=verdict, note=note, odd_logs=tuple(rows[k]["log_hash"] for k in result.odd_flights),
            **_sign_and_span(result, flights.time),
        )  # fmt: skip

    def _verdict(self, result: Any, flights: int, *, forecasts: bool) -> dict[str, Any]:
        """Return a row of ``verdicts`` under the assumption that the fleet rejects 'no change'."""
        few, best = flights - len(result.odd_flights) < FEWEST_FLIGHTS, result.causes[0] if result.causes else None
        name = "changed" if len(result.candidates) == 1 else "ambiguous"
        row: dict[str, Any] = {
            "verdict": FEW if few else NOT_TESTABLE if best is None else name,
            "causes": _json_text([asdict(one) | {"candidate": one in result.candidates} for one in result.causes]),
        }  # fmt: skip
        if best is not None:
            row |= {
                "onset_flight": best.onset + 1, "onset_low": best.onset_low + 1, "onset_high": best.onset_high + 1,
                "kind": best.kind, "crosses_limit_at": self._crossing(best) if forecasts else None,
            }  # fmt: skip
        return row

    def _crossing(self, change: Any) -> float | None:
        limits = {name: self._settings.limits.get(f"{change.effect}.{name}") for name in change.parameters}
        known = ((limit, name) for name, limit in limits.items() if limit is not None)
        times = [self._module.time_to_limit(change, *one) for one in known]
        return min((one[0] for one in times if one is not None), default=None)


def _sign_and_span(result: Any, time: Any) -> dict[str, Any]:
    """Return the direction of the most probable change, by its largest parameter, and the times within which it began."""
    if not result.causes:
        return {}
    best = result.causes[0]
    sign = (best.effect, best.rotor, max(best.change, key=abs) > 0.0)
    return {"sign": sign, "span": (float(time[max(best.onset_low - 1, 0)]), float(time[best.onset_high]))}


def _json_text(content: Any) -> str:
    """Return JSON with null for numbers that are not finite."""
    return json.dumps(map_leaves(content, finite_or_none), default=lambda number: number.item())  # of NumPy


def columns_of_digest(tables: FleetTables, digest: str) -> list[Any]:
    """Return the columns of a digest; infinite bounds are stored as null."""
    ends = {"low": -inf, "high": inf}
    return [
        SimpleNamespace(**{name: ends[name] if value is None else value for name, value in column.items()})
        for column in tables.columns_by_digest()[digest]
    ]


def judge_fleet(
    tables: FleetTables, robots: Collection[str], model_version: str, engine: Engine, settings: PassTwoSettings,
    report: Progress = silent, only: Collection[str] | None = None,
) -> list[dict[str, Any]]:  # fmt: skip
    """Write vehicles and verdicts; return the verdicts, with the odd logs of each vehicle.

    Args:
        robots: Hashes of the present robots; flights under other robots are not judged.
        only: Vehicles with new flights. They are compared with the stored model, and the others keep their verdicts. None for
            all, with a new model.
    """
    module, results, rest, cohorts = import_module(settings.module), list[VehicleResult](), np.empty(0), list[Row]()
    groups = _vehicles_by_group(tables, robots, model_version)
    total = sum(map(len, groups.values())) if only is None else len(only)
    for group, flights in groups.items():
        reader = VehicleReader(out=tables.out, group=group, columns=columns_of_digest(tables, group.digest))
        model = None if only is None else _model_on_disk(reader, sum(flights.values()), module)
        if model is None:
            sample = [one for one, _, _ in reader.read(module.draw_vehicles(flights), module, FIT_FLIGHTS)]
            model = module.fit_fleet(sample, reader.columns)
            _store_model(reader, sum(flights.values()), model)
            if only is None:
                rows = module.compare_cohorts(model, sample, reader.columns, settings.level)
                cohorts += [group.key() | asdict(row) for row in rows]
        vehicles = [vehicle for vehicle in flights if only is None or vehicle in only]
        batches = (vehicles[k : k + VEHICLES_AT_ONCE] for k in range(0, len(vehicles), VEHICLES_AT_ONCE))
        judged = list[VehicleResult]()
        for batch in engine(batches, partial(VehicleJudge, reader, model, settings)):
            judged += batch
            report(f"vehicles {len(results) + len(judged)}/{total}", (len(results) + len(judged)) / total)
        results += _beyond_campaigns(judged, reader, module, only is None)
    if only is not None:
        key = {"model_version": model_version, "robot_hash": list(robots)}
        stored = tables.rows("verdicts", ("vehicle", "verdict", "log_e"), **key)
        logs = [row["log_e"] for row in stored if row["vehicle"] not in only and row["verdict"] not in UNJUDGED]
        rest = np.array(logs, dtype=float)
    verdicts = decide(results, rest, settings)
    where = ~match_columns(model_version=model_version) | match_columns(
        **({} if only is None else {"vehicle": list(only)})
    )
    tables.replace("vehicles", where, [row for one in results for row in one.parameters])
    tables.replace("verdicts", where, verdicts)
    if only is None:
        write_atomic(tables.out / "cohorts.json", _json_text(cohorts))
    return verdicts


def _model_on_disk(reader: VehicleReader, flights: int, module: Any) -> Any:
    """Return the stored model of a group; None if the number of flights has doubled since, which bounds age and effort."""
    file = reader.model_file()
    if not file.is_file():
        return None
    with np.load(file) as stored:
        arrays = dict(stored)
    return module.FleetModel(**arrays) if flights < 2 * arrays.pop("flights") else None


def _beyond_campaigns(
    results: Sequence[VehicleResult], reader: VehicleReader, module: Any, is_whole: bool
) -> list[VehicleResult]:
    """Return the results with evidence against the campaigns of the fleet, which a run over all vehicles stores."""
    file, known = reader.model_file().with_suffix(".campaigns.json"), dict[tuple[str, int], Any]()
    if not is_whole and file.is_file():
        known = {
            (effect, rotor): np.array(logs) for effect, rotor, logs in json.loads(file.read_text(encoding="utf-8"))
        }
    fleet = module.campaign_evidence((one.change for one in results), known)
    if is_whole:
        write_atomic(file, json.dumps([[*cause, logs.tolist()] for cause, logs in fleet.items()]))
    changes = [module.exclude_campaigns(one.change, fleet) for one in results]
    return [replace(one, log_e=float(new.log_e), change=new) for one, new in zip(results, changes, strict=True)]


def _store_model(reader: VehicleReader, flights: int, model: Any) -> None:
    content = BytesIO()
    np.savez(content, flights=flights, **vars(model))
    reader.model_file().parent.mkdir(exist_ok=True)
    write_atomic(reader.model_file(), content.getvalue())


def decide(results: Sequence[VehicleResult], rest: Any, settings: PassTwoSettings) -> list[dict[str, Any]]:
    """Return the verdicts of vehicles, with the false discovery rate over them and the log e-values ``rest`` of others."""
    enough = np.array([one.verdict["verdict"] not in UNJUDGED for one in results], dtype=bool)
    reject, wording = import_module(settings.module).benjamini_hochberg, import_module(settings.wording)
    flags, evident = (np.zeros(len(results), dtype=bool) for _ in range(2))
    for chosen, logs in ((flags, [one.log_e for one in results]), (evident, [one.own_log_e for one in results])):
        own = np.array(logs)[enough]
        chosen[enough] = reject(np.concatenate((own, rest)), settings.level)[: own.size]
    changed = [one for one, flag in zip(results, flags, strict=True) if flag]
    rows = []
    for one, flag, is_evident in zip(results, flags, evident, strict=True):
        row = _verdict_row(one, bool(flag), wording)
        if is_evident and not flag:
            text = f"{wording.text_of_change(one.change, one.vehicle)}, {CAMPAIGN}"
            row |= {"verdict": "campaign", "text": text + one.note}
        alike = sum(other.sign == one.sign and _overlap(other.span, one.span) for other in changed) if flag else 0
        if alike > max(MOST_ALIKE, MOST_ALIKE_SHARE * enough.sum()):
            alike_text = f"{alike} of {enough.sum()} vehicles changed alike at that time"
            text = f"{row['text']}; {alike_text}: season, site, firmware or log format?"
            row |= {"verdict": "shared", "crosses_limit_at": None, "text": text}
        rows.append(row)
    return rows


def _overlap(first: tuple[float, float], second: tuple[float, float]) -> bool:
    return first[0] <= second[1] and second[0] <= first[1]


def _verdict_row(result: VehicleResult, rejected: bool, wording: Any) -> dict[str, Any]:
    row = result.verdict | {"rejected": rejected, "odd_logs": result.odd_logs}
    row |= {"log_e": result.log_e, "p_value": min(1.0, exp(-max(result.log_e, -1.0)))}
    if rejected:
        row |= {} if row["verdict"] == "changed" else {"crosses_limit_at": None}
        text = wording.text_of_change(result.change, result.vehicle)
    else:
        row |= NO_CHANGE | {"verdict": row["verdict"] if row["verdict"] in UNJUDGED else "no_change"}
        text = wording.text_of_no_change(result.change, result.vehicle, row["verdict"])
    return row | {"text": text + result.note}


def vehicles_to_judge(tables: FleetTables, robots: Collection[str], model_version: str) -> set[str]:
    """Return the vehicles with a flight that is newer than their verdict, as an interrupted run leaves them."""
    names, key = ("vehicle", "robot_hash", "written_at"), {"robot_hash": list(robots), "model_version": model_version}
    judged = {(row["vehicle"], row["robot_hash"]): row["written_at"] for row in tables.rows("verdicts", names, **key)}
    flown = ((row.pop("written_at"), *row.values()) for row in tables.rows("flights", names, status="ok", **key))
    return {vehicle for time, vehicle, robot in flown if time >= judged.get((vehicle, robot), time)}


def _vehicles_by_group(
    tables: FleetTables, robots: Collection[str], model_version: str
) -> dict[MomentGroup, dict[str, int]]:
    """Return the vehicles of each group with their numbers of flights, in the order of their first flights."""
    groups = dict[MomentGroup, dict[str, int]]()
    names = ("robot_hash", "columns", "vehicle")
    for row in tables.rows("flights", names, robot_hash=list(robots), model_version=model_version, status="ok"):
        group = MomentGroup(robot_hash=row["robot_hash"], model_version=model_version, digest=row["columns"])
        vehicles = groups.setdefault(group, {})
        vehicles[row["vehicle"]] = vehicles.get(row["vehicle"], 0) + 1
    return groups
