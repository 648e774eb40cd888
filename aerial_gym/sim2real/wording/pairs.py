"""Sentences of findings on two vehicles in the same flights."""

from collections.abc import Mapping

from aerial_gym.sim2real.findings import Finding
from aerial_gym.sim2real.wording.words import Template, join_words, number_text


def _sentence_on_one_vehicle(finding: Finding) -> str:
    effects: Mapping[str, Mapping[str, float]] = finding.values["effects"]
    parts = [f"{name} ({', '.join(f'{k} {number_text(v)}' for k, v in one.items())})" for name, one in effects.items()]
    by = f", by {join_words(parts)}" if parts else ""
    return (
        f"The {finding.subject} vehicle alone: {finding.values['verdict']}{by}. Its own logs alone give its robot file."
    )


def _sentence_on_wrong_clock(finding: Finding) -> str:
    offset, half = float(finding.values["offset_s"]), float(finding.values["half_width_s"])
    return (
        f"{finding.subject}: the wake fits best with {offset:+.2f} ± {half:.2f} s added to the times of the second log. If the "
        f"clocks differ, add that to --pair-clock-s; a wake that needs this time to come down looks alike."
    )


def _correlation_text(finding: Finding) -> str:
    low, high = finding.values["low"], finding.values["high"]
    return f"correlation {finding.values['correlation']:.2f} ({low:.2f} to {high:.2f}), errors of each log included"


PAIRS: dict[str, Template] = {
    "vehicle_alone": _sentence_on_one_vehicle,
    "clock_confirmed": lambda f: (
        f"{f.subject}: the wake confirms the common clock within {abs(f.values['offset_s']) + f.values['half_width_s']:.2f} s."
    ),
    "clock_contradicted": _sentence_on_wrong_clock,
    "clock_undecided": (
        "{subject}: a wake contradicts the common clock, but several offsets fit, as with periodic passes, or one beyond 4 s. "
        "Fly irregular passes, or synchronise both clocks."
    ),
    "clock_unchecked": "{subject}: no wake shows whether both clocks agree, so their offset is taken as stated.",
    "gusts_shared": lambda f: f"Both vehicles feel the same gusts: {_correlation_text(f)}.",
    "gusts_separate": lambda f: f"Each vehicle feels gusts of its own: {_correlation_text(f)}.",
    "gusts_undecided": lambda f: (
        f"The logs do not tell whether both vehicles feel the same gusts: {_correlation_text(f)}. Fly longer, side by side."
    ),
}
"""Templates of the findings on two vehicles, by code."""
