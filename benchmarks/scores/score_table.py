"""Summaries of scored cases as markdown: names, parameters, coverage, controls and unknown causes."""

from collections.abc import Callable

import numpy as np
from scipy.stats import beta

from benchmarks.undeclared import UNKNOWN

Row = dict
JUDGEMENTS = ("right", "near", "wrong", "missed", "error")


def clopper_pearson(hits: int, total: int, level: float = 0.95) -> tuple[float, float]:
    """Return the exact interval of a probability of which ``hits`` of ``total`` draws were seen.

    Source: C. Clopper, E. Pearson, "The use of confidence or fiducial limits illustrated in the case of the binomial",
    Biometrika 1934, through quantiles of the beta distribution.
    """
    tail = 0.5 * (1.0 - level)
    low = float(beta.ppf(tail, hits, total - hits + 1)) if hits else 0.0
    high = float(beta.ppf(1.0 - tail, hits + 1, total - hits)) if hits < total else 1.0
    return low, high


def share(hits: int, total: int) -> str:
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


def markdown(rows: list[Row]) -> str:
    """Return all tables that have a row."""
    hover = [r for r in rows if "hover" in r["features"]]
    rows = [r for r in rows if r not in hover]
    hidden = [r for r in rows if r["effects"] and not _unknown(r)]
    parts = [
        _names(hidden),
        _parameters(hidden),
        _controls([r for r in rows if not r["effects"]]),
        _hover(hover),
        _unknown_table([r for r in rows if _unknown(r)]),
        _time(rows),
    ]
    return "\n\n".join(part for part in parts if part)


def _unknown(row: Row) -> bool:
    return any(name in UNKNOWN for name in row["effects"])


def _groups(rows: list[Row], key: Callable[[Row], tuple[str, ...]]) -> dict[tuple[str, ...], list[Row]]:
    groups: dict[tuple[str, ...], list[Row]] = {}
    for row in rows:
        groups.setdefault(key(row), []).append(row)
    return groups


def _judgement(row: Row) -> str:
    return "error" if "error" in row else row["judgement"]


def _names(rows: list[Row]) -> str:
    """Return a row for each hidden effect: how often it is named right, by size, and the other judgements."""
    if not rows:
        return ""
    sizes = list(dict.fromkeys(row["size"] for row in rows))
    lines = ["## Which effects are named right?", "", f"| hidden | {' | '.join(sizes)} | the others |"]
    lines.append("| --- | --- |" + " --- |" * len(sizes))
    groups = {name: group for (name,), group in _groups(rows, lambda r: (r["hidden"],)).items()}
    groups["all"] = [{**row, "named": []} for row in rows]
    for name, group in groups.items():
        by_size = {size: [r for r in group if r["size"] == size] for size in sizes}
        right = [f"{sum(_judgement(r) == 'right' for r in cases)} of {len(cases)}" for cases in by_size.values()]
        rest = "; ".join(f"{size}: {text}" for size, cases in by_size.items() if (text := _other_judgements(cases)))
        lines.append(f"| {name} | {' | '.join(right)} | {rest or '-'} |")
    return "\n".join(lines)


def _other_judgements(rows: list[Row]) -> str:
    """Return the judgements of cases that are not right, each with its number and the names that were given."""
    parts = []
    for judgement in JUDGEMENTS[1:]:
        group = [r for r in rows if _judgement(r) == judgement]
        names = ", ".join(sorted({"+".join(r["named"]) for r in group if r["named"]}))
        if group:
            parts.append(f"{len(group)} {judgement}" + (f" ({names})" if names else ""))
    return ", ".join(parts)


