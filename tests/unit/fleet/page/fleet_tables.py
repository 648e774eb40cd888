"""Tables of an invented fleet, as ``fleet run`` writes them.

Rotor 3 of the first vehicle loses thrust in a step; the centre of mass of the second one drifts.
"""

import json
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
from deltalake import DeltaTable, write_deltalake

Row = dict[str, Any]

HOSTILE = "<script>alert(1)</script>"
EFFECTS = {
    ("weak_motor", 3): (("scale", 0.01, 1.0),),
    ("com_offset", 0): (("x", 0.001, 0.0), ("y", 0.001, 0.0), ("z", 0.002, 0.0)),
    ("payload_mass", 0): (("dm", 0.01, 0.0),),
    ("rotor_drag", 0): (("dx", 0.02, 0.1), ("dy", 0.02, 0.1), ("dz", 0.02, 0.05)),
    ("constant_wind", 0): (("x", 1.0, 0.0), ("y", 1.0, 0.0), ("z", 0.3, 0.0)),
}
"""Parameters of each effect and rotor: name, standard deviation in a flight, mean of the fleet."""

START = datetime(2026, 3, 1, tzinfo=UTC).timestamp()
TEXT, NUMBER, COUNT, NUMBERS = pa.string(), pa.float64(), pa.int64(), pa.list_(pa.float64())
FLIGHT_KEY = dict.fromkeys(("log_hash", "robot_hash", "model_version"), TEXT)
VEHICLE_KEY = dict.fromkeys(("vehicle", "robot_hash", "model_version"), TEXT)
COLUMNS = {
    "flights": FLIGHT_KEY
    | dict.fromkeys(("path", "vehicle", "firmware", "status", "reason", "checks", "events", "columns"), TEXT)
    | dict.fromkeys(("start_time", "order", "duration_s", "square"), NUMBER)
    | {"rows": COUNT, "moments": pa.binary()},
    "evidence": FLIGHT_KEY
    | {
        "vehicle": TEXT,
        "effect": TEXT,
        "rotor": COUNT,
        "start": COUNT,
        "params": NUMBERS,
        "cov": NUMBERS,
        "score": NUMBER,
    },
    "vehicles": VEHICLE_KEY
    | {"effect": TEXT, "rotor": COUNT, "parameter": TEXT, "value": NUMBER, "std": NUMBER}
    | {"flights": COUNT, "firmware": TEXT, "last_time": NUMBER},
    "verdicts": VEHICLE_KEY
    | dict.fromkeys(("verdict", "causes", "kind", "text"), TEXT)
    | dict.fromkeys(("log_e", "p_value", "onset_time", "crosses_limit_at"), NUMBER)
    | dict.fromkeys(("onset_flight", "onset_low", "onset_high"), COUNT)
    | {"rejected": pa.bool_()},
    "alerts": dict.fromkeys(("id", "vehicle", "verdict", "text", "first_seen"), TEXT),
}
"""Columns of each table, without ``written_at``."""


def make_tables(out: Path) -> Path:
    """Create empty tables of a fleet in a folder."""
    out.mkdir(parents=True, exist_ok=True)
    for name in COLUMNS:
        DeltaTable.create(out / name, schema(name), mode="ignore")
    (out / "fleet.json").write_text(json.dumps({"schema_version": 2, "settings": {}}), encoding="utf-8")
    names = [
        {"effect": effect, "rotor": rotor, "start": 0, "parameter": parameter}
        for (effect, rotor), parameters in EFFECTS.items()
        for parameter, *_ in parameters
    ]
    (out / "columns.json").write_text(json.dumps({"digest": names}), encoding="utf-8")
    return out


def schema(name: str) -> pa.Schema:
    return pa.schema(COLUMNS[name] | {"written_at": pa.timestamp("us", tz="UTC")})


def add_rows(out: Path, name: str, rows: list[Row]) -> None:
    """Append rows in one commit; columns that a row leaves out are null."""
    now = datetime.now(UTC)
    write_deltalake(
        out / name, pa.Table.from_pylist([row | {"written_at": now} for row in rows], schema(name)), mode="append"
    )


def write_fleet(out: Path, vehicles: list[str], flights: int, *, seed: int = 0) -> Path:
    """Write the tables of vehicles with some flights each, and three refused logs."""
    make_tables(out)
    random, rows = np.random.default_rng(seed), {name: list[Row]() for name in COLUMNS}
    for place, vehicle in enumerate(vehicles):
        add_vehicle(rows, place, vehicle, flights, random)
    refused = ["ends after the header"] * 2 + [f"no column of {HOSTILE}"]
    for place, reason in enumerate(refused):
        flight = flight_row(f"bad{place}", "", 0) | {
            "status": "refused",
            "reason": reason,
            "path": f"logs/bad{place}.ulg",
        }
        rows["flights"].append(flight | {"robot_hash": "robot", "start_time": float("nan"), "duration_s": 0.0})
    for name, own in rows.items():
        if own:
            add_rows(out, name, own)
    return out


