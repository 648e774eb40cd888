"""Report of a closed loop: one self-contained page, the same in Markdown, and tables of its data."""

import csv
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from aerial_gym.sim2real.judge.analysis import LoopResult
from aerial_gym.sim2real.judge.answer import answer_parts, trust_findings
from aerial_gym.sim2real.judge.evaluation import reason_against_rollouts
from aerial_gym.sim2real.judge.whiteness import octave_ranges
from aerial_gym.sim2real.predict.model_params import ModelParams
from aerial_gym.sim2real.predict.predictor import Predictor
from aerial_gym.sim2real.report.evidence import ParameterEvidence, write_evidence
from aerial_gym.sim2real.report.figures import (
    VARIANTS,
    evidence_of_effects,
    kinds_to_plot,
    report_figures,
    report_models,
)
from aerial_gym.sim2real.report.page import write_page
from aerial_gym.sim2real.report.profiles import LABELS, ResidualProfile, mean_residual_profiles, write_profiles
from aerial_gym.sim2real.report.tables import (
    SHOWN_NOTES,
    channel_rows,
    channels_by_outcome,
    flight_table,
    parameter_rows,
    reason_rows,
    rejection_rows,
    rollout_rows,
    text_rows_of_effects,
)
from aerial_gym.sim2real.wording import answer_texts, join_texts, text

SHOWN_RIVALS = 3  # Number of rivals that are not folded
MOST_SETS = 5  # Number of listed sets of effects, the most probable ones


def write_report(folder: Path, judged: LoopResult) -> None:
    """Write report.html, report.md and the tables of their data: residuals.csv, profiles.csv, evidence.csv."""
    test, models = judged.declared.test, report_models(judged)
    residual_profiles = mean_residual_profiles(test, models)
    told = evidence_of_effects(judged)
    context = report_context(judged, told, residual_profiles)
    for name in ("report.html", "report.md"):
        write_page(folder / name, name, context)
    write_evidence(folder / "evidence.csv", told)
    write_profiles(folder / "profiles.csv", residual_profiles, test.channels)
    write_residuals(folder / "residuals.csv", {"train": judged.declared.train, "test": test}, models)


def report_context(
    judged: LoopResult, told: Mapping[str, list[ParameterEvidence]], residual_profiles: Sequence[ResidualProfile]
) -> dict[str, object]:
    """Return the values for the templates."""
    verdict, selection = judged.verdict, judged.selection
    after = verdict.after if verdict.corrects else None
    return {
        "verdict": verdict,
        "answer": answer_texts(answer_parts(verdict)),
        "meaning": join_texts(trust_findings(verdict)),
        "robot": judged.declared.stated,
        "bandwidth": judged.declared.bandwidth,
        "train": [flight.name for flight in judged.declared.train.flights],
        "test": [flight.name for flight in judged.declared.test.flights],
        "effects": parameter_rows(judged),
        "channels": channel_rows(verdict.before, after, verdict.outcomes),
        "octaves": octave_ranges(judged.declared.bandwidth),
        "flights": flight_table(verdict, kinds_to_plot(judged)),
        "sets": list(verdict.sets.items())[:MOST_SETS],
        "least": selection.criteria.material,
        "shown_rivals": SHOWN_RIVALS,
        "shown_notes": SHOWN_NOTES,
        "became": channels_by_outcome(verdict),
        "named": text_rows_of_effects(verdict),
        "reasons": reason_rows({name: text(reason) for name, reason in verdict.not_testable.items()}),
        "unshowable": [name for name, advice in verdict.fly_next.items() if advice.fly is None],
        "no_rollouts": reason_against_rollouts(judged.declared.test.flights),
        "notes": [text(note) for note in verdict.notes],
        "rollouts": [
            {"title": text, "driven_by": verdict.before.rollouts[name].driven_by, "rows": rollout_rows(verdict, name)}
            for name, text in VARIANTS.items()
            if name in verdict.before.rollout
        ],
        "unnamed": rejection_rows(selection),
        "criteria": vars(selection.criteria),
        "tolerances": vars(judged.declared.tolerances),
        "figures": report_figures(judged, told, residual_profiles),
    }


def write_residuals(path: Path, predictors: dict[str, Predictor], models: Mapping[str, ModelParams]) -> None:
    """Write every kept row: flight, set, t, each measured channel and its residual under each model.

    The declared model is named before, the corrected one after.
    """
    kinds = ("measured", *(LABELS[model] for model in models))
    with path.open("w", encoding="utf-8", errors="surrogateescape", newline="") as file:
        table = csv.writer(file, lineterminator="\n")
        channels = next(iter(predictors.values())).channels
        names = [f"{channel.kind}_{channel.axis}_{kind}" for channel in channels for kind in kinds]
        table.writerow(["flight", "set", "t", *names])
        for name, predictor in predictors.items():
            values = [predictor.measured, *(predictor.residuals(params) for params in models.values())]
            for flight, time, *parts in zip(predictor.flights, predictor.times, *values, strict=True):
                rows = np.column_stack((time, np.stack(parts, axis=2).reshape(len(time), -1)))
                table.writerows([flight.name, name, *(f"{value:.6g}" for value in row)] for row in rows.tolist())