def _parameters(rows: list[Row]) -> str:
    """Return errors and coverage of the parameters of effects that were named, whatever else was."""
    parameters = [(r["size"], p) for r in rows for p in r.get("parameters", [])]
    if not parameters:
        return ""
    lines = [
        "## How accurate are the parameters?",
        "",
        "Error: |estimate - truth| in SI units, over the effects that were named. Coverage: cases whose 95 % interval "
        "contains the true value, with the Clopper-Pearson interval of that share.",
        "",
        "| effect | parameter | number | median error | largest error | median relative error | coverage |",
        "| --- | --- | --- | --- | --- | --- | --- |",
    ]
    groups: dict[tuple[str, str], list[dict]] = {}
    for _, p in parameters:
        groups.setdefault((p["effect"], p["name"]), []).append(p)
    for (effect, name), group in groups.items():
        error = np.array([abs(p["value"] - p["true"]) for p in group])
        true = np.array([abs(p["true"]) for p in group])
        relative = np.median(error[true > 0.0] / true[true > 0.0]) if np.any(true > 0.0) else np.nan
        cover = share(sum(_covers_truth(p) for p in group), len(group))
        lines.append(
            f"| {effect} | {name} | {len(group)} | {np.median(error):.3g} | {error.max():.3g} | {relative:.2%} | {cover} |"
        )
    total = share(sum(_covers_truth(p) for _, p in parameters), len(parameters))
    lines.append(f"| all | all | {len(parameters)} | - | - | - | {total} |")
    return "\n".join(lines)


def _covers_truth(parameter: dict) -> bool:
    return abs(parameter["value"] - parameter["true"]) < 1.96 * parameter["std"]


def _hover(rows: list[Row]) -> str:
    if not rows:
        return ""
    lines = [
        "## What do flights show that only hover?",
        "",
        "| hidden | seed | verdict | named | candidates |",
    ]
    lines.append("| --- | --- | --- | --- | --- |")
    for r in rows:
        names = [", ".join(r.get(key, [])) or "-" for key in ("named", "candidates")]
        lines.append(f"| {r['hidden']} | {r['seed']} | {r['verdict']} | {names[0]} | {names[1]} |")
    return "\n".join(lines)


def _controls(rows: list[Row]) -> str:
    if not rows:
        return ""
    lines = [
        "## Are there false alarms?",
        "",
        "| flights | cases | false alarms | named |",
        "| --- | --- | --- | --- |",
    ]
    for (flights,), group in _groups(rows, lambda r: (" ".join(r["features"]) or "plain",)).items():
        alarms = [r for r in group if _judgement(r) == "false alarm"]
        named = ", ".join(sorted({"+".join(r["named"]) for r in alarms})) or "-"
        lines.append(f"| {flights} | {len(group)} | {share(len(alarms), len(group))} | {named} |")
    return "\n".join(lines)


def _unknown_table(rows: list[Row]) -> str:
    if not rows:
        return ""
    lines = ["## Do unknown causes get a wrong name?", ""]
    lines += ["| cause | size | cases | given the name of an effect | which | verdicts | structure |"]
    lines += ["| --- | --- | --- | --- | --- | --- | --- |"]
    for (name, size), group in _groups(rows, lambda r: (r["hidden"], r["size"])).items():
        given = [r for r in group if _judgement(r) == "given a name"]
        names = ", ".join(sorted({"+".join(r["named"]) for r in given})) or "-"
        verdicts = ", ".join(sorted({r["verdict"] for r in group}))
        kinds = ", ".join(sorted({str((r.get("structure") or {}).get("kind", "-")) for r in group}))
        lines.append(
            f"| {name} | {size} | {len(group)} | {share(len(given), len(group))} | {names} | {verdicts} | {kinds} |"
        )
    return "\n".join(lines)


def _time(rows: list[Row]) -> str:
    timed = [r for r in rows if "loop_s" in r]
    if not timed:
        return ""
    fly, loop = (np.array([r[key] for r in timed]) for key in ("fly_s", "loop_s"))
    return (
        f"Time of a case: {np.median(fly):.0f} s to fly (at most {fly.max():.0f}), {np.median(loop):.0f} s in the loop "
        f"(at most {loop.max():.0f})."
    )
