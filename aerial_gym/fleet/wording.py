"""Sentences on changed vehicles."""

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
    odd = _odd_text(result)
    if not result.causes:
        return f"vehicle {vehicle}: too few flights to judge a change{odd}"
    second = f"; second change{_cause_text(result.second)}" if result.second else ""
    return f"vehicle {vehicle}{_cause_text(result)}{second}{odd}"


def _cause_text(result: ChangeResult) -> str:
    best, *alternatives = result.candidates
    text = f"{_rotor_text(best)}: {_size_text(best)} {_onset_text(best, result.end)}"
    if result.firmware_change:
        text += f", as firmware {result.firmware_change[1]} replaced {result.firmware_change[0]}"
    names = [f"{other.effect.replace('_', ' ')}{_rotor_text(other)}" for other in alternatives]
    return text + (f"; or a change of {join_words(names, 'or')}" if names else "")


def text_of_no_change(result: ChangeResult, vehicle: str) -> str:
    """Return one sentence on a vehicle whose change is not shown."""
    return (
        f"vehicle {vehicle}: no change shown{_odd_text(result)}" if result.causes else text_of_change(result, vehicle)
    )


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