def flight_row(log_hash: str, vehicle: str, number: int) -> Row:
    """Return the row of a flight."""
    start = START + 86400.0 * 0.7 * number
    return {
        "log_hash": log_hash, "robot_hash": "robot", "model_version": "0.2.0-abc", "vehicle": vehicle,
        "path": f"logs/{vehicle}/{number:04d}.ulg", "firmware": "", "start_time": start, "order": start,
        "duration_s": 20.0 + number % 7, "status": "ok", "reason": "", "columns": "digest", "rows": 100, "square": 1.0,
        "checks": json.dumps([{"code": "rows_cut", "subject": "log", "values": {}}, {"code": "invented", "subject": HOSTILE}]),
        "events": "[]", "moments": b"",
    }  # fmt: skip


def add_vehicle(
    rows: dict[str, list[Row]], place: int, vehicle: str, flights: int, random: np.random.Generator
) -> None:
    """Add the rows of a vehicle."""
    key = {"vehicle": vehicle, "robot_hash": "robot", "model_version": "0.2.0-abc"}
    update, onset = flights // 3 + place % 5, 2 * flights // 3
    deviation = {effect: 0.3 * random.standard_normal(len(own)) for effect, own in EFFECTS.items()}
    for number in range(flights):
        flight = flight_row(f"{place:05d}{number:05d}", vehicle, number)
        flight["firmware"] = (
            ("1.14.3" if number < update else "1.15.0") if place % 3 else f"1.15.0 {HOSTILE}" * (place < 3) or "1.14.3"
        )
        rows["flights"].append(flight)
        for (effect, rotor), own in EFFECTS.items():
            std, mean = (np.array([one[k] for one in own]) for k in (1, 2))
            noise = std * random.uniform(0.7, 1.5)
            value = mean + std * deviation[effect, rotor] + noise * random.standard_normal(std.size)
            if place == 0 and effect == "weak_motor" and number >= onset:
                value -= 0.031
            if place == 1 and effect == "com_offset" and number >= onset:
                value[0] += 0.006 * (number - onset + 1) / (flights - onset)
            score = float(0.5 * np.sum(((value - mean) / noise) ** 2) - 2.0)
            evidence = {"log_hash": flight["log_hash"], "effect": effect, "rotor": rotor, "start": 0, "score": score}
            rows["evidence"].append(
                key | evidence | {"params": value.tolist(), "cov": np.diag(noise**2).ravel().tolist()}
            )
    last = {"flights": flights, "firmware": flight["firmware"], "last_time": flight["start_time"]}
    for (effect, rotor), own in EFFECTS.items():
        for (parameter, std, mean), unit in zip(own, deviation[effect, rotor], strict=True):
            name = {"effect": effect, "rotor": rotor, "parameter": parameter}
            rows["vehicles"].append(key | name | last | {"value": mean + std * unit, "std": std / np.sqrt(flights)})
    rows["verdicts"].append(key | verdict_row(place, vehicle, onset, flights))


def cause(effect: str, kind: str, log_evidence: float, onset: int, change: dict[str, float], std: float) -> Row:
    """Return a cause as in the column ``causes``; its onset counts from 0."""
    neutral = {name: mean for (own, _), parameters in EFFECTS.items() if own == effect for name, _, mean in parameters}
    return {
        "effect": effect, "rotor": 3 if effect == "weak_motor" else 0, "start": 0, "kind": kind, "log_evidence": log_evidence,
        "onset": onset, "onset_low": onset - 1, "onset_high": onset + 1, "candidate": True,
        "parameters": list(change), "change": list(change.values()),
        "std": [std] * len(change), "level": [neutral[name] + size for name, size in change.items()],
    }  # fmt: skip


def verdict_row(place: int, vehicle: str, onset: int, flights: int) -> Row:
    """Return the verdict of a vehicle: the first has a step, the second a drift with two possible causes."""
    row: Row = {
        "verdict": "no_change",
        "causes": "[]",
        "log_e": -1.5 + 0.001 * place,
        "p_value": 1.0,
        "rejected": False,
    }
    row |= {"text": f"vehicle {vehicle}: no change shown"}
    if flights < 4:
        return row | {"verdict": "too_few_flights", "text": f"vehicle {vehicle}: too few flights to judge a change"}
    if place > 1:
        return row
    step, text = (
        cause("weak_motor", "step", 24.3, onset, {"scale": -0.031}, 0.003),
        f"rotor 3: -3.1 % (± 0.6 %) thrust since flight {onset + 1}",
    )
    causes = [step, cause("payload_mass", "step", 9.1, onset, {"dm": 0.02}, 0.004) | {"candidate": False}]
    if place == 1:
        causes = [cause("com_offset", "drift", 14.2, onset, {"x": 0.006, "y": 1e-4, "z": 0.0}, 0.0004)]
        causes.append(cause("payload_mass", "drift", 12.9, onset, {"dm": 0.03}, 0.006))
        text = f"+6.0 mm (± 0.8 mm) x com offset as a drift since flight {onset + 1}; or payload mass"
    return row | {
        "verdict": "ambiguous" if place else "changed", "causes": json.dumps(causes), "log_e": causes[0]["log_evidence"] - 2.0,
        "p_value": float(np.exp(2.0 - causes[0]["log_evidence"])), "rejected": True, "onset_flight": onset + 1,
        "onset_low": onset, "onset_high": onset + 2, "kind": causes[0]["kind"], "onset_time": START,
        "text": f"vehicle {vehicle}, {text}", "crosses_limit_at": START + 86400.0 * 400 if place else None,
    }  # fmt: skip
