"""The report of a closed loop: one self-contained page, the same in Markdown, and the residuals as a table."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pandas as pd
from jinja2 import Environment, FileSystemLoader, StrictUndefined

from aerial_gym.physics import EFFECTS
from aerial_gym.sim2real.identify.selection.select import Selection
from aerial_gym.sim2real.identify.selection.structure import world_forces
from aerial_gym.sim2real.judge.analysis import Judged
from aerial_gym.sim2real.judge.evaluation import Evaluation
from aerial_gym.sim2real.judge.unexplained import with_best_deviations
from aerial_gym.sim2real.judge.whiteness import octave_names
from aerial_gym.sim2real.predict.channels import KINEMATIC, Channel
from aerial_gym.sim2real.predict.model_params import ModelParams
from aerial_gym.sim2real.predict.predictor import Predictor
from aerial_gym.sim2real.report import plots
from aerial_gym.sim2real.report.tables import (
    became_rows,
    channel_rows,
    flight_rows,
    number,
    parameter_rows,
    regime_rows,
    rival_rows,
    rollout_rows,
    trial_rows,
    worth_rows,
)

SHOWN_NOTES = 5
"""The others are folded away."""

SHOWN_RIVALS = 3
"""The others are folded away."""

MOST_MODELS = 5
"""Sets of effects that are told of those chosen on flights drawn again."""

MOST_REMAINING = 3
"""Channels of which the rest is drawn."""

TEMPLATES = Path(__file__).parent / "templates"

VARIANTS = {
    "free": "Everything simulated from the measured state at the start of a window",
    "given_attitude": "Attitude and angular velocity given by the log, position and velocity simulated",
}


def write_report(folder: Path, judged: Judged) -> None:
    """Write report.html, report.md and residuals.csv."""
    context = report_context(judged)
    for name in ("report.html", "report.md"):
        (folder / name).write_text(render(name, context), encoding="utf-8")
    after = judged.params if judged.verdict.corrects else None
    write_residuals(
        folder / "residuals.csv",
        {"train": judged.declared.train, "test": judged.declared.test},
        judged.declared.params,
        after,
    )


def render(name: str, context: dict[str, object]) -> str:
    """Return a template of this package, filled."""
    environment = Environment(
        loader=FileSystemLoader(TEMPLATES),
        autoescape=name.endswith(".html"),
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
        keep_trailing_newline=True,
    )
    environment.filters["num"] = number
    return environment.get_template(f"{name}.j2").render(context)


def report_context(judged: Judged) -> dict[str, object]:
    """Return everything that the templates show."""
    verdict, selection = judged.verdict, judged.selection
    after = verdict.after if verdict.corrects else None
    shown = selection.accepted or tuple(trial.effect for trial in selection.rounds[0] if trial.scored)[:2]
    return {
        "verdict": verdict,
        "robot": judged.declared.stated,
        "bandwidth": judged.declared.bandwidth,
        "train": [flight.name for flight in judged.declared.train.flights],
        "test": [flight.name for flight in judged.declared.test.flights],
        "effects": parameter_rows(judged),
        "channels": channel_rows(verdict.before, after, verdict.outcomes),
        "worth": worth_rows(verdict),
        "octaves": octave_names(judged.declared.bandwidth),
        "regimes": regime_rows(verdict),
        "flights": flight_rows(verdict) if after else [],
        "models": list(verdict.inclusion.models.items())[:MOST_MODELS],
        "resamples": verdict.inclusion.resamples,
        "least": selection.criteria.material,
        "shown_rivals": SHOWN_RIVALS,
        "shown_notes": SHOWN_NOTES,
        "became": became_rows(verdict),
        "rollouts": [
            {"title": text, "driven_by": verdict.before.rollouts[name].driven_by, "rows": rollout_rows(verdict, name)}
            for name, text in VARIANTS.items()
            if name in verdict.before.rollout
        ],
        "rounds": [trial_rows(trials, judged.declared.channels) for trials in selection.rounds],
        "rivals": rival_rows(verdict),
        "criteria": vars(selection.criteria),
        "tolerances": vars(judged.declared.tolerances),
        "figures": figures(judged, after, shown),
    }


def figures(judged: Judged, after: Evaluation | None, shown: Sequence[str]) -> dict[str, list[dict[str, str]]]:
    """Return the figures of the page, by its sections."""
    before, final = judged.verdict.before, judged.params if after is not None else None
    evidence = []
    for effect in shown:
        point, neutral = evidence_point(judged.selection, effect, judged)
        image = plots.evidence(judged.declared.train, point, effect, neutral)
        evidence.append({"title": f"Evidence for {effect}", "image": image})
    bars = [{"title": "Residuals before and after", "image": plots.residual_bars(before, after)}]
    bars += [
        {"title": title, "image": plots.rollout_bars(before, after, variant)}
        for variant, title in VARIANTS.items()
        if variant in before.rollout
    ]
    rest = [
        {"title": f"What remains of the {channel.name.replace('_', ' ')}", "image": plots.what_remains(parts, channel)}
        for channel, parts in remaining(judged)
    ]
    kinds = dict.fromkeys(channel.kind for channel in judged.declared.channels)
    over_time = [
        {
            "title": f"Residual of the {kind.replace('_', ' ')} over time",
            "image": plots.residuals_over_time(judged.declared.test, judged.declared.params, final, kind),
        }
        for kind in kinds
    ]
    return {"evidence": evidence, "bars": bars, "rest": rest, "over_time": over_time}


def remaining(judged: Judged) -> list[tuple[Channel, list[plots.Rest]]]:
    """Return what the corrected model leaves of the channels that matter: those named, else the farthest above its floor."""
    channels, after, found = judged.declared.channels, judged.verdict.after, []
    dynamic = [place for place, channel in enumerate(channels) if channel.kind not in KINEMATIC]
    named = [place for place in dynamic if channels[place].name in judged.verdict.unexplained]
    floor = after.floor or (1.0,) * len(channels)
    above = {place: after.residual[place].value / max(floor[place], 1e-300) for place in named or dynamic}
    order = sorted(above, key=lambda place: -above[place])
    left = [
        (predictor, predictor.residuals(judged.params)) for predictor in (judged.declared.train, judged.declared.test)
    ]
    for place in order[: MOST_REMAINING if named else 1]:
        parts = []
        for predictor, residuals in left:
            for flight, time, residual in zip(predictor.flights, predictor.times, residuals, strict=True):
                turned = world_forces(flight, time, residual, channels)
                parts.append(plots.Rest(flight=flight, time=time, values=residual[:, place], world=turned[:, place]))
        found.append((channels[place], parts))
    return found


def evidence_point(selection: Selection, effect: str, judged: Judged) -> tuple[ModelParams, np.ndarray]:
    """Return the model that has the effect, and the effect's neutral parameters.

    With the deviations that were fitted beside it: without them the line of the fitted value misses what is left.
    """
    if effect in judged.declared.params.effects:
        neutral = judged.declared.params.effects[effect]
    else:
        neutral = np.array(EFFECTS.get(effect).neutral(judged.declared.stated))
    if effect in selection.accepted:
        return judged.within, neutral
    trial = next(trial for trial in selection.rounds[0] if trial.effect == effect)
    assert trial.scored is not None
    fit = trial.scored.fit
    return with_best_deviations(fit.point, fit, selection.weights.weight), neutral


def write_residuals(
    path: Path, predictors: dict[str, Predictor], before: ModelParams, after: ModelParams | None
) -> None:
    """Write measured minus predicted of every kept row: flight, set, t, and each channel before and after."""
    tables = []
    for name, predictor in predictors.items():
        points = {"before": before} if after is None else {"before": before, "after": after}
        residuals = {label: predictor.residuals(point) for label, point in points.items()}
        for index, flight in enumerate(predictor.flights):
            columns: dict[str, object] = {"flight": flight.name, "set": name, "t": predictor.times[index]}
            for place, channel in enumerate(predictor.channels):
                for label, values in residuals.items():
                    columns[f"{channel.kind}_{channel.axis}_{label}"] = values[index][:, place]
            tables.append(pd.DataFrame(columns))
    pd.concat(tables).to_csv(path, index=False, float_format="%.6g")
