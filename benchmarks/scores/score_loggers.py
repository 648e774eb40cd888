"""Scores of ``close-loop`` on logs as loggers write them, and on laws that are not the package's own.

    python -m benchmarks.undeclared --loggers px4 slow gaps late gps --cases 100 --workers 16 --out DIR [--json]
    python -m benchmarks.undeclared --laws other [--hover-only] --cases 100 --workers 16 --out DIR [--json]

Each logger gets ``--cases`` controls, with nothing hidden, and as many effects of moderate size in turn, each case with its own
seed and with the small errors ``LOGGED``. An effect counts if the log can show it: the evidence that the plant itself expects
(``benchmarks.undeclared.evidence``) exceeds ``SHOWN`` over every rival. A case whose result by the same code is in ``--out`` is
not flown again.

A false name is a material one that is not there, whatever the verdict. Three other statements are counted on their own: a
wrong name that the verdict ties with the hidden effect ("if it is X", "X may also be Y") says only that one of them is there,
an ambiguous verdict without the hidden effect is false even if it names nothing, and a residual model names no cause.
"""

import json
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from rich.console import Console
from rich.progress import track

from benchmarks.markdown import table
from benchmarks.scores.score_table import share_text
from benchmarks.scores.score_undeclared import Job, run_jobs, score_case
from benchmarks.undeclared.effects import CAUSES, EFFECTS, cause_names
from benchmarks.undeclared.evidence import SHOWN
from benchmarks.undeclared.loggers import LOGGERS
from benchmarks.undeclared.other_laws import OTHER_LAWS

Logger = Literal["rows", "px4", "slow", "gaps", "late", "gps"]
OPEN = ("ambiguous", "unexplained")
RESIDUAL_MODEL = "learned_residual"  # Among the effects of a verdict, but no cause
LIMITS = {
    "false name": "at most 1 %",
    "false name beside an effect": "at most 1 %",
    "shown effects named": "at least 85 %",
    "open controls": "at most 10 %",
}


@dataclass(frozen=True, kw_only=True)
class LoggerScoreCmd:
    """Score ``close-loop`` on logs of the undeclared plant as loggers write them."""

    loggers: tuple[Logger, ...] = ("rows",)  # How flights are recorded
    laws: Literal["own", "other"] = "own"  # Of the hidden effects: as the package has them, or other published ones
    hover_only: bool = False  # Training flights only hover
    cases: int = 100  # Controls, and effects, of each logger
    seed: int = 6000  # Of the first case; each case has the next one
    effects: tuple[str, ...] = ()  # Only these
    workers: int = 1  # Processes
    out: Path | None = None  # Folder that keeps the result of each case; an interrupted run continues
    json: bool = False  # One JSON object a line, the scores last

    def plan_jobs(self) -> list[Job]:
        """Return the controls and effects of each logger in turn."""
        jobs = []
        for logger in self.loggers:
            names = [
                name
                for name in self.effects or (EFFECTS if self.laws == "own" else OTHER_LAWS)
                if _can_record(logger, name)
            ]
            flights = sorted({CAUSES[name].needs for name in names})
            for i in range(self.cases):
                for hidden, needs in (((), flights[i % len(flights)]), ((names[i % len(names)],), ())):
                    features = (*needs, *(("hover",) if self.hover_only else ()))
                    jobs.append(
                        Job(hidden=hidden, size="moderate", seed=self.seed + i, nuisance=False, tracked=False, logged=True,
                            features=features, logger=logger)
                    )  # fmt: skip
        return jobs

    def run(self) -> int:
        """Score the cases and print the scores; return the exit status."""
        jobs, rows = self.plan_jobs(), []
        console = Console(stderr=True)
        scored = run_jobs(jobs, processes=self.workers, out=self.out, score=score_case)
        for row in track(scored, "cases", len(jobs), console=console):
            rows.append(row)
            if self.json:
                print(json.dumps(row), flush=True)
        scores = {logger: score_rows([row for row in rows if row["logger"] == logger]) for logger in self.loggers}
        print(json.dumps(scores) if self.json else scores_text(scores, rows))
        return 0


def _can_record(logger: str, name: str) -> bool:
    """Return whether the file of a logger has a place for what the effect needs."""
    return LOGGERS[logger].file == "csv" or not {"other", "ceiling"} & set(CAUSES[name].needs)


