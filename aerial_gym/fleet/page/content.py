"""Content of the pages as plain data, from which both the pages and the JSON are made."""

import json
import shlex
from collections.abc import Mapping
from itertools import pairwise
from math import isfinite
from pathlib import Path
from typing import Any

from aerial_gym.fleet.page.snapshot import FleetSnapshot, Row
from aerial_gym.fleet.page.texts import HALF_95, change_text, interval_text, unit_text
from aerial_gym.fleet.report_folder import report_folder
from aerial_gym.fleet.sources import sort_by_time
from aerial_gym.fleet.wording import cause_name, texts_of_differences
from aerial_gym.sim2real.findings import Finding
from aerial_gym.sim2real.wording import text
from aerial_gym.sim2real.wording.words import value_text

PAGE_ROWS = 50  # Rows of a table on one page
TRAIN_FLIGHTS = 6  # Flights that the suggested close-loop is fitted to

VERDICTS = {
    "changed": "changed", "ambiguous": "changed, cause ambiguous",
    "shared": "changed, as many others", "campaign": "change or campaign", "no_change": "no change shown",
    "too_few_flights": "too few flights", "not_testable": "no effect visible", "": "not judged yet",
}  # fmt: skip
"""Words of each verdict, in the order in which they are sorted."""

SORTS = {
    "vehicle": "vehicle", "verdict": f"list_position({list(VERDICTS)}, verdict)", "cause": "cause", "since": "onset_flight",
    "size": "scales", "evidence": "log_e", "flights": "flights", "last flight": "last_time", "firmware": "firmware",
}  # fmt: skip
"""Expression that each column of the table of vehicles is sorted by."""

CHOSEN = """FROM (FROM current LEFT JOIN sizes USING (vehicle))
WHERE ($1 = 'any' OR verdict = $1) AND contains(lower(concat_ws(' ', vehicle, firmware, cause)), lower($2))"""
OWN = "vehicle = ? AND robot_hash = ? AND model_version = ?"

Options = Mapping[str, str]  # Options of an address
Content = dict[str, Any]


def fleet_content(snapshot: FleetSnapshot, _: str, options: Options) -> Content:
    """Return the fleet at a glance, and a page of its vehicles: ``verdict``, ``text``, ``sort``, ``down``, ``page``."""
    counts = snapshot.rows("SELECT verdict, count(*) AS vehicles FROM current GROUP BY verdict")
    content = snapshot.row("FROM totals") or {}
    content["verdicts"] = dict.fromkeys(VERDICTS, 0) | {row["verdict"]: row["vehicles"] for row in counts}
    content |= {name: snapshot.rows(f"FROM {name}") for name in ("changes", "reasons", "cohorts")}
    content["differences"] = texts_of_differences(snapshot.tables.cohorts())
    verdict, sort = options.get("verdict", "any"), options.get("sort", "")
    sort = sort if sort in SORTS else "evidence"
    verdict = verdict if verdict in VERDICTS else "any"
    chosen = {"verdict": verdict, "text": options.get("text", "").strip(), "sort": sort}
    chosen["down"] = options.get("down", "1" if sort == "evidence" else "0")
    filters = (chosen["verdict"], chosen["text"])
    matches = (snapshot.row(f"SELECT count(*) AS vehicles {CHOSEN}", *filters) or {})["vehicles"]
    first, way = ("rejected DESC, ", "DESC") if chosen["down"] == "1" else ("", "ASC")
    order = f"{first if sort == 'evidence' else ''}{SORTS[sort]} {way} NULLS LAST, vehicle"
    page = _pages(matches, options)
    limit = f"LIMIT {PAGE_ROWS} OFFSET {PAGE_ROWS * (page['page'] - 1)}"
    rows = snapshot.rows(f"SELECT * EXCLUDE (causes) {CHOSEN} ORDER BY {order} {limit}", *filters)
    return content | page | {"vehicles": rows, "matches": matches, "chosen": chosen}


def vehicle_content(snapshot: FleetSnapshot, vehicle: str, options: Options) -> Content | None:
    """Return the verdict, causes, effects and flights of a vehicle; None for an unknown one."""
    own = snapshot.row("FROM current WHERE vehicle = ?", vehicle)
    if own is None:
        return None
    flights, causes = vehicle_flights(snapshot, own), json.loads(own["causes"])
    for cause in causes:
        cause |= {"name": cause_name(cause), "size": change_text(cause)}
    page = _pages(len(flights), options)
    end = len(flights) - PAGE_ROWS * (page["page"] - 1)
    pairs = [pair for pair in pairwise(flights) if pair[0]["firmware"] != pair[1]["firmware"]]
    updates = [{"number": b["number"], "before": a["firmware"], "after": b["firmware"]} for a, b in pairs]
    return own | page | {
        "causes": causes, "effects": effect_histories(snapshot, own, flights, causes), "updates": updates,
        "all_flights": flights, "timed": all(isfinite(flight["start_time"]) for flight in flights),
        "shown_flights": flights[max(end - PAGE_ROWS, 0) : end][::-1],
        "report": report_link(snapshot.tables.out, own, flights, len(flights)),
    }  # fmt: skip


def vehicle_flights(snapshot: FleetSnapshot, own: Row) -> list[Row]:
    """Return the flights of a vehicle that the verdict rests on, numbered from 1 in their order."""
    names = "log_hash, path, firmware, start_time, duration_s, columns, epoch_us(written_at) AS written_at"
    rows = snapshot.rows(f"SELECT {names} FROM flights WHERE {OWN} AND status = 'ok' ORDER BY log_hash", *_key(own))
    return [{"number": number} | row for number, row in enumerate(sort_by_time(rows), 1)]


