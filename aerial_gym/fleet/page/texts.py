"""Texts of the pages: names of causes, values with intervals, and times."""

from collections.abc import Mapping
from datetime import UTC, datetime
from typing import Any

from aerial_gym.physics import EFFECTS
from aerial_gym.physics.effects.base import Parameter
from aerial_gym.sim2real.wording.words import half_width_text, value_text

Cause = Mapping[str, Any]  # A change of one effect, as in the column ``causes`` of ``verdicts``

HALF_95 = 1.96  # Half a 95 % interval per standard deviation


def effect_parameters(effect: str) -> dict[str, Parameter]:
    """Return the parameters of an effect by name; none if it is not registered here."""
    return {one.name: one for one in EFFECTS.get(effect).parameters} if effect in EFFECTS else {}


def unit_text(effect: str, parameter: str) -> str:
    """Return the unit of a parameter; empty for a ratio."""
    known = effect_parameters(effect).get(parameter)
    return "" if known is None or known.unit == "-" else known.unit


def interval_text(value: float, std: float, unit: str) -> str:
    """Return a value with half its 95 % interval and its unit, such as ``-2.1 ± 0.4 %``."""
    return f"{value_text(value, HALF_95 * std)} {half_width_text(HALF_95 * std, unit)}".rstrip()


def change_text(cause: Cause, most: int | None = None) -> str:
    """Return the changes of parameters with intervals, of ratios in per cent; ``most``: only the most certain ones."""
    known, parts = effect_parameters(cause["effect"]), list[str]()
    own = zip(cause["parameters"], cause["change"], cause["std"], strict=True)
    for name, value, std in sorted(own, key=lambda one: -abs(one[1]) / max(one[2], 1e-300)):
        unit = unit_text(cause["effect"], name)
        factor, unit = (100.0, "%") if name in known and not unit else (1.0, unit)
        sign, label = "+" if value > 0.0 else "", f"{name} " if len(cause["parameters"]) > 1 else ""
        parts.append(f"{label}{sign}{interval_text(factor * value, factor * std, unit)}")
    return "; ".join(parts[:most])


def change_in_scales(cause: Cause) -> float:
    """Return the largest change of a parameter in units of its scale, by which changes of all effects are sorted."""
    known, own = effect_parameters(cause["effect"]), zip(cause["parameters"], cause["change"], strict=True)
    return max((abs(value) / (known[name].scale if name in known else 1.0) for name, value in own), default=0.0)


def time_text(seconds: float | None) -> str:
    """Return a Unix time as date and time; empty if it is not known."""
    if seconds is None or not 0.0 <= seconds < 253402300800.0:  # Year 10000; NaN fails as well
        return ""
    return datetime.fromtimestamp(seconds, UTC).strftime("%Y-%m-%d %H:%M UTC")
