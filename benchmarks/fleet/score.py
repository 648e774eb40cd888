"""Scores of ``aerial-gym fleet run`` on a synthetic fleet: ``python -m benchmarks.fleet.score --fleet DIR --tables DIR``.

A vehicle counts as found if its change is reported with the right cause, for one rotor also the right rotor, and as falsely
reported if it has none or if the cause named is another one. ``ambiguous`` counts as found if the right cause leads or ties.
"""

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import tyro

from benchmarks.markdown import table
from benchmarks.undeclared.effects import cause_names, effect_parameters
from benchmarks.undeclared.vehicle import DECLARED

OF_ONE_ROTOR = ("weak_motor", "motor_tilt")


@dataclass(frozen=True, kw_only=True)
class FleetScore:
    """Scores of one fleet."""

    vehicles: int
    changed: int
    num_found: int  # Changed vehicles whose change is reported with the right cause
    reported: int  # Vehicles of which a change is reported
    false: int  # Of these, those without a change or with another cause
    ambiguous: int  # Found ones whose cause is one of several
    onset_errors: tuple[int, ...]  # Reported onset minus the true one, of the found ones [flights]

    @property
    def recall(self) -> float:
        """Share of the changed vehicles that were found."""
        return self.num_found / self.changed if self.changed else 1.0

    @property
    def false_discovery(self) -> float:
        """Share of the reports that are false."""
        return self.false / self.reported if self.reported else 0.0

    @property
    def median_onset_error(self) -> float:
        """Median distance of the reported onset from the true one [flights]; not a number without any."""
        return float(np.median(np.abs(self.onset_errors))) if self.onset_errors else float("nan")


def score_fleet(truth: Mapping[str, Any], verdicts: Sequence[Mapping[str, Any]], size: str) -> FleetScore:
    """Return the scores of verdicts, rows of the table, on what a fleet hides."""
    hidden, num_found, false, unsure, errors = truth["changed"], 0, 0, 0, []
    reports = {row["vehicle"]: row for row in verdicts if row["rejected"]}
    for name, row in reports.items():
        plan = hidden.get(name)
        if plan is None or not _names_cause(row, plan, size):
            false += 1
            continue
        num_found += 1
        unsure += row["verdict"] == "ambiguous"
        errors.append(int(row["onset_flight"]) - plan["onset"])
    return FleetScore(
        vehicles=len({row["vehicle"] for row in verdicts}), changed=len(hidden), num_found=num_found, reported=len(reports),
        false=false, ambiguous=unsure, onset_errors=tuple(errors),
    )  # fmt: skip


def _names_cause(row: Mapping[str, Any], plan: Mapping[str, Any], size: str) -> bool:
    """Return whether a verdict names the hidden cause: alone, or among those that it cannot distinguish."""
    causes = json.loads(row["causes"])
    said = [cause for cause in causes if cause["candidate"]]
    right = [cause for cause in said if cause["effect"] in cause_names(plan["cause"])]
    if plan["cause"] not in OF_ONE_ROTOR:
        return bool(right)
    hidden = effect_parameters({plan["cause"]: size}, declared=DECLARED, seed=plan["seed"])[plan["cause"]]
    return any(cause["rotor"] == int(hidden["motor"]) for cause in right)


@dataclass(frozen=True, kw_only=True)
class FleetScoreCmd:
    """Score the verdicts on a synthetic fleet."""

    fleet: Path  # Folder that ``benchmarks.fleet.flights`` wrote
    tables: Path  # Folder that ``aerial-gym fleet run`` wrote
    size: str = "moderate"  # Final size of each cause, as flown

    def run(self) -> int:
        """Print the scores; return the exit status."""
        from deltalake import DeltaTable

        truth = json.loads((self.fleet / "truth.json").read_text(encoding="utf-8"))
        verdicts = DeltaTable(self.tables / "verdicts").to_pyarrow_table().to_pylist()
        score = score_fleet(truth, verdicts, self.size)
        print(table(("figure", "value", "limit"), [
            ("vehicles, changed", f"{score.vehicles}, {score.changed}", ""),
            ("recall", f"{score.recall:.1%} ({score.num_found}, of which {score.ambiguous} ambiguous)", "95 %"),
            ("false discovery", f"{score.false_discovery:.1%} ({score.false} of {score.reported})", "1 %"),
            ("median error of the onset [flights]", f"{score.median_onset_error:g}", "2"),
        ]))  # fmt: skip
        reports = {row["vehicle"]: row for row in verdicts}
        for name, plan in truth["changed"].items():
            said = reports.get(name, {}).get("text", "no verdict")
            print(f"{name}: {plan['cause']}, {plan['kind']} at flight {plan['onset']}: {said}")
        for name, row in reports.items():
            if row["rejected"] and name not in truth["changed"]:
                print(f"{name}: healthy: {row['text']}")
        return 0


if __name__ == "__main__":
    raise SystemExit(tyro.cli(FleetScoreCmd, description=__doc__).run())