def effect_histories(snapshot: FleetSnapshot, own: Row, flights: list[Row], causes: list[Row]) -> list[Content]:
    """Return the history of each effect: candidate causes first, then by the summed evidence of the flights."""
    known, effects = {flight["log_hash"]: flight for flight in flights}, dict[tuple[str, int], Content]()
    for row in snapshot.rows(f"FROM histories WHERE {OWN} ORDER BY log_hash", *_key(own)):
        if flight := known.get(row["log_hash"]):
            one = {"effect": row["effect"], "rotor": row["rotor"], "name": cause_name(row), "score": 0.0, "history": []}
            one = effects.setdefault((row["effect"], row["rotor"]), one | {"fleet": {}})
            one["score"] += row["score"]
            values = {"number": flight["number"], "parameters": snapshot.parameters(row, flight["columns"])}
            one["history"].append(values)
    for row in snapshot.rows(
        "FROM states JOIN bands USING (robot_hash, model_version, effect, rotor, parameter) "
        f"WHERE {OWN} ORDER BY effect, rotor, parameter", *_key(own),
    ):  # fmt: skip
        row["text"] = interval_text(row["value"], row["std"], unit_text(row["effect"], row["parameter"]))
        row["median_text"] = value_text(row["median"], HALF_95 * row["std"])
        if one := effects.get((row["effect"], row["rotor"])):
            one["fleet"][row["parameter"]] = row
    ranks = {(cause["effect"], cause["rotor"]): k for k, cause in enumerate(causes) if cause["candidate"]}
    for key, one in effects.items():
        one["is_cause"], one["history"] = key in ranks, sorted(one["history"], key=lambda value: value["number"])
    order = sorted(effects, key=lambda key: (ranks.get(key, len(ranks)), -effects[key]["score"], key))
    return [effects[key] for key in order]


def flight_content(snapshot: FleetSnapshot, log_hash: str, _: Options) -> Content | None:
    """Return the checks, events and evidence of a flight; None for an unknown one."""
    same = "USING (log_hash, robot_hash, model_version)"
    sql = f"SELECT newest.*, checks, events FROM newest JOIN flights {same} WHERE log_hash = ?"
    flight = snapshot.row(sql, log_hash)
    if flight is None:
        return None
    sql = f"SELECT evidence.* EXCLUDE (written_at) FROM evidence JOIN newest {same} "
    effects = snapshot.rows(f"{sql}WHERE log_hash = ? ORDER BY score DESC, effect, rotor, start", log_hash)
    for row in effects:
        row |= {"name": cause_name(row), "parameters": snapshot.parameters(row, flight["columns"])}
        for one in row["parameters"]:
            one["text"] = interval_text(one["value"], one["std"], unit_text(row["effect"], one["name"]))
    flights = vehicle_flights(snapshot, flight)
    number = next((one["number"] for one in flights if one["log_hash"] == log_hash), 0)
    current = snapshot.row("FROM current WHERE vehicle = ?", flight["vehicle"]) or flight
    return flight | {
        "number": number, "num_flights": len(flights), "effects": effects,
        "previous": flights[number - 2]["log_hash"] if number > 1 else None,
        "next": flights[number]["log_hash"] if 0 < number < len(flights) else None,
        **{name: [_sentence(one) for one in json.loads(flight[name] or "[]")] for name in ("checks", "events")},
        "report": report_link(snapshot.tables.out, current, flights, number),
    }  # fmt: skip


def report_link(out: Path, current: Row, flights: list[Row], number: int) -> Content:
    """Return whether the vehicle's report exists, and the command that makes it from flights around a flight.

    Flights of both sides of a change have no common model, so all are of the side of the flight.
    """
    onset, folder = (current.get("rejected") and current["onset_flight"]) or 1, report_folder(out, current["vehicle"])
    side = [one for one in flights if one["number"] != number and (one["number"] >= onset) == (number >= onset)]
    near = sorted(side, key=lambda one: abs(one["number"] - number))[:TRAIN_FLIGHTS]
    train = " ".join(shlex.quote(one["path"]) for one in sorted(near, key=lambda one: one["number"]))
    test = shlex.quote(flights[number - 1]["path"]) if number and near else ""
    command = f"aerial-gym close-loop --robot ROBOT.yaml --train {train} --test {test} --out {shlex.quote(str(folder))}"
    return {"exists": (folder / "report.html").is_file(), "command": command if test else ""}


def _sentence(finding: Row) -> str:
    """Return the sentence of a finding; its code in words if another version wrote it."""
    try:
        return text(Finding(finding["code"], finding["subject"], finding["values"]))
    except (KeyError, ValueError, TypeError, AttributeError):
        parts = (str(finding.get("subject", "")), str(finding.get("code", finding)).replace("_", " "))
        return ": ".join(filter(None, parts))


def _key(own: Row) -> tuple[str, str, str]:
    return own["vehicle"], own["robot_hash"], own["model_version"]


def _pages(count: int, options: Options) -> Content:
    """Return the number of pages of a table, and the page that is asked for or the nearest one."""
    pages, asked = max(-(-count // PAGE_ROWS), 1), options.get("page", "1")
    return {"pages": pages, "page": min(max(int(asked), 1), pages) if asked.isdecimal() and len(asked) < 9 else 1}
