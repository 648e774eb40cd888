"""The report of a closed loop: one self-contained page, the same in Markdown, and the residuals as a table."""

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import pandas as pd
from jinja2 import Environment, FileSystemLoader, StrictUndefined

from aerial_gym.physics import EFFECTS
from aerial_gym.sim2real import plots
from aerial_gym.sim2real.evaluation import Evaluation
from aerial_gym.sim2real.intervals import Rms
from aerial_gym.sim2real.prediction import Channel, Point, Predictor
from aerial_gym.sim2real.rollout import QUANTITIES
from aerial_gym.sim2real.selection import Selection, Trial
from aerial_gym.sim2real.verdict import MEANINGS

if TYPE_CHECKING:
    from aerial_gym.sim2real.close_loop import Analysis

TEMPLATES = Path(__file__).parent / "templates"

VARIANTS = {
    "free": "Everything simulated from the measured state at the start of a window",
    "given_attitude": "Attitude and angular velocity given by the log, position and velocity simulated",
}


def write_report(folder: Path, analysis: "Analysis") -> None:
    """Write report.html, report.md and residuals.csv."""
    context = report_context(analysis)
    for name in ("report.html", "report.md"):
        (folder / name).write_text(render(name, context), encoding="utf-8")
    after = analysis.final if analysis.selection.accepted else None
    write_residuals(
        folder / "residuals.csv",
        {"train": analysis.train_predictor, "test": analysis.test_predictor},
        analysis.declared,
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


def number(value: float, digits: int = 3) -> str:
    """Return a number for people: three significant digits."""
    return "–" if not np.isfinite(value) else f"{value:.{digits}g}"


def interval(rms: Rms) -> str:
    """Return a value with its 95 % interval."""
    return f"{number(rms.value)} [{number(rms.low)}, {number(rms.high)}]"


def report_context(analysis: "Analysis") -> dict[str, object]:
    """Return everything that the templates show."""
    verdict, selection = analysis.verdict, analysis.selection
    after = verdict.after if selection.accepted else None
    shown = selection.accepted or tuple(trial.effect for trial in selection.rounds[0] if trial.scored)[:2]
    return {
        "verdict": verdict,
        "meaning": MEANINGS[verdict.verdict],
        "robot": analysis.robot,
        "bandwidth": analysis.bandwidth,
        "train": [flight.name for flight in analysis.train],
        "test": [flight.name for flight in analysis.test],
        "effects": parameter_rows(analysis),
        "channels": channel_rows(verdict.before, after),
        "rollouts": [
            {"title": text, "driven_by": verdict.before.rollouts[name].driven_by, "rows": rollout_rows(verdict, name)}
            for name, text in VARIANTS.items()
            if name in verdict.before.rollout
        ],
        "rounds": [trial_rows(trials, analysis.channels) for trials in selection.rounds],
        "rivals": {name: trial_rows(selection.rivals[name], analysis.channels) for name in selection.accepted},
        "criteria": vars(selection.criteria),
        "tolerances": vars(analysis.train_predictor.tolerances),
        "figures": figures(analysis, after, shown),
    }


def parameter_rows(analysis: "Analysis") -> list[dict[str, object]]:
    """Return one row per parameter of the accepted effects."""
    rows = []
    for effect in analysis.verdict.effects:
        declared = analysis.robot.effects.get(effect.name, {})
        neutral = EFFECTS.get(effect.name).neutral(analysis.robot)
        for place, parameter in enumerate(EFFECTS.get(effect.name).parameters):
            value, std = effect.params[parameter.name], effect.std.get(parameter.name)
            rows.append(
                {
                    "effect": effect.name,
                    "parameter": parameter.name,
                    "unit": parameter.unit,
                    "declared": declared.get(parameter.name, neutral[place]),
                    "value": value,
                    "low": None if std is None else value - 1.96 * std,
                    "high": None if std is None else value + 1.96 * std,
                    "confidence": effect.confidence,
                }
            )
    return rows


def channel_rows(before: Evaluation, after: Evaluation | None) -> list[dict[str, object]]:
    """Return one row per channel."""
    rows = []
    for place, channel in enumerate(before.channels):
        first = before.residual[place]
        second = None if after is None else after.residual[place]
        rows.append(
            {
                "name": f"{channel.kind.replace('_', ' ')} {channel.axis} [{channel.unit}]",
                "before": interval(first),
                "after": "–" if second is None else interval(second),
                "change": "–" if second is None else f"{100.0 * (second.value / first.value - 1.0):+.0f} %",
                "floor": "–" if before.floor is None else number(before.floor[place]),
            }
        )
    return rows


def rollout_rows(verdict: object, variant: str) -> list[dict[str, str]]:
    """Return one row per quantity and horizon."""
    before, after = verdict.before.rollout[variant], verdict.after.rollout[variant]  # type: ignore[attr-defined]
    return [
        {
            "quantity": f"{quantity} [{QUANTITIES[quantity]}]",
            "horizon": f"{horizon:g}",
            "before": interval(rms),
            "after": interval(after[quantity][horizon]),
        }
        for quantity, horizons in before.items()
        for horizon, rms in horizons.items()
    ]


def trial_rows(trials: Sequence[Trial], channels: Sequence[Channel]) -> list[dict[str, str]]:
    """Return one row per trial: what it explained of which residual, and why it was or was not accepted."""
    rows = []
    passed = next((trial.effect for trial in trials if not trial.objections), None)
    for trial in trials:
        gain = trial.gain
        outcome = "; ".join(trial.objections) or ("best" if trial.effect == passed else "passes, but scores less")
        best = None if gain is None else int(np.argmax(gain.falls))
        rows.append(
            {
                "effect": trial.effect,
                "score": "–" if gain is None else f"{gain.score:.0f}",
                "share": "–" if gain is None or best is None else f"{explained(gain.falls[best]):.0%}",
                "channel": "–" if best is None else channels[best].name,
                "flights": "–" if gain is None else f"{gain.flights_better:.0%}",
                "probability": "–" if gain is None else f"{trial.probability:.1e}",
                "objections": outcome,
            }
        )
    return rows


def explained(fall: float) -> float:
    """Return the share of a mean square that a relative fall of the rms takes away."""
    return max(0.0, 1.0 - (1.0 - fall) ** 2)


def figures(analysis: "Analysis", after: Evaluation | None, shown: Sequence[str]) -> list[dict[str, str]]:
    """Return the figures of the page."""
    before, final = analysis.verdict.before, analysis.final if after is not None else None
    kinds = dict.fromkeys(channel.kind for channel in analysis.channels)
    found = [{"title": "Before and after", "image": plots.residual_bars(before, after)}]
    for variant, title in VARIANTS.items():
        if variant in before.rollout:
            found.append({"title": title, "image": plots.rollout_bars(before, after, variant)})
    for effect in shown:
        point, neutral = evidence_point(analysis.selection, effect, analysis)
        image = plots.evidence(analysis.train_predictor, point, effect, neutral)
        found.append({"title": f"Evidence for {effect}", "image": image})
    for kind in kinds:
        image = plots.residuals_over_time(analysis.test_predictor, analysis.declared, final, kind)
        found.append({"title": f"Residual of the {kind.replace('_', ' ')}", "image": image})
    return found


def evidence_point(selection: Selection, effect: str, analysis: "Analysis") -> tuple[Point, np.ndarray]:
    """Return the model that has the effect, and the effect's neutral parameters."""
    if effect in analysis.declared.effects:
        neutral = analysis.declared.effects[effect]
    else:
        neutral = np.array(EFFECTS.get(effect).neutral(analysis.robot))
    if effect in selection.accepted:
        return analysis.final, neutral
    trial = next(trial for trial in selection.rounds[0] if trial.effect == effect)
    assert trial.scored is not None
    return trial.scored.fit.point, neutral


def write_residuals(path: Path, predictors: dict[str, Predictor], before: Point, after: Point | None) -> None:
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
