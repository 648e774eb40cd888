"""Text tables for the templates of a report."""

from collections.abc import Collection, Mapping, Sequence
from typing import Any

import numpy as np

from aerial_gym.physics import EFFECTS
from aerial_gym.sim2real.findings import Finding
from aerial_gym.sim2real.identify.selection.select import SelectionResult
from aerial_gym.sim2real.judge.analysis import LoopResult
from aerial_gym.sim2real.judge.evaluation import ModelEvaluation
from aerial_gym.sim2real.judge.outcome import BETTER, NOT_SHOWN, SAME, WORSE, Outcome
from aerial_gym.sim2real.judge.verdict import Verdict
from aerial_gym.sim2real.predict.rollout import QUANTITIES
from aerial_gym.sim2real.statistics import Rise, Rms
from aerial_gym.sim2real.wording import text
from aerial_gym.sim2real.wording.words import error_name, number_text

SHOWN_NOTES = 5  # Number of notes that are not folded, the most important ones
MOST_PERCENT = 3.0  # Rise above which it is written as a factor


def parameter_rows(judged: LoopResult) -> list[dict[str, object]]:
    """Return one row per parameter of the accepted effects."""
    rows = []
    for effect in judged.verdict.effects:
        declared = judged.declared.stated.effects.get(effect.name, {})
        known = EFFECTS.get(effect.name)
        pairs = zip(known.parameters, known.neutral(judged.declared.stated), strict=True)
        shown = [pair for pair in pairs if pair[0].name in effect.params]  # optional ones may be left out
        for place, (parameter, neutral) in enumerate(shown):
            low, high = effect.interval.get(parameter.name, (None, None))
            row = {"effect": effect.name, "parameter": parameter.name, "unit": parameter.unit, "low": low, "high": high}
            row |= {"declared": declared.get(parameter.name, neutral), "value": effect.params[parameter.name]}
            row |= {"unknown": "not shown by these flights" if parameter.kind == "number" else ""}
            row |= {"confidence": effect.confidence, "first": place == 0, "count": len(shown)}
            rows.append(row)
    return rows


def channel_rows(
    before: ModelEvaluation, after: ModelEvaluation | None, became: Sequence[Outcome] = (), *, intervals: bool = True
) -> list[dict[str, object]]:
    """Return one row per channel; ``became``: outcomes by channel."""
    shown = interval_text if intervals else value_text
    outcomes = {outcome.name: outcome for outcome in became}
    closed = [None] * len(before.channels) if after is None else after.shares_of_gap_closed(before)
    return [
        {
            "name": f"{channel.kind.replace('_', ' ')} {channel.axis} [{channel.unit}]",
            "before": shown(before.residual[place]),
            "after": "–" if after is None else shown(after.residual[place]),
            **_outcome_cells(outcomes.get(channel.name)),
            "closed": percent_text(closed[place]),
            "floor": "–" if before.floor is None else number_text(before.floor[place]),
        }
        for place, channel in enumerate(before.channels)
    ]


def _outcome_cells(outcome: Outcome | None) -> dict[str, str]:
    if outcome is None:
        return {"change": "–", "became": "–"}
    return {"change": format_rise(outcome.rise), "became": outcome.state}


def channels_by_outcome(verdict: Verdict) -> dict[str, str]:
    """Return the channels by outcome (worse, better, same or not shown), with their changes."""
    texts: dict[str, str] = {}
    for state in (WORSE, BETTER, SAME, NOT_SHOWN):
        kinds: dict[str, list[str]] = {}
        for one in verdict.outcomes:
            if one.state == state and one.horizon is None:
                kind, _, axis = one.quantity.replace("_", " ").rpartition(".")
                kinds.setdefault(kind, []).append(axis if state == SAME else f"{axis} ({one.rise.value:+.0%})")
        if kinds:
            texts[state] = "; ".join(f"{kind} {', '.join(axes)}" for kind, axes in kinds.items())
    return texts


def text_rows_of_effects(verdict: Verdict) -> list[dict[str, str]]:
    """Return one row per named effect: parameters and certainty."""
    rows = []
    for effect in verdict.effects:
        unit = {p.name: "" if p.unit == "-" else f" {p.unit}" for p in EFFECTS.get(effect.name).parameters}
        half_widths = {key: f" ± {number_text(1.96 * std, 2)}" for key, std in effect.std.items()}
        known = {key: number_text(value, 4) for key, value in effect.params.items() if key not in effect.frozen}
        values = [f"{key} = {value}{half_widths.get(key, '')}{unit[key]}" for key, value in known.items()]
        sure = [f"confidence {number_text(effect.confidence, 4)}"]
        sure += [f"may as well be {' or '.join(effect.ties)}"] if effect.ties else []
        sure += [f"its {part.parameter} may as well be {part.other}" for part in effect.in_part]
        if effect.ablation is not None and not effect.ablation.material:
            sure.append("immaterial" if effect.ablation.material is False else "whether it is material is not shown")
        rows.append({"name": effect.name, "parameters": ", ".join(values), "sure": ", ".join(sure)})
    return rows


