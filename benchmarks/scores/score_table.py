"""Summaries of scored cases as markdown: names, parameters, coverage, controls and unknown causes."""

from collections.abc import Callable, Hashable, Iterable
from typing import TypeVar

import numpy as np
from scipy.stats import binomtest

from benchmarks.markdown import table
from benchmarks.undeclared import UNKNOWN

Row = dict
Item = TypeVar("Item")
Key = TypeVar("Key", bound=Hashable)
JUDGEMENTS = ("right", "near", "wrong", "missed", "error")


def clopper_pearson(hits: int, total: int) -> tuple[float, float]:
    """Return the exact 95 % interval of a probability of which ``hits`` of ``total`` draws were seen.

    Source: C. Clopper, E. Pearson, "The use of confidence or fiducial limits illustrated in the case of the binomial",
    Biometrika 1934.
    """
    interval = binomtest(hits, total).proportion_ci(method="exact")
    return float(interval.low), float(interval.high)


def share_text(hits: int, total: int) -> str:
    """Return ``hits of total (percentage, its 95 % interval)``."""
    if not total:
        return "-"
    low, high = clopper_pearson(hits, total)
    return f"{hits} of {total} ({100 * hits / total:.0f} %, {100 * low:.0f} to {100 * high:.0f})"


def right_line(rows: list[Row]) -> str:
    """Return the totals in one line."""
    inside, total = sum(r.get("inside", 0) for r in rows), sum(r.get("intervals", 0) for r in rows)
    right = sum(bool(r["right"]) for r in rows)
    return f"right {right} of {len(rows)}; true value inside {inside} of {total} intervals"


def result_tables(rows: list[Row]) -> str:
    """Return all tables that have a row."""
    hover = [r for r in rows if "hover" in r["features"]]
    rows = [r for r in rows if r not in hover]
    unknown = [r for r in rows if any(name in UNKNOWN for name in r["effects"])]
    known = [r for r in rows if r["effects"] and r not in unknown]
    controls = [r for r in rows if not r["effects"]]
    parts = [
        _name_table(known) if known else "",
        _parameter_table(known),
        _control_table(controls) if controls else "",
        _hover_table(hover) if hover else "",
        _unknown_table(unknown) if unknown else "",
        _time_line(rows),
    ]
    return "\n\n".join(part for part in parts if part)


def _group(items: Iterable[Item], key: Callable[[Item], Key]) -> dict[Key, list[Item]]:
    groups: dict[Key, list[Item]] = {}
    for item in items:
        groups.setdefault(key(item), []).append(item)
    return groups


def _judgement(row: Row) -> str:
    return "error" if "error" in row else row["judgement"]


def _name_list(rows: list[Row]) -> str:
    """Return the combinations of names that were given, each once."""
    return ", ".join(sorted({"+".join(r["named"]) for r in rows if r["named"]}))


def _name_table(rows: list[Row]) -> str:
    """Return a row for each hidden effect: how often it is named right, by size, and the other judgements."""
    sizes = list(dict.fromkeys(row["size"] for row in rows))
    groups = _group(rows, lambda r: r["hidden"]) | {"all": [{**row, "named": []} for row in rows]}
    lines = []
    for name, group in groups.items():
        by_size = {size: [r for r in group if r["size"] == size] for size in sizes}
        right = [f"{sum(_judgement(r) == 'right' for r in cases)} of {len(cases)}" for cases in by_size.values()]
        rest = "; ".join(f"{size}: {text}" for size, cases in by_size.items() if (text := _other_judgements(cases)))
        lines.append((name, *right, rest or "-"))
    return f"## Which effects are named right?\n\n{table(('hidden', *sizes, 'the others'), lines)}"


def _other_judgements(rows: list[Row]) -> str:
    """Return the judgements of cases that are not right, each with its number and the names that were given."""
    parts = []
    for judgement in JUDGEMENTS[1:]:
        group = [r for r in rows if _judgement(r) == judgement]
        if group:
            names = _name_list(group)
            parts.append(f"{len(group)} {judgement}" + (f" ({names})" if names else ""))
    return ", ".join(parts)


def _parameter_table(rows: list[Row]) -> str:
    """Return errors and coverage of the parameters of effects that were named, whatever else was."""
    parameters = [p for r in rows for p in r.get("parameters", [])]
    if not parameters:
        return ""
    lines = []
    for (effect, name), group in _group(parameters, lambda p: (p["effect"], p["name"])).items():
        error = np.array([abs(p["value"] - p["true"]) for p in group])
        true = np.array([abs(p["true"]) for p in group])
        relative = np.median(error[true > 0.0] / true[true > 0.0]) if np.any(true > 0.0) else np.nan
        figures = f"{np.median(error):.3g}", f"{error.max():.3g}", f"{relative:.2%}"
        lines.append((effect, name, len(group), *figures, _coverage(group)))
    lines.append(("all", "all", len(parameters), "-", "-", "-", _coverage(parameters)))
    heads = ("effect", "parameter", "number", "median error", "largest error", "median relative error", "coverage")
    return (
        "## How accurate are the parameters?\n\n"
        "Error: |estimate - truth| in SI units, over the effects that were named. Coverage: cases whose 95 % interval "
        f"contains the true value, with the Clopper-Pearson interval of that share.\n\n{table(heads, lines)}"
    )


def _coverage(parameters: list[dict]) -> str:
    """Return the share of parameters whose 95 % interval contains the true value."""
    inside = sum(abs(p["value"] - p["true"]) < 1.96 * p["std"] for p in parameters)
    return share_text(inside, len(parameters))


def _hover_table(rows: list[Row]) -> str:
    lines = [
        (r["hidden"], r["seed"], r["verdict"], *(", ".join(r.get(key, [])) or "-" for key in ("named", "candidates")))
        for r in rows
    ]
    heads = ("hidden", "seed", "verdict", "named", "candidates")
    return f"## What do flights show that only hover?\n\n{table(heads, lines)}"


def _control_table(rows: list[Row]) -> str:
    lines = []
    for flights, group in _group(rows, lambda r: " ".join(r["features"]) or "plain").items():
        alarms = [r for r in group if _judgement(r) == "false alarm"]
        lines.append((flights, len(group), share_text(len(alarms), len(group)), _name_list(alarms) or "-"))
    return f"## Are there false alarms?\n\n{table(('flights', 'cases', 'false alarms', 'named'), lines)}"


def _unknown_table(rows: list[Row]) -> str:
    lines = []
    for (name, size), group in _group(rows, lambda r: (r["hidden"], r["size"])).items():
        given = [r for r in group if _judgement(r) == "given a name"]
        verdicts = ", ".join(sorted({r["verdict"] for r in group}))
        kinds = ", ".join(sorted({str((r.get("structure") or {}).get("kind", "-")) for r in group}))
        given_share, names = share_text(len(given), len(group)), _name_list(given) or "-"
        lines.append((name, size, len(group), given_share, names, verdicts, kinds))
    heads = ("cause", "size", "cases", "given the name of an effect", "which", "verdicts", "structure")
    return f"## Do unknown causes get a wrong name?\n\n{table(heads, lines)}"


def _time_line(rows: list[Row]) -> str:
    timed = [r for r in rows if "loop_s" in r]
    if not timed:
        return ""
    fly, loop = (np.array([r[key] for r in timed]) for key in ("fly_s", "loop_s"))
    return (
        f"Time of a case: {np.median(fly):.0f} s to fly (at most {fly.max():.0f}), {np.median(loop):.0f} s in the loop "
        f"(at most {loop.max():.0f})."
    )