def score_rows(rows: list[dict]) -> dict[str, list[int]]:
    """Return for each score its number of cases and the number that they are counted among."""
    done = [row for row in rows if "error" not in row]
    controls, hidden = ([row for row in done if bool(row["effects"]) is kind] for kind in (False, True))
    shown = [row for row in hidden if can_show(row)]

    def share(hits: Iterable[bool]) -> list[int]:
        counted = list(hits)
        return [sum(counted), len(counted)]

    return {
        "false name": share(bool(_strangers(row)) for row in controls),
        "false name beside an effect": share(is_false(row) for row in hidden),
        "false name, certain": share(bool(_certain_strangers(row)) for row in hidden),
        "false name, ambiguous": share(is_false(row) and not _certain_strangers(row) for row in hidden),
        "wrong name tied with the effect": share(bool(_strangers_tied_with_truth(row)) for row in hidden),
        "residual model": share(RESIDUAL_MODEL in row["material"] for row in done),
        "effects shown": share(row in shown for row in hidden),
        "shown effects named": share(bool(set(row["material"]) & _causes(row)) for row in shown),
        "named, or ambiguous with it": share(bool(_offers(row) & _causes(row)) for row in hidden),
        "open controls": share(row["verdict"] in OPEN for row in controls),
        "errors": share("error" in row for row in rows),
    }


def can_show(row: dict) -> bool:
    """Return whether the log of a case can show its hidden effect, by the evidence that the plant expects."""
    return min(row["evidence"].values()) >= SHOWN


def _causes(row: dict) -> set[str]:
    return {cause for name in row["effects"] for cause in cause_names(name)}


def is_false(row: dict) -> bool:
    """Return whether the result of a hidden effect claims another one: by name, or by ambiguity without the hidden one."""
    lacks_truth = row["verdict"] == "ambiguous" and not _offers(row) & _causes(row)
    return lacks_truth or bool(_strangers(row) - _strangers_tied_with_truth(row))


def _strangers(row: dict) -> set[str]:
    """Return the material names that are not there; a residual model is no name."""
    return set(row["material"]) - _causes(row) - {RESIDUAL_MODEL}


def _certain_strangers(row: dict) -> set[str]:
    """Return the names that are not there and are not tied with another effect."""
    return {name for name in _strangers(row) if not row["ties"][name]}


def _strangers_tied_with_truth(row: dict) -> set[str]:
    """Return the names that are not there, but that the verdict ties with a hidden effect."""
    return {name for name in _strangers(row) if set(row["ties"][name]) & _causes(row)}


def _offers(row: dict) -> set[str]:
    """Return the effects that test flights show, and the candidates of an ambiguous verdict."""
    return {*row["material"], *(row["candidates"] if row["verdict"] == "ambiguous" else ())}


def scores_text(scores: dict[str, dict[str, list[int]]], rows: list[dict]) -> str:
    """Return the scores of each logger, and a table of the hidden effects, as markdown."""
    lines = [
        (logger, name, share_text(*share), LIMITS.get(name, "-"))
        for logger, own in scores.items()
        for name, share in own.items()
    ]
    cases = []
    for logger, name in sorted({(row["logger"], "+".join(row["effects"])) for row in rows if "error" not in row}):
        group = [
            row for row in rows if row["logger"] == logger and "+".join(row["effects"]) == name and "error" not in row
        ]
        shown = sum(can_show(row) for row in group) if name else "-"
        named = sum(bool(set(row["material"]) & _causes(row)) for row in group)
        strangers = sorted({one for row in group for one in _strangers(row)})
        verdicts = [row["verdict"] for row in group]
        counts = ", ".join(f"{verdicts.count(kind)} {kind}" for kind in sorted(set(verdicts)))
        cases.append((logger, name or "nothing", len(group), shown, named, ", ".join(strangers) or "-", counts))
    heads = ("logger", "hidden", "cases", "shown", "named", "other names", "verdicts")
    errors = sorted({f"{row['logger']}: {row['error'].partition(': ')[2]}" for row in rows if "error" in row})
    return "\n\n".join((table(("logger", "score", "cases", "limit"), lines), table(heads, cases), *errors))