def reason_rows(reasons: Mapping[str, str]) -> dict[str, list[str]]:
    """Return the names that share a reason, by reason."""
    texts: dict[str, list[str]] = {}
    for name, reason in reasons.items():
        texts.setdefault(reason, []).append(name)
    return texts


def rollout_rows(verdict: Verdict, variant: str, *, intervals: bool = True) -> list[dict[str, str]]:
    """Return one row per quantity and horizon."""
    shown = interval_text if intervals else value_text
    before, after = verdict.before.rollout[variant], verdict.after.rollout[variant]
    outcomes = {outcome.name: outcome for outcome in verdict.outcomes}
    return [
        {
            "quantity": f"{quantity} [{QUANTITIES[quantity]}]",
            "horizon": f"{horizon:g}",
            "before": shown(rms),
            "after": shown(after[quantity][horizon]),
            **_outcome_cells(outcomes.get(f"{variant}.{quantity}.{horizon:g}")),
        }
        for quantity, horizons in before.items()
        for horizon, rms in horizons.items()
    ]


def rejection_rows(selection: SelectionResult) -> list[dict[str, str]]:
    """Return one row per effect that is not named, the most probable first: its odds, and the reason of its rejection."""
    reasons = dict(selection.not_testable)
    for name, odds in selection.adds.items():
        reasons.setdefault(name, Finding("only_linear" if odds > 0.0 else "less_probable", name))
    for name, rises in selection.immaterial.items():
        reasons[name] = Finding("trifle", name, {"rise": max(rise.high for rise in rises.values())})
    for name, kind in selection.surrogates.items():
        values = {"structure": kind, "flights": selection.spread.num_flights}
        reasons[name] = Finding("follows_structure", name, values)
    reasons |= selection.refused
    shown = {name: reason for name, reason in reasons.items() if name not in selection.effect_names}
    order = sorted(shown, key=lambda name: (name in selection.not_testable, -selection.adds.get(name, np.inf)))
    return [
        {
            "effect": name,
            "log_odds": f"{selection.adds[name]:.1f}" if name in selection.adds else "–",
            "probability": f"{selection.inclusion[name]:.2g}" if name in selection.inclusion else "–",
            "because": text(shown[name]),
        }
        for name in order
    ]


def format_rise(rise: Rise) -> str:
    """Return a relative rise with its interval in per cent, or as a factor if it is large."""
    if max(rise.value, rise.high) > MOST_PERCENT:
        return f"× {number_text(1.0 + rise.value)} [{number_text(1.0 + rise.low)}, {number_text(1.0 + rise.high)}]"
    return f"{rise.value:+.1%} [{rise.low:+.1%}, {rise.high:+.1%}]"


def flight_table(verdict: Verdict, kinds: Collection[str]) -> dict[str, list]:
    """Return one row per channel axis or rollout quantity with a cell per test flight, and the list of worse errors.

    Channels of other ``kinds`` are omitted.
    """
    rows: dict[str, dict[str, Any]] = {}
    worse = []
    for name, parts in verdict.flights.items():
        for part in parts:
            outcome = part.became
            if outcome.state == WORSE:
                worse.append(f"{_error_label(outcome)} {format_rise(outcome.rise)} on {name}")
            if outcome.horizon is None and outcome.name.split(".")[0] not in kinds:
                continue
            row = rows.setdefault(outcome.name, {"quantity": f"{_error_label(outcome)} [{part.unit}]", "cells": {}})
            row["cells"][name] = {
                "before": number_text(part.before.value),
                "after": number_text(part.after.value) if verdict.corrects else None,
                "floor": None if part.floor is None else number_text(part.floor),
                "state": outcome.state,
                "change": format_rise(outcome.rise),
            }
    return {"names": list(verdict.flights), "rows": list(rows.values()), "worse": worse}


def _error_label(outcome: Outcome) -> str:
    """Return the name of an error in a table: channel with axis, or rollout quantity."""
    channel = outcome.horizon is None
    return outcome.quantity.replace("_", " ").replace(".", " ") if channel else error_name(outcome.name)


def percent_text(share: float | None, digits: int = 1) -> str:
    """Return a share in per cent, or a dash for None."""
    return "–" if share is None else f"{share:.{digits}%}"


def value_text(rms: Rms) -> str:
    """Return a value without interval."""
    return number_text(rms.value)


def interval_text(rms: Rms) -> str:
    """Return a value with its 95 % interval."""
    return f"{number_text(rms.value)} [{number_text(rms.low)}, {number_text(rms.high)}]"
