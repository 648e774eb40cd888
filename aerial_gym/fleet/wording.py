"""Sentences on changed vehicles."""

from collections.abc import Iterable, Mapping
from typing import Any

from aerial_gym.fleet.statistics import Change, ChangeResult
from aerial_gym.physics import EFFECTS
from aerial_gym.sim2real.statistics import normal_quantile
from aerial_gym.sim2real.wording.words import half_width_text, join_words, value_text

QUANTITIES = {
    "weak_motor": "thrust",
    "thrust_coefficient": "thrust",
    "motor_gain": "speed",
    "torque_ratio": "drag torque",
}
"""Quantities that effects scale, where the effect's name does not say it."""


def text_of_change(result: ChangeResult, vehicle: str) -> str:
    """Return one sentence on the most probable change of a vehicle, with its alternatives."""
    second = f"; second change{_cause_text(result.second)}" if result.second else ""
    return f"vehicle {vehicle}{_cause_text(result)}{second}{_odd_text(result)}"


def _cause_text(result: ChangeResult) -> str:
    best, *alternatives = result.candidates
    text = f"{_rotor_text(best)}: {_size_text(best)} {_onset_text(best, result.end)}"
    if result.firmware_change:
        text += f", as firmware {result.firmware_change[1]} replaced {result.firmware_change[0]}"
    names = [cause_name(vars(other)) for other in alternatives]
    return text + (f"; or a change of {join_words(names, 'or')}" if names else "")


def text_of_no_change(result: ChangeResult, vehicle: str, verdict: str) -> str:
    """Return one sentence on a vehicle whose change is not shown, or cannot be."""
    few, blind = "too few flights to judge a change", "its flights show no effect, so no change can be judged"
    text = {"too_few_flights": few, "not_testable": blind}.get(verdict, "no change shown")
    return f"vehicle {vehicle}: {text}{_odd_text(result)}"


def texts_of_differences(differences: Iterable[Mapping[str, Any]]) -> list[str]:
    """Return one sentence on each difference between firmware versions that is significant, and leads other effects."""
    return [_difference_text(one) for one in differences if one["rejected"] and one["leading"]]


def _difference_text(difference: Mapping[str, Any]) -> str:
    values = zip(*(difference[name] for name in ("parameters", "difference", "low", "high")), strict=True)
    sizes = ", ".join(f"{name} {value:+.3g} ({low:+.3g} to {high:+.3g})" for name, value, low, high in values)
    before, after = difference["firmware"]
    return f"firmware {after} against {before}: {cause_name(difference)}: {sizes}"


def cause_name(cause: Mapping[str, Any]) -> str:
    """Return the name of an effect, with its rotor."""
    return cause["effect"].replace("_", " ") + (f", rotor {cause['rotor']}" if cause["rotor"] else "")


def _odd_text(result: ChangeResult) -> str:
    numbers = [str(number + 1) for number in result.odd_flights]
    verb = "flight {} deviates" if len(numbers) == 1 else "flights {} deviate"
    return f"; {verb.format(join_words(numbers))} alone" if numbers else ""


def _rotor_text(change: Change) -> str:
    return f", rotor {change.rotor}" if change.rotor else ""


def _size_text(change: Change) -> str:
    """Return the certain changes of an effect's parameters with half their 95 % intervals, in per cent for ratios."""
    parameters = {parameter.name: parameter for parameter in EFFECTS.get(change.effect).parameters}
    sizes = []
    for name, value, std in zip(change.parameters, change.change, change.std, strict=True):
        own, half = parameters[name], normal_quantile(0.975) * std
        factor, unit = (100.0, "%") if own.unit == "-" and own.neutral == 1.0 else (1.0, own.unit.strip("-"))
        size = f"{'+' if value > 0.0 else ''}{value_text(factor * value, factor * half)} {unit}".strip()
        sizes.append((abs(value) > half, name, size, half_width_text(factor * half, unit)))
    quantity = QUANTITIES.get(change.effect, change.effect.replace("_", " "))
    if len(sizes) == 1:
        return f"{sizes[0][2]} {quantity} ({sizes[0][3]})"
    certain = [size for size in sizes if size[0]] or sizes
    return f"{quantity} {join_words(f'{name} {size} ({half})' for _, name, size, half in certain)}"


def _onset_text(change: Change, end: int | None) -> str:
    """Return the first changed flight, counted from 1, with its 90 % interval if uncertain, and the last if the change ends."""
    first, low, high = change.onset + 1, change.onset_low + 1, change.onset_high + 1
    word = ("by a drift " if change.kind == "drift" else "") + ("since" if end is None else "from")
    interval = f" (90 % interval {low} to {high})" if low < high else ""
    return f"{word} flight {first}{interval}" + ("" if end is None else f" to flight {end}")
